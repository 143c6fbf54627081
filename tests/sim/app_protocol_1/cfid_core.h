/* What cfid's app does on the vehicle, without its operating system: the services thrust, sine and ping.

   They are those of the thesis (C.2.1, C.2.4, C.2.6). The bytes are those of cfid/wire/app.py, little-endian, the
   thesis' fields first. The core keeps no time of its own: every call says how late it is, in microseconds that never
   run back, and whether the supervisor lets motors run. All calls with one core come from one task. */

#ifndef CFID_CORE_H
#define CFID_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CFID_MOTORS = 4, CFID_PAYLOAD = 30, CFID_OUTBOX = 16 };

enum cfid_service { CFID_THRUST, CFID_SINE, CFID_PING };

struct cfid_packet {
    uint8_t service; /* of enum cfid_service */
    uint8_t channel;
    uint8_t size;
    uint8_t data[CFID_PAYLOAD];
};

/* u[n] = A cos(2 pi l n/N) + 30000 (eq. 3.6), as far as it has been played. */
struct cfid_sine {
    uint8_t stage;      /* of enum stage in cfid_core.c */
    uint8_t motor;      /* as in a thrust request: 0 to 3, or 4 for all */
    uint8_t outcome;
    bool clips;         /* some of its samples lie outside 0 to 65535 */
    bool held;          /* the sample in force stays for one more tick */
    uint16_t amplitude; /* A */
    uint16_t command;   /* the last sample, as played */
    uint16_t reports;   /* crossings found so far, sent or not */
    uint32_t samples;   /* N */
    uint32_t periods;   /* l */
    uint32_t phase;     /* l n mod N */
    uint32_t played;
    uint32_t clipped;
    uint64_t off_us;    /* when its motors were turned off */
};

struct cfid_core {
    uint64_t alive_us; /* the last keep-alive, while heard */
    bool heard;        /* a keep-alive that is neither too old nor revoked */
    uint16_t commands[CFID_MOTORS];
    struct cfid_sine sine;
    struct cfid_packet outbox[CFID_OUTBOX];
    uint8_t first, waiting; /* of the outbox */
};

/* Returns the bytes of a core, for callers that do not see this header. */
size_t cfid_core_size(void);

/* Makes a core that drives nothing and has heard nothing. */
void cfid_core_init(struct cfid_core *core);

/* Takes a packet that arrived at now_us. */
void cfid_core_receive(struct cfid_core *core, const struct cfid_packet *packet, uint64_t now_us, bool allowed);

/* Does what is due, once a millisecond; a sample of a sine lasts two of these ticks: 500 Hz.

   Returns whether the core holds the motors, which it does while keep-alives come, and drives these commands, which may
   be zero; when it does not, the motors are the stock controller's. */
bool cfid_core_tick(struct cfid_core *core, uint64_t now_us, bool allowed, uint16_t commands[CFID_MOTORS]);

/* Takes the oldest packet out of the outbox; returns false when it is empty. */
bool cfid_core_send(struct cfid_core *core, struct cfid_packet *out);

/* Returns whether the last keep-alive is less than 500 ms old and was not revoked. */
bool cfid_core_alive(const struct cfid_core *core, uint64_t now_us);

/* Answers a ping on channel 0: an empty one with nothing, as in 2015; any other with its bytes, at most 22, and the
   time, all 64 bits of it.

   Returns false for any other packet. Needs no core, and so may be called from any task. */
bool cfid_answer_ping(const struct cfid_packet *packet, uint64_t now_us, struct cfid_packet *out);

#endif
