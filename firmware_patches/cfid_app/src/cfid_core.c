#include "cfid_core.h"

#include <math.h>
#include <string.h>

enum {
    MIDDLE = 30000, /* B of eq. 3.6 */
    LARGEST_COMMAND = 65535,
    ALL_MOTORS_THRUST = CFID_MOTORS, /* the motor of a thrust request to all motors; single ones are 0 to 3 */
    ALL_MOTORS_SINE = 0,             /* the motor of a sine request to all motors; single ones are 1 to 4 */
    PROTOCOL = 2,
    SAMPLES_PER_S = 500,
    KEEP_ALIVE_MS = 500,
    US_PER_MS = 1000,
    REST_US = 1000000, /* from the motors' stop to the byte `a` (C.2.4) */
    MOST_PERIODS = 1 << 22, /* a float is too coarse for a larger l: it is off by half a period at 2^23 */
    LONGEST_ECHO = 22,
    DSHOT_SHIFT = 5,
    DSHOT_NONE = 47,
};

static const double PI = 3.14159265358979323846;
static const double FLOAT_ROUNDING = 6.0e-8; /* a rounded float is off by at most 2^-24 = 5.96e-8 of its value */

/* Bytes of the payloads, field by field. */
enum {
    THRUST_BYTES = 2 + 4,
    THRUST_ANSWER_BYTES = THRUST_BYTES + 1 + 2 * CFID_MOTORS + 4,
    SINE_BYTES = 2 + 2 + 4 + 4,
    OWNER_BYTES = 4, /* after a request's or a keep-alive's own fields, from protocol 2 on */
    SINE_ANSWER_BYTES = SINE_BYTES + 1 + 1 + 4,
    ALIVE_BYTES = 4,
    STATE_BYTES = 4 + 1 + 2 * CFID_MOTORS + 4,
};

_Static_assert(THRUST_BYTES == 6 && THRUST_ANSWER_BYTES == 19, "the thrust payloads of cfid/wire/app.py");
_Static_assert(SINE_BYTES == 12 && SINE_ANSWER_BYTES == 18, "the sine payloads of cfid/wire/app.py");
_Static_assert(ALIVE_BYTES == 4 && STATE_BYTES == 17, "the keep-alive payloads of cfid/wire/app.py");
_Static_assert(LONGEST_ECHO + 8 == CFID_PAYLOAD, "the longest answer to a ping fills a packet");
_Static_assert(sizeof(float) == sizeof(uint32_t), "omega is a float of four bytes");
_Static_assert(sizeof(struct cfid_packet) == 3 + CFID_PAYLOAD, "a packet has no gaps");

enum thrust_channel { THRUST_SET = 0, THRUST_ANSWER = 2 };
enum sine_channel { SINE_START = 0, SINE_CROSSING = 0, SINE_DONE = 1, SINE_ANSWER = 2 };
enum ping_channel { PING_PING = 0, PING_HELLO = 1, PING_ALIVE = 2, PING_STOP = 3 };

enum verdict {
    ACCEPTED,
    WRONG_LENGTH,
    NO_SUCH_MOTOR,
    NO_KEEP_ALIVE,
    SINE_IS_RUNNING,
    MOTORS_NOT_ALLOWED,
    NO_SAMPLES,
    NO_FREQUENCY,
    NO_WHOLE_PERIODS,
    NOT_OWNER,
};

enum outcome { FINISHED, STOPPED, KEEP_ALIVE_LOST, NOT_ALLOWED };

enum flag { FLAG_ALLOWED = 1, FLAG_ALIVE = 2, FLAG_SINE = 4, FLAG_NOT_OWNER = 8 };

/* A sine plays; then its motors are off and it waits to report that; then it rests until it may send its `a`. */
enum stage { NO_SINE, PLAYING, OFF, RESTING };

/* Bytes. */

static uint64_t get(const uint8_t *data, int bytes)
{
    uint64_t value = 0;
    while (bytes-- > 0)
        value = value << 8 | data[bytes];
    return value;
}

