/* Only what cfid's app uses of the firmware's header of this name. */
/* What the firmware's configuration defines is given on the compiler's command line. */
