/* Only what cfid's app uses of the firmware's header of this name. */
#include <stdbool.h>
bool supervisorCanFly(void);
bool supervisorIsFlying(void);
bool supervisorRequestArming(const bool wanted);
