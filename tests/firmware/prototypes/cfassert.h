/* Only what cfid's app uses of the firmware's header of this name. */
void prototype_assert(int holds);
#define ASSERT(condition) prototype_assert((condition) ? 1 : 0)
