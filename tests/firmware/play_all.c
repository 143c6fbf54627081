/* Plays eq. 3.6 with amplitude A over N samples for each l in 0 to N/2: `play_all A N`, commands to stdout as uint16.

   Every request is told omega as the client does, rounded to a float. Ends with 1 where one is refused, where another
   motor runs, or where a command does not last two ticks. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cfid_core.h"

enum { MOTOR = 2, TICK_US = 1000, REST_TICKS = 1001, KEEP_ALIVE_SAMPLES = 200 };

static struct cfid_core core;
static uint64_t now_us;
static const struct cfid_vehicle vehicle = {.can_fly = true};

static void tell(uint8_t service, uint8_t channel, const void *data, uint8_t size)
{
    struct cfid_packet packet = {.service = service, .channel = channel, .size = size};
    memcpy(packet.data, data, size);
    cfid_core_receive(&core, &packet, now_us, &vehicle);
}

static uint16_t tick(void)
{
    struct cfid_orders orders;
    struct cfid_packet packet;
    now_us += TICK_US;
    cfid_core_tick(&core, now_us, &vehicle, &orders);
    if (!orders.holds || orders.commands[0] || orders.commands[2] || orders.commands[3])
        exit(1);
    while (cfid_core_send(&core, &packet))
        ;
    return orders.commands[1];
}

static void keep_alive(void)
{
    tell(CFID_PING, 2, "1234", 4);
}

static void start(uint16_t amplitude, uint32_t samples, uint32_t l)
{
    const float omega = (float)(2.0 * 3.14159265358979323846 * (double)l / (double)samples);
    const uint16_t motor = MOTOR;
    uint8_t request[12];
    struct cfid_packet answer;
    memcpy(request, &motor, 2);
    memcpy(request + 2, &amplitude, 2);
    memcpy(request + 4, &omega, 4);
    memcpy(request + 8, &samples, 4);
    keep_alive();
    while (cfid_core_send(&core, &answer))
        ;
    tell(CFID_SINE, 0, request, sizeof request);
    if (!cfid_core_send(&core, &answer) || answer.data[12] != 0)
        exit(1);
}

int main(int count, char **words)
{
    if (count != 3)
        return 2;
    const uint16_t amplitude = (uint16_t)atoi(words[1]);
    const uint32_t samples = (uint32_t)atoi(words[2]);
    cfid_core_init(&core);
    for (uint32_t l = 0; l <= samples / 2; l++) {
        start(amplitude, samples, l);
        for (uint32_t n = 0; n < samples; n++) {
            const uint16_t command = tick();
            if (tick() != command)
                return 1;
            if (n % KEEP_ALIVE_SAMPLES == 0)
                keep_alive();
            fwrite(&command, sizeof command, 1, stdout);
        }
        for (int rest = 0; rest < REST_TICKS; rest++) {
            if (rest % KEEP_ALIVE_SAMPLES == 0)
                keep_alive();
            if (tick() != 0)
                return 1;
        }
    }
    return 0;
}
