/* The firmware around cfid_app.c, as far as the app uses it: tells on stdout what the app makes of it.

   Reads lines from stdin. `p PORT CHANNEL HEX`: a packet arrives. `v CAN_FLY FLYING`: what the supervisor says from now
   on. `i IDLE`: somebody sets powerDist.idleThrust. `t N`: N rounds of the stabilizer, a millisecond each. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "app.h"
#include "cfassert.h"
#include "commander.h"
#include "controller.h"
#include "controller_pid.h"
#include "crtp.h"
#include "param.h"
#include "queue.h"
#include "supervisor.h"
#include "usec_time.h"

enum { LINE = 256, PORTS = 16 };

static uint64_t now_us = 1000000;
static unsigned rounds;
static bool can_fly, flying;
static int idle_thrust = 7000;
static CrtpCallback callbacks[PORTS];

void prototype_assert(int holds)
{
    if (!holds) {
        printf("%u assertion\n", rounds);
        exit(1);
    }
}

QueueHandle_t xQueueCreateStatic(UBaseType_t length, UBaseType_t bytes, uint8_t *storage, StaticQueue_t *state)
{
    *state = (StaticQueue_t){.storage = storage, .length = length, .bytes = bytes};
    return state;
}

BaseType_t xQueueSend(QueueHandle_t queue, const void *item, TickType_t wait)
{
    (void)wait;
    if (queue->waiting == queue->length)
        return 0;
    memcpy(queue->storage + (queue->first + queue->waiting++) % queue->length * queue->bytes, item, queue->bytes);
    return pdTRUE;
}

BaseType_t xQueueReceive(QueueHandle_t queue, void *item, TickType_t wait)
{
    if (queue->waiting == 0) {
        if (wait == portMAX_DELAY) /* the app's own task has sent all there is, and the test is over */
            exit(0);
        return 0;
    }
    memcpy(item, queue->storage + queue->first * queue->bytes, queue->bytes);
    queue->first = (queue->first + 1) % queue->length;
    queue->waiting--;
    return pdTRUE;
}

UBaseType_t uxQueueSpacesAvailable(QueueHandle_t queue)
{
    return queue->length - queue->waiting;
}

void commanderSetSetpoint(setpoint_t *setpoint, int priority)
{
    printf("%u setpoint %g %d\n", rounds, (double)setpoint->thrust, priority);
}

void commanderRelaxPriority(void)
{
    printf("%u relax\n", rounds);
}

void controllerPidInit(void)
{
}

bool controllerPidTest(void)
{
    return true;
}

void controllerPid(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors, const state_t *state,
                   const stabilizerStep_t step)
{
    (void)setpoint, (void)sensors, (void)state, (void)step;
    control->controlMode = controlModeLegacy;
}

void crtpRegisterPortCB(int port, CrtpCallback callback)
{
    callbacks[port] = callback;
}

static int send_packet(const CRTPPacket *packet)
{
    printf("%u sent %d %d ", rounds, packet->port, packet->channel);
    for (int i = 0; i < packet->size; i++)
        printf("%02x", packet->data[i]);
    printf("\n");
    return 1;
}

int crtpSendPacket(CRTPPacket *packet)
{
    return send_packet(packet);
}

int crtpSendPacketBlock(CRTPPacket *packet)
{
    return send_packet(packet);
}

paramVarId_t paramGetVarId(const char *group, const char *name)
{
    const bool found = strcmp(group, "powerDist") == 0 && strcmp(name, "idleThrust") == 0;
    return (paramVarId_t){.id = found ? 7 : 0xffffu};
}

unsigned int paramGetUint(paramVarId_t parameter)
{
    prototype_assert(parameter.id == 7);
    return (unsigned int)idle_thrust;
}

void paramSetInt(paramVarId_t parameter, int value)
{
    prototype_assert(parameter.id == 7);
    idle_thrust = value;
    printf("%u idle %d\n", rounds, value);
}

bool supervisorCanFly(void)
{
    return can_fly;
}

bool supervisorIsFlying(void)
{
    return flying;
}

bool supervisorRequestArming(const bool wanted)
{
    printf("%u %s\n", rounds, wanted ? "arm" : "disarm");
    return true;
}

uint64_t usecTimestamp(void)
{
    return now_us;
}

static void run(unsigned count)
{
    static control_t before = {.controlMode = controlModeForceTorque};
    const setpoint_t setpoint = {0};
    const sensorData_t sensors = {0};
    const state_t state = {0};
    while (count-- > 0) {
        control_t control = {0};
        now_us += 1000;
        controllerOutOfTree(&control, &setpoint, &sensors, &state, rounds);
        if (memcmp(&control, &before, sizeof control) != 0) {
            const float *force = control.normalizedForces;
            if (control.controlMode == controlModeForce)
                printf("%u motors %d %d %d %d\n", rounds, (int)(force[0] * 65535.0f), (int)(force[1] * 65535.0f),
                       (int)(force[2] * 65535.0f), (int)(force[3] * 65535.0f));
            else
                printf("%u pid\n", rounds);
        }
        before = control;
        rounds++;
    }
}

static void arrive(unsigned port, unsigned channel, const char *hex)
{
    CRTPPacket packet = {.header = CRTP_HEADER(port, channel)};
    for (; hex[0] && hex[1]; hex += 2) {
        unsigned byte;
        sscanf(hex, "%2x", &byte);
        packet.data[packet.size++] = (uint8_t)byte;
    }
    callbacks[port](&packet);
}

int main(void)
{
    char line[LINE], hex[LINE];
    controllerOutOfTreeInit();
    if (!controllerOutOfTreeTest())
        return 1;
    while (fgets(line, sizeof line, stdin)) {
        unsigned a, b;
        hex[0] = 0;
        if (sscanf(line, "p %u %u %255s", &a, &b, hex) >= 2)
            arrive(a, b, hex);
        else if (sscanf(line, "v %u %u", &a, &b) == 2)
            can_fly = a, flying = b;
        else if (sscanf(line, "i %u", &a) == 1)
            idle_thrust = (int)a;
        else if (sscanf(line, "t %u", &a) == 1)
            run(a);
    }
    appMain();
    return 0;
}
