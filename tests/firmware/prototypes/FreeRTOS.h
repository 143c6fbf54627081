/* Only what cfid's app uses of the firmware's header of this name. */
#ifndef FREERTOS_H
#define FREERTOS_H
#include <stdint.h>
typedef long BaseType_t;
typedef unsigned long UBaseType_t;
typedef uint32_t TickType_t;
#define pdTRUE ((BaseType_t)1)
#define portMAX_DELAY ((TickType_t)0xffffffffUL)
#endif
