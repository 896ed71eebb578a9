#include "protocol.h"

#include <stdbool.h>
#include <string.h>

#include "clock.h"
#include "player.h"
#include "reset.h"

#define VERSION 1
#define TAKES_FRACTIONS 1
#define HAS_TRIGGER_INPUT 2

enum op { HELLO = 1, LOAD, READ, ARM, TRIG, ABORT, STATUS };

struct hello {
    char magic[4];
    uint8_t version, flags;
    uint16_t max_chips, tick_ns;
    uint32_t min_ticks, max_ticks, max_on_ticks;
    uint16_t max_duty_permille;
    uint32_t lead_ns;
    uint8_t reset_cause;
    char name[9];
};

/* Kept whole: a reply that was lost is sent again from here. */
static struct {
    uint8_t op, seq, error;
    union {
        uint8_t bytes[sizeof(struct program)];
        struct hello hello;
        uint32_t crc32;
    } data;
} reply;
static uint8_t reply_size; /* 0: nothing was answered yet */
static uint16_t answered_crc;

_Static_assert(sizeof(reply) == 3 + sizeof(struct program), "the reply is sent as it lies in memory");
_Static_assert(sizeof(struct hello) == 38, "HELLO is sent as it lies in memory");

static void say_hello(void)
{
    static const struct hello hello = {
        .magic = "CXP1",
        .version = VERSION,
        .flags = TAKES_FRACTIONS | HAS_TRIGGER_INPUT,
        .max_chips = MAX_CHIPS,
        .tick_ns = TICK_NS,
        .min_ticks = MIN_TICKS,
        .max_ticks = MAX_TICKS,
        .max_on_ticks = MAX_ON_TICKS,
        .max_duty_permille = MAX_DUTY_PERMILLE,
        .lead_ns = (uint32_t)LEAD_TICKS * TICK_NS,
        .name = "cxp-avr 1",
    };

    reply.data.hello = hello;
    reply.data.hello.reset_cause = reset_cause();
}

static uint8_t *put(uint8_t *at, const void *value, uint8_t size)
{
    memcpy(at, value, size); /* little endian here as there */
    return at + size;
}

static uint8_t put_status(void)
{
    struct player_status player;
    uint32_t us = clock_us();
    uint8_t bad = frame_bad();
    uint8_t *at = reply.data.bytes;

    player_status(&player);
    at = put(at, &player.state, 1);
    at = put(at, &player.begun, 2);
    at = put(at, &player.plays, 2);
    at = put(at, &player.missed, 1);
    at = put(at, &bad, 1);
    at = put(at, &us, 4);
    at = put(at, &player.crc32, 4);
    return at - reply.data.bytes;
}

/* Returns the error code, and through `size` that of the reply's data. */
static uint8_t obey(const struct frame *request, uint8_t *size)
{
    const struct program *stored;
    struct player_status player;
    uint16_t length = request->length;
    uint8_t error;

    *size = 0;
    switch (request->op) {
    case LOAD:
        error = player_load(&request->program, length);
        if (!error) {
            player_status(&player);
            reply.data.crc32 = player.crc32;
            *size = 4;
        }
        return error;
    case READ:
        error = player_read(&stored);
        if (error)
            return error;
        if (length)
            return BAD_LENGTH;
        *size = program_size(stored);
        memcpy(reply.data.bytes, stored, *size);
        return OK;
    case ARM:
        return player_arm(request->payload, length);
    case TRIG:
        return player_trigger(length);
    case HELLO:
    case ABORT:
    case STATUS:
        if (length)
            return BAD_LENGTH;
        if (request->op == HELLO) {
            say_hello();
            *size = sizeof(struct hello);
        } else if (request->op == ABORT) {
            player_abort();
        } else {
            *size = put_status();
        }
        return OK;
    }
    return BAD_OP;
}

void protocol_serve(const struct frame *request)
{
    uint8_t op = request->op | 0x80;
    uint8_t size;

    if (!reply_size || reply.op != op || reply.seq != request->seq || answered_crc != request->crc) {
        reply.error = obey(request, &size);
        reply.op = op;
        reply.seq = request->seq;
        answered_crc = request->crc;
        reply_size = 3 + size;
    }
    frame_send((const uint8_t *)&reply, reply_size);
}
