/* Connects cfid's core to the Crazyflie's firmware: packets, controller, supervisor and clock.

   All decisions are in cfid_core.c. Only the stabilizer's task calls the core, a thousand times a second; packets reach
   and leave it through queues, so that the motors and the other tasks never wait for each other. */

#include <stdbool.h>
#include <stdint.h>
#include <string.h>

#include "FreeRTOS.h"
#include "queue.h"

#include "app.h"
#include "autoconf.h"
#include "cfassert.h"
#include "commander.h"
#include "controller.h"
#include "controller_pid.h"
#include "crtp.h"
#include "param.h"
#include "supervisor.h"
#include "usec_time.h"

#include "cfid_core.h"

#ifndef CFID_PORT_THRUST
#define CFID_PORT_THRUST 10
#endif
#ifndef CFID_PORT_SINE
#define CFID_PORT_SINE 11
#endif
#ifndef CFID_PORT_PING
#define CFID_PORT_PING 12
#endif

#ifdef CONFIG_ENABLE_THRUST_BAT_COMPENSATED
#error "With ENABLE_THRUST_BAT_COMPENSATED motors get other commands than were sent: app-config turns it off."
#endif

/* A header that came with release 2025.12, the first whose power distribution obeys controlModeForce. */
#if !__has_include("led_deck_controller.h")
#error "This app needs firmware 2025.12 or later: earlier firmware would acknowledge commands and turn no motor."
#endif

_Static_assert(CFID_PAYLOAD == CRTP_MAX_DATA_SIZE, "a packet of the core carries what a packet of the link does");
_Static_assert(CFID_MOTORS == STABILIZER_NR_OF_MOTORS, "the vehicle has the core's motors");

enum { ARRIVALS = 16, DEPARTURES = 32, FEED_TICKS = 20 };

struct arrival {
    uint64_t us; /* stamped on arrival, so that time in the queue counts towards a keep-alive's age */
    struct cfid_packet packet;
};

static const uint8_t PORTS[] = {
    [CFID_THRUST] = CFID_PORT_THRUST, [CFID_SINE] = CFID_PORT_SINE, [CFID_PING] = CFID_PORT_PING};

static struct cfid_core core;

/* In plain memory, since the firmware's own macro puts queues into memory that is almost full. */
static QueueHandle_t arrivals, departures;
static StaticQueue_t arrivals_state, departures_state;
static uint8_t arrivals_storage[ARRIVALS * sizeof(struct arrival)];
static uint8_t departures_storage[DEPARTURES * sizeof(struct cfid_packet)];

static CRTPPacket onto_link(const struct cfid_packet *packet)
{
    CRTPPacket sent = {.size = packet->size, .header = CRTP_HEADER(PORTS[packet->service], packet->channel)};
    memcpy(sent.data, packet->data, packet->size);
    return sent;
}

/* Runs in the link's task and answers pings immediately, so that they measure the link only. */
static void take(enum cfid_service service, const CRTPPacket *packet)
{
    struct arrival arrival = {
        .us = usecTimestamp(),
        .packet = {.service = service, .channel = packet->channel, .size = packet->size},
    };
    struct cfid_packet answer;
    if (packet->size > CFID_PAYLOAD)
        return;
    memcpy(arrival.packet.data, packet->data, packet->size);
    if (cfid_answer_ping(&arrival.packet, arrival.us, &answer)) {
        CRTPPacket sent = onto_link(&answer);
        crtpSendPacket(&sent);
    } else {
        xQueueSend(arrivals, &arrival, 0);
    }
}

static void take_thrust(CRTPPacket *packet)
{
    take(CFID_THRUST, packet);
}

static void take_sine(CRTPPacket *packet)
{
    take(CFID_SINE, packet);
}

static void take_ping(CRTPPacket *packet)
{
    take(CFID_PING, packet);
}

/* Gives the commander fresh null setpoints, since the supervisor locks a vehicle with an old one, which any client may
   have left. Afterwards the high-level commander continues with null setpoints of its own, as after a start. */
