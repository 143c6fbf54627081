/* Only what cfid's app uses of the firmware's header of this name. */
#ifndef STABILIZER_TYPES_H
#define STABILIZER_TYPES_H
#include <stdint.h>
#define STABILIZER_NR_OF_MOTORS 4
typedef uint32_t stabilizerStep_t;
typedef enum { controlModeLegacy = 0, controlModeForceTorque = 1, controlModeForce = 2 } control_mode_t;
typedef struct {
    float normalizedForces[STABILIZER_NR_OF_MOTORS];
    control_mode_t controlMode;
} control_t;
typedef struct {
    float thrust;
} setpoint_t;
typedef struct {
    float acc_z;
} sensorData_t;
typedef struct {
    float attitude;
} state_t;
#endif
