/* Only what cfid's app uses of the firmware's header of this name. */
#ifndef QUEUE_H
#define QUEUE_H
#include "FreeRTOS.h"
typedef struct queue *QueueHandle_t;
typedef struct queue {
    uint8_t *storage;
    UBaseType_t length, bytes, first, waiting;
} StaticQueue_t;
QueueHandle_t xQueueCreateStatic(UBaseType_t length, UBaseType_t bytes, uint8_t *storage, StaticQueue_t *state);
BaseType_t xQueueSend(QueueHandle_t queue, const void *item, TickType_t wait);
BaseType_t xQueueReceive(QueueHandle_t queue, void *item, TickType_t wait);
UBaseType_t uxQueueSpacesAvailable(QueueHandle_t queue);
#endif
