/* Only what cfid's app uses of the firmware's header of this name. */
void appMain(void);
