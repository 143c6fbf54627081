/* Lets happen what stdin says, one record of 44 bytes after the other, and writes what the core does to stdout.

   A record: uint64_t now_us, then a byte each whether to drain the outbox, whether motors are allowed, and whether this
   is a tick; then a packet's service, channel and size, and 30 bytes. A tick writes whether the core holds the motors
   and four uint16_t; each packet that leaves the outbox writes its service, channel, size and bytes. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "cfid_core.h"

enum { DRAIN = 8, ALLOWED, TICK, SERVICE, CHANNEL, SIZE, DATA, RECORD = DATA + CFID_PAYLOAD };

static void tick(struct cfid_core *core, uint64_t now_us, bool allowed)
{
    const struct cfid_vehicle vehicle = {.can_fly = allowed};
    struct cfid_orders orders;
    cfid_core_tick(core, now_us, &vehicle, &orders);
    for (int motor = 0; motor < CFID_MOTORS && !orders.holds; motor++)
        orders.commands[motor] = 0; /* the motors are the stock controller's */
    putchar(orders.holds);
    fwrite(orders.commands, sizeof orders.commands, 1, stdout);
}

static void receive(struct cfid_core *core, const uint8_t *record, uint64_t now_us)
{
    const struct cfid_vehicle vehicle = {.can_fly = record[ALLOWED]};
    struct cfid_packet packet = {.service = record[SERVICE], .channel = record[CHANNEL], .size = record[SIZE]}, answer;
    memcpy(packet.data, record + DATA, sizeof packet.data);
    cfid_answer_ping(&packet, now_us, &answer);
    cfid_core_receive(core, &packet, now_us, &vehicle);
}

static void drain(struct cfid_core *core)
{
    struct cfid_packet packet;
    while (cfid_core_send(core, &packet)) {
        putchar(packet.service);
        putchar(packet.channel);
        putchar(packet.size);
        fwrite(packet.data, packet.size, 1, stdout);
    }
}

int main(void)
{
    uint8_t record[RECORD];
    struct cfid_core *core = malloc(cfid_core_size()); /* so that one byte beyond it is found */
    if (!core)
        return 1;
    cfid_core_init(core);
    while (fread(record, sizeof record, 1, stdin) == 1) {
        uint64_t now_us;
        memcpy(&now_us, record, sizeof now_us);
        if (record[TICK])
            tick(core, now_us, record[ALLOWED]);
        else
            receive(core, record, now_us);
        if (record[DRAIN])
            drain(core);
    }
    free(core);
    return 0;
}
