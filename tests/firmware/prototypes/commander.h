/* Only what cfid's app uses of the firmware's header of this name. */
#include "stabilizer_types.h"
#define COMMANDER_PRIORITY_CRTP 2
void commanderSetSetpoint(setpoint_t *setpoint, int priority);
void commanderRelaxPriority(void);
