/* Only what cfid's app uses of the firmware's header of this name. */
#include <stdint.h>
uint64_t usecTimestamp(void);
