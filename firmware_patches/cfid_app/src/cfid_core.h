/* The part of cfid's app that is independent of the operating system: the services thrust, sine and ping.

   These are the thesis' services (C.2.1, C.2.4, C.2.6). The bytes are those of cfid/wire/app.py, little-endian, the
   thesis' fields first. The core has no clock: every call passes the time, in microseconds that never decrease, and
   the vehicle's state. All calls with one core come from one task. */

#ifndef CFID_CORE_H
#define CFID_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { CFID_MOTORS = 4, CFID_PAYLOAD = 30, CFID_OUTBOX = 16, CFID_REVOKED = 8 };

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

/* The vehicle's state that the core needs, as its supervisor reports it now. */
struct cfid_vehicle {
    bool can_fly;      /* stricter than whether motors may run, which is also true while they spin up after arming */
    bool flying;       /* until two seconds after the last command above idle thrust */
    bool needs_arming; /* by a client; brushed vehicles arm themselves */
    uint16_t idle;     /* powerDist.idleThrust as its owner set it, 0 where there is none */
};

/* The core's orders to the firmware until the next tick. */
struct cfid_orders {
    uint16_t commands[CFID_MOTORS];
    bool holds;     /* drive these commands, which may be zero; otherwise the stock controller drives the motors */
    bool feeds;     /* keep giving the commander fresh null setpoints */
    bool idles_off; /* no idle thrust: every motor turns fast enough without it */
    bool disarms;   /* disarm the vehicle now */
};

struct cfid_core {
    uint64_t alive_us; /* the last keep-alive, while alive */
    bool alive;        /* the last keep-alive is neither too old nor revoked */
    uint32_t owner;    /* of the last accepted keep-alive: a client's random number, 0 for a client without one */
    uint32_t revoked[CFID_REVOKED]; /* the owners that the latest stops ended; 0 for none */
    uint8_t next_revoked;
    bool held, ran, fed, stopped; /* as of the previous tick; stopped: a stop has arrived since */
    uint16_t commands[CFID_MOTORS];
    struct cfid_sine sine;
    struct cfid_packet outbox[CFID_OUTBOX];
    uint8_t first, waiting; /* of the outbox */
};

/* Returns the bytes of a core, for callers that do not see this header. */
size_t cfid_core_size(void);

/* Initializes a core without commands and without a client. */
void cfid_core_init(struct cfid_core *core);

/* Processes a packet that arrived at now_us. */
void cfid_core_receive(struct cfid_core *core, const struct cfid_packet *packet, uint64_t now_us,
                       const struct cfid_vehicle *vehicle);

/* Advances by a millisecond; a sample of a sine lasts two of these ticks: 500 Hz. */
void cfid_core_tick(struct cfid_core *core, uint64_t now_us, const struct cfid_vehicle *vehicle,
                    struct cfid_orders *orders);

/* Takes the oldest packet out of the outbox; returns false when it is empty. */
bool cfid_core_send(struct cfid_core *core, struct cfid_packet *out);

/* Returns whether the last keep-alive is less than 500 ms old and was not revoked. */
bool cfid_core_alive(const struct cfid_core *core, uint64_t now_us);

/* Answers a ping on channel 0: an empty one with nothing, as in 2015; any other with its bytes, at most 22, and all
   64 bits of the time.

   Returns false for any other packet. Needs no core, and so may be called from any task. */
bool cfid_answer_ping(const struct cfid_packet *packet, uint64_t now_us, struct cfid_packet *out);

#endif