static void feed(bool fresh)
{
    static setpoint_t null_setpoint;
    static uint32_t ticks;
    if (fresh && ticks++ % FEED_TICKS == 0) {
        commanderSetSetpoint(&null_setpoint, COMMANDER_PRIORITY_CRTP);
    } else if (!fresh && ticks > 0) {
        commanderRelaxPriority();
        ticks = 0;
    }
}

#ifdef CONFIG_MOTORS_REQUIRE_ARMING

static paramVarId_t idle_parameter;
static uint16_t idle_thrust; /* as its owner set it */
static bool idle_off;

static void find_idle_thrust(void)
{
    idle_parameter = paramGetVarId("powerDist", "idleThrust");
    ASSERT(PARAM_VARID_IS_VALID(idle_parameter));
}

static struct cfid_vehicle look(void)
{
    if (!idle_off)
        idle_thrust = (uint16_t)paramGetUint(idle_parameter);
    return (struct cfid_vehicle){
        .can_fly = supervisorCanFly(), .flying = supervisorIsFlying(), .needs_arming = true, .idle = idle_thrust};
}

/* Switches idle thrust off and restores the value it had: no client can arm a vehicle without it. */
static void obey(const struct cfid_orders *orders)
{
    if (idle_off != orders->idles_off)
        paramSetInt(idle_parameter, orders->idles_off ? 0 : idle_thrust);
    idle_off = orders->idles_off;
    if (orders->disarms)
        supervisorRequestArming(false);
}

#else

static void find_idle_thrust(void)
{
}

static struct cfid_vehicle look(void)
{
    return (struct cfid_vehicle){.can_fly = supervisorCanFly(), .flying = supervisorIsFlying()};
}

static void obey(const struct cfid_orders *orders)
{
    (void)orders; /* a brushed vehicle arms itself and has no idle thrust */
}

#endif

/* Moves packets to the link; if the link has no room, they stay in the core's outbox. */
static void hand_out(void)
{
    struct cfid_packet packet;
    while (uxQueueSpacesAvailable(departures) > 0 && cfid_core_send(&core, &packet))
        xQueueSend(departures, &packet, 0);
}

void controllerOutOfTreeInit(void)
{
    controllerPidInit();
    if (arrivals)
        return;
    cfid_core_init(&core);
    arrivals = xQueueCreateStatic(ARRIVALS, sizeof(struct arrival), arrivals_storage, &arrivals_state);
    departures = xQueueCreateStatic(DEPARTURES, sizeof(struct cfid_packet), departures_storage, &departures_state);
    ASSERT(arrivals && departures);
    find_idle_thrust();
    crtpRegisterPortCB(CFID_PORT_THRUST, take_thrust);
    crtpRegisterPortCB(CFID_PORT_SINE, take_sine);
    crtpRegisterPortCB(CFID_PORT_PING, take_ping);
}

bool controllerOutOfTreeTest(void)
{
    return controllerPidTest();
}

void controllerOutOfTree(control_t *control, const setpoint_t *setpoint, const sensorData_t *sensors,
                         const state_t *state, const stabilizerStep_t step)
{
    const struct cfid_vehicle vehicle = look();
    struct cfid_orders orders;
    struct arrival arrival;
    while (xQueueReceive(arrivals, &arrival, 0) == pdTRUE)
        cfid_core_receive(&core, &arrival.packet, arrival.us, &vehicle);
    cfid_core_tick(&core, usecTimestamp(), &vehicle, &orders);
    feed(orders.feeds);
    obey(&orders);
    hand_out();
    if (!orders.holds) {
        controllerPid(control, setpoint, sensors, state, step);
        return;
    }
    control->controlMode = controlModeForce;
    for (int motor = 0; motor < CFID_MOTORS; motor++) /* times 65535 in float, truncated, is the command again */
        control->normalizedForces[motor] = (float)orders.commands[motor] / (float)UINT16_MAX;
}

void appMain(void)
{
    struct cfid_packet packet;
    while (true) {
        if (xQueueReceive(departures, &packet, portMAX_DELAY) == pdTRUE) {
            CRTPPacket sent = onto_link(&packet);
            crtpSendPacketBlock(&sent);
        }
    }
}