static float get_float(const uint8_t *data)
{
    const uint32_t bits = (uint32_t)get(data, 4);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static void put(struct cfid_packet *packet, uint64_t value, int bytes)
{
    for (; bytes-- > 0; value >>= 8)
        packet->data[packet->size++] = (uint8_t)value;
}

static void put_commands(struct cfid_packet *packet, const uint16_t commands[CFID_MOTORS])
{
    for (int motor = 0; motor < CFID_MOTORS; motor++)
        put(packet, commands[motor], 2);
}

/* Returns whether a payload has this length, alone or followed by an owner. */
static bool has_length(const struct cfid_packet *request, uint8_t bytes)
{
    return request->size == bytes || request->size == bytes + OWNER_BYTES;
}

/* Returns the owner after a payload's own bytes, or 0 without one, as from a client of protocol 1. */
static uint32_t owner_of(const struct cfid_packet *request, uint8_t bytes)
{
    return request->size == bytes + OWNER_BYTES ? (uint32_t)get(request->data + bytes, OWNER_BYTES) : 0;
}

/* Repeats a request's own bytes, or zeros for a request of the wrong length. */
static void put_echo(struct cfid_packet *packet, const struct cfid_packet *request, uint8_t bytes)
{
    if (has_length(request, bytes))
        memcpy(packet->data, request->data, bytes);
    packet->size = bytes;
}

static struct cfid_packet new_packet(enum cfid_service service, int channel)
{
    return (struct cfid_packet){.service = (uint8_t)service, .channel = (uint8_t)channel};
}

static bool post(struct cfid_core *core, const struct cfid_packet *packet)
{
    if (core->waiting == CFID_OUTBOX)
        return false;
    core->outbox[(core->first + core->waiting) % CFID_OUTBOX] = *packet;
    core->waiting++;
    return true;
}

/* The sine. */

/* Returns cos(2 pi k/n) for k < n, exact where it is 0, 1/2 or 1, however a library rounds: only there can A cos be a
   whole number (Niven's theorem), where truncation would turn a rounding error into a whole unit. */
static double cosine(uint32_t k, uint32_t n)
{
    uint64_t j = 2 * (uint64_t)k; /* the angle is pi j/n */
    double sign = 1.0;
    if (j > n)
        j = 2 * (uint64_t)n - j;
    if (2 * j > n) {
        j = n - j;
        sign = -1.0;
    }
    if (3 * j == n)
        return sign * 0.5;
    if (4 * j > n)
        return sign * sin(PI * (double)(n - 2 * j) / (2.0 * (double)n));
    return sign * cos(PI * (double)j / (double)n);
}

/* Returns A cos(2 pi k/n) + B, truncated to an integer and not yet clipped.

   The target, whose arithmetic unit has single precision, computes doubles in software, for which it has two
   milliseconds a sample. In single precision one sample in 350 would be off by a unit. */
static int32_t sample_of(uint16_t amplitude, uint32_t k, uint32_t n)
{
    return (int32_t)((double)amplitude * cosine(k, n) + (double)MIDDLE);
}

static uint16_t clip(int32_t sample)
{
    return (uint16_t)(sample < 0 ? 0 : sample > LARGEST_COMMAND ? LARGEST_COMMAND : sample);
}

static uint32_t common_divisor(uint32_t a, uint32_t b)
{
    while (b) {
        const uint32_t rest = a % b;
        a = b;
        b = rest;
    }
    return a;
}

/* Returns whether the largest sample, at n = 0, or the smallest is clipped: l n/N takes all multiples of 1/m. */
static bool any_clipped(const struct cfid_sine *sine)
{
    const uint32_t m = sine->samples / common_divisor(sine->samples, sine->periods);
    const int32_t largest = sample_of(sine->amplitude, 0, m), smallest = sample_of(sine->amplitude, m / 2, m);
    return largest != clip(largest) || smallest != clip(smallest);
}

/* Recovers l from omega = 2 pi l/N, which the packet's float has rounded: used directly, it would shift samples by
   3.5 units at l = 1000 of N = 8000. */
static enum verdict find_periods(struct cfid_sine *sine, float omega)
{
    if (!(omega >= 0.0f && omega <= (float)PI)) /* also rejects NaN */
        return NO_FREQUENCY;
    const double exact = (double)omega * (double)sine->samples / (2.0 * PI), nearest = floor(exact + 0.5);
    if (nearest > (double)MOST_PERIODS || fabs(exact - nearest) > nearest * FLOAT_ROUNDING)
        return NO_WHOLE_PERIODS;
    sine->periods = (uint32_t)nearest;
    return ACCEPTED;
}

static enum verdict read_sine(struct cfid_sine *sine, const struct cfid_packet *request)
{
    if (!has_length(request, SINE_BYTES))
        return WRONG_LENGTH;
    const uint16_t motor = (uint16_t)get(request->data, 2);
    if (motor > CFID_MOTORS)
        return NO_SUCH_MOTOR;
    sine->motor = motor == ALL_MOTORS_SINE ? ALL_MOTORS_THRUST : (uint8_t)(motor - 1);
    sine->amplitude = (uint16_t)get(request->data + 2, 2);
    sine->samples = (uint32_t)get(request->data + 8, 4);
    if (sine->samples == 0)
        return NO_SAMPLES;
    const enum verdict verdict = find_periods(sine, get_float(request->data + 4));
    sine->clips = verdict == ACCEPTED && any_clipped(sine);
    return verdict;
}

/* The motors. */

static void drive(struct cfid_core *core, uint8_t motor, uint16_t command)
{
    for (uint8_t i = 0; i < CFID_MOTORS; i++)
        if (motor == ALL_MOTORS_THRUST || motor == i)
            core->commands[i] = command;
}

/* Reports a crossing of the middle, or that the motors are off; a crossing takes its number even without room. */
static bool report(struct cfid_core *core, uint16_t command, uint64_t now_us)
{
    struct cfid_packet crossing = new_packet(CFID_SINE, SINE_CROSSING);
    put(&crossing, command, 2);
    put(&crossing, core->sine.played, 4);
    put(&crossing, now_us, 4);
    put(&crossing, core->sine.reports, 2);
    return post(core, &crossing);
}

static bool report_done(struct cfid_core *core)
{
    struct cfid_packet done = new_packet(CFID_SINE, SINE_DONE);
    put(&done, 'a', 1);
    put(&done, core->sine.outcome, 1);
    put(&done, core->sine.played, 4);
    put(&done, core->sine.clipped, 4);
    return post(core, &done);
}

/* Advances an ended sine. Its last two packets wait for room and are never dropped. */
static void settle(struct cfid_core *core, uint64_t now_us)
{
    struct cfid_sine *sine = &core->sine;
    if (sine->stage == OFF && report(core, 0, sine->off_us))
        sine->stage = RESTING;
    if (sine->stage == RESTING && now_us - sine->off_us >= REST_US && report_done(core))
        sine->stage = NO_SINE;
}

static void stop(struct cfid_core *core, enum outcome outcome, uint64_t now_us)
{
    drive(core, ALL_MOTORS_THRUST, 0);
    if (core->sine.stage != PLAYING)
        return;
    core->sine.stage = OFF;
    core->sine.outcome = (uint8_t)outcome;
    core->sine.off_us = now_us;
    settle(core, now_us);
}

/* Clears the commands as soon as motors may not run, so that no later keep-alive can revive them. */
static void watch(struct cfid_core *core, uint64_t now_us, bool allowed)
{
    core->alive = cfid_core_alive(core, now_us);
    if (!core->alive)
        stop(core, KEEP_ALIVE_LOST, now_us);
    else if (!allowed)
        stop(core, NOT_ALLOWED, now_us);
}

static void play(struct cfid_core *core, uint64_t now_us)
{
    struct cfid_sine *sine = &core->sine;
    sine->held = !sine->held;
    if (!sine->held)
        return;
    if (sine->played == sine->samples) {
        stop(core, FINISHED, now_us);
        return;
    }
    const int32_t sample = sample_of(sine->amplitude, sine->phase, sine->samples);
    const uint16_t command = clip(sample), before = sine->command;
    const bool falls = before > MIDDLE && command <= MIDDLE, rises = before < MIDDLE && command >= MIDDLE;
    if (falls || rises) { /* the first sample too: A + 30000 rises from 0 */
        report(core, command, now_us);
        sine->reports++;
    }
    drive(core, sine->motor, command);
    sine->command = command;
    sine->clipped += sample != command;
    sine->phase = (uint32_t)(((uint64_t)sine->phase + sine->periods) % sine->samples);
    sine->played++;
}

/* Requests. */

/* Returns the verdict on a request that would start motors or change their commands. */
static enum verdict judge_owner(const struct cfid_core *core, uint32_t owner, bool allowed)
{
    if (!core->alive)
        return NO_KEEP_ALIVE;
    if (owner != core->owner)
        return NOT_OWNER;
    return allowed ? ACCEPTED : MOTORS_NOT_ALLOWED;
}

/* A zero command for all motors is a stop, which any client may send. */
static enum verdict judge_thrust(const struct cfid_core *core, uint16_t command, int32_t motor, uint32_t owner,
                                 bool allowed)
{
    if (motor < 0 || motor > ALL_MOTORS_THRUST)
        return NO_SUCH_MOTOR;
    if (command == 0 && motor == ALL_MOTORS_THRUST)
        return ACCEPTED;
    if (core->sine.stage != NO_SINE)
        return SINE_IS_RUNNING;
    if (command == 0 && (!core->alive || owner == core->owner))
        return ACCEPTED;
    return judge_owner(core, owner, allowed);
}

static void receive_thrust(struct cfid_core *core, const struct cfid_packet *request, uint64_t now_us, bool allowed)
{
    enum verdict verdict = WRONG_LENGTH;
    if (has_length(request, THRUST_BYTES)) {
        const uint16_t command = (uint16_t)get(request->data, 2);
        const int32_t motor = (int32_t)(uint32_t)get(request->data + 2, 4);
        verdict = judge_thrust(core, command, motor, owner_of(request, THRUST_BYTES), allowed);
        if (verdict == ACCEPTED && command == 0 && motor == ALL_MOTORS_THRUST)
            stop(core, STOPPED, now_us);
        else if (verdict == ACCEPTED)
            drive(core, (uint8_t)motor, command);
    }
    struct cfid_packet answer = new_packet(CFID_THRUST, THRUST_ANSWER);
    put_echo(&answer, request, THRUST_BYTES);
    put(&answer, verdict, 1);
    put_commands(&answer, core->commands);
    put(&answer, now_us, 4);
    post(core, &answer);
}

static void receive_sine(struct cfid_core *core, const struct cfid_packet *request, bool allowed)
{
    struct cfid_sine sine = {.stage = PLAYING};
    enum verdict verdict = read_sine(&sine, request);
    if (verdict == ACCEPTED)
        verdict = core->sine.stage != NO_SINE ? SINE_IS_RUNNING
                                              : judge_owner(core, owner_of(request, SINE_BYTES), allowed);
    if (verdict == ACCEPTED) {
        drive(core, ALL_MOTORS_THRUST, 0);
        core->sine = sine;
    }
    struct cfid_packet answer = new_packet(CFID_SINE, SINE_ANSWER);
    put_echo(&answer, request, SINE_BYTES);
    put(&answer, verdict, 1);
    put(&answer, sine.clips, 1);
    put(&answer, sine.periods, 4);
    post(core, &answer);
}

static void answer_hello(struct cfid_core *core, uint64_t now_us)
{
    struct cfid_packet hello = new_packet(CFID_PING, PING_HELLO);
    memcpy(hello.data, "cfid", 4);
    hello.size = 4;
    put(&hello, PROTOCOL, 1);
    put(&hello, SAMPLES_PER_S, 2);
    put(&hello, KEEP_ALIVE_MS, 2);
    put(&hello, now_us, 8);
    post(core, &hello);
}

/* A stop is accepted from any client, a keep-alive from the owner only. */
static void answer_state(struct cfid_core *core, const struct cfid_packet *request, uint64_t now_us, bool allowed,
                         bool counts)
{
    const int flags = (allowed ? FLAG_ALLOWED : 0) | (core->alive ? FLAG_ALIVE : 0) |
                      (core->sine.stage != NO_SINE ? FLAG_SINE : 0) | (counts ? 0 : FLAG_NOT_OWNER);
    struct cfid_packet state = new_packet(CFID_PING, request->channel);
    put_echo(&state, request, ALIVE_BYTES);
    put(&state, (uint64_t)flags, 1);
    put_commands(&state, core->commands);
    put(&state, now_us, 4);
    post(core, &state);
}

static bool is_revoked(const struct cfid_core *core, uint32_t owner)
{
    for (int i = 0; i < CFID_REVOKED; i++)
        if (owner != 0 && core->revoked[i] == owner)
            return true;
    return false;
}

/* Ends an owner's rights, until as many other owners have been revoked as fit into the list. */
static void revoke(struct cfid_core *core, uint32_t owner)
{
    if (owner == 0 || is_revoked(core, owner))
        return;
    core->revoked[core->next_revoked] = owner;
    core->next_revoked = (uint8_t)((core->next_revoked + 1) % CFID_REVOKED);
}

/* Takes a keep-alive and returns whether it is accepted: not while another client's is fresh, and not from a client
   whose motors a stop ended, for example one that was suspended meanwhile. */
static bool keep_alive(struct cfid_core *core, uint32_t owner, uint64_t now_us)
{
    if ((core->alive && owner != core->owner) || is_revoked(core, owner))
        return false;
    core->alive = true;
    core->owner = owner;
    core->alive_us = now_us;
    return true;
}

static void receive_ping(struct cfid_core *core, const struct cfid_packet *request, uint64_t now_us, bool allowed)
{
    if (request->channel == PING_HELLO) {
        answer_hello(core, now_us);
    } else if (request->channel == PING_ALIVE && has_length(request, ALIVE_BYTES)) {
        const bool counts = keep_alive(core, owner_of(request, ALIVE_BYTES), now_us);
        answer_state(core, request, now_us, allowed, counts);
    } else if (request->channel == PING_STOP) { /* of any length: a damaged stop is still a stop */
        core->alive = false;
        revoke(core, core->owner);
        core->stopped = true;
        stop(core, STOPPED, now_us);
        answer_state(core, request, now_us, allowed, true);
    }
}

size_t cfid_core_size(void)
{
    return sizeof(struct cfid_core);
}

void cfid_core_init(struct cfid_core *core)
{
    memset(core, 0, sizeof *core);
}

void cfid_core_receive(struct cfid_core *core, const struct cfid_packet *packet, uint64_t now_us,
                       const struct cfid_vehicle *vehicle)
{
    watch(core, now_us, vehicle->can_fly);
    if (packet->service == CFID_THRUST && packet->channel == THRUST_SET)
        receive_thrust(core, packet, now_us, vehicle->can_fly);
    else if (packet->service == CFID_SINE && packet->channel == SINE_START)
        receive_sine(core, packet, vehicle->can_fly);
    else if (packet->service == CFID_PING)
        receive_ping(core, packet, now_us, vehicle->can_fly);
}

/* Returns the smallest command at which a motor turns half as fast as at idle thrust: the supervisor measured at least
   1000 rpm there before it let the vehicle run, and takes a rotor below 500 rpm for blocked.

   Speed is assumed proportional to the throttle that DSHOT carries: a command's upper 11 bits, of which values up to 47
   mean none. */
static uint16_t slowest_without(uint16_t idle)
{
    const int throttle = (idle >> DSHOT_SHIFT) - DSHOT_NONE;
    if (throttle <= 0)
        return idle;
    return (uint16_t)((DSHOT_NONE + (throttle + 1) / 2) << DSHOT_SHIFT);
}

/* Gives the firmware the commands and the other orders.

   The setpoint stays fresh until the vehicle has left Flying: in that state the supervisor locks it when a setpoint
   grows old, and every client of the stock library leaves one on closing.

   A vehicle that needs arming is disarmed when its motors stop. Rotors that coast down from idle thrust pass 1 to
   499 rpm, where the supervisor, while it lets them run, takes them for blocked and locks the vehicle.

   For the same reason a motor at zero keeps its idle thrust while others run, and so does one below half of it. */
static void give_orders(struct cfid_core *core, const struct cfid_vehicle *vehicle, struct cfid_orders *orders)
{
    bool runs = core->sine.stage == PLAYING;
    uint16_t slowest = LARGEST_COMMAND;
    for (int motor = 0; motor < CFID_MOTORS; motor++) {
        runs = runs || core->commands[motor] != 0;
        slowest = core->commands[motor] < slowest ? core->commands[motor] : slowest;
    }
    memcpy(orders->commands, core->commands, sizeof core->commands);
    orders->holds = core->alive;
    orders->feeds = core->alive || (core->fed && vehicle->flying);
    orders->idles_off = core->alive && vehicle->can_fly && vehicle->idle > 0 &&
                        slowest >= slowest_without(vehicle->idle);
    orders->disarms = vehicle->needs_arming &&
                      (core->stopped || (core->ran && !runs) || (core->held && !core->alive));
    core->held = core->alive;
    core->ran = runs;
    core->fed = orders->feeds;
    core->stopped = false;
}

void cfid_core_tick(struct cfid_core *core, uint64_t now_us, const struct cfid_vehicle *vehicle,
                    struct cfid_orders *orders)
{
    watch(core, now_us, vehicle->can_fly);
    if (core->sine.stage == PLAYING)
        play(core, now_us);
    settle(core, now_us);
    give_orders(core, vehicle, orders);
}

bool cfid_core_send(struct cfid_core *core, struct cfid_packet *out)
{
    if (core->waiting == 0)
        return false;
    *out = core->outbox[core->first];
    core->first = (uint8_t)((core->first + 1) % CFID_OUTBOX);
    core->waiting--;
    return true;
}

bool cfid_core_alive(const struct cfid_core *core, uint64_t now_us)
{
    return core->alive && now_us - core->alive_us < KEEP_ALIVE_MS * US_PER_MS;
}

bool cfid_answer_ping(const struct cfid_packet *packet, uint64_t now_us, struct cfid_packet *out)
{
    if (packet->service != CFID_PING || packet->channel != PING_PING)
        return false;
    *out = new_packet(CFID_PING, PING_PING);
    if (packet->size == 0)
        return true;
    out->size = packet->size < LONGEST_ECHO ? packet->size : LONGEST_ECHO;
    memcpy(out->data, packet->data, out->size);
    put(out, now_us, 8);
    return true;
}
