#include "player.h"

#include <avr/interrupt.h>
#include <stdbool.h>
#include <string.h>
#include <util/atomic.h>

#include "protocol.h"

/* A call inside an interrupt makes the compiler save every register: the shutter's ways are short instead. */
#define QUICK static inline __attribute__((always_inline))

#define CLOSE_ON_MATCH _BV(COM1A1)
#define OPEN_ON_MATCH (_BV(COM1A1) | _BV(COM1A0))
#define CTC_STOPPED _BV(WGM12)
#define CTC_RUNNING (_BV(WGM12) | _BV(CS11))

static struct program stored;
static uint32_t stored_crc32;
static uint16_t stored_ms;

static volatile uint8_t state;
static volatile uint16_t begun;
static volatile uint16_t plays;
static volatile uint8_t missed;
static volatile uint16_t lease_ms;

/* A play that is cut short owes the closed chips that its limit counted on: none is armed before it would have ended.
 * Written when it is armed and left alone by a reset, since that cuts it short too; noise unless the two agree. */
static volatile uint16_t owed_ms __attribute__((section(".noinit")));
static volatile uint16_t owed_ms_inverted __attribute__((section(".noinit")));

static uint16_t phase; /* fraction of a tick by which the ideal edge is ahead, plus a half for rounding */
static uint16_t first_count; /* of the timer, for the lead */
static const uint8_t *next_byte;
static uint8_t next_mask;

QUICK void owe(uint16_t ms)
{
    if (!LIMITS_DUTY)
        return;
    owed_ms = ms;
    owed_ms_inverted = ~ms;
}

/* The one way to be closed, whatever happened. Interrupts are off. */
QUICK void close_shutter(void)
{
    /* The compare unit's own latch must go low, not only the pin: an opened latch would show when it is next connected. */
    TCCR1A = CLOSE_ON_MATCH;
    TCCR1C = _BV(FOC1A);
    TCCR1B = CTC_STOPPED;
    TCCR1A = 0; /* now the pin is the port's */
    PORTB &= ~_BV(SHUTTER_PIN);
    TIMSK1 = 0;
    EIMSK = 0;
    PORTC &= ~_BV(BUSY_PIN);
}

static void close_and_rest(void)
{
    close_shutter();
    if (LIMITS_DUTY && state == ARMED)
        owe(0); /* nothing was played */
    state = stored.chips ? LOADED : IDLE;
}

/* Tell the compare unit what the next match does. */
QUICK void preset_level(bool last)
{
    TCCR1A = !last && (*next_byte & next_mask) ? OPEN_ON_MATCH : CLOSE_ON_MATCH;
    next_mask >>= 1;
    if (!next_mask) {
        next_mask = 0x80;
        next_byte++;
    }
}

/* All is prepared while arming, so that a trigger is a few register writes away from the running timer. */
static void prepare(void)
{
    owe(stored_ms);
    begun = 0;
    phase = 0x8000;
    next_byte = stored.bits;
    next_mask = 0x80;
    TCCR1B = CTC_STOPPED;
    OCR1A = stored.ticks - 1;
    first_count = stored.ticks - (LEAD_TICKS - START_CODE_TICKS);
    GTCCR = _BV(TSM) | _BV(PSRSYNC); /* the prescaler is held: running, it would let the timer begin at any phase */
    preset_level(false);
    TIFR1 = _BV(OCF1A);
    TIMSK1 = _BV(OCIE1A);
    EIFR = _BV(INTF0); /* an edge that came before is no trigger */
    EIMSK = _BV(INT0);
}

QUICK void start(void)
{
    TCCR1B = CTC_RUNNING;
    TCNT1 = first_count;
    GTCCR = 0; /* the prescaler begins */
    EIMSK = 0;
    state = PLAY;
    PORTC |= _BV(BUSY_PIN);
}

ISR(INT0_vect)
{
    start();
}

/* Runs just after the hardware has put a chip's level on the pin. */
ISR(TIMER1_COMPA_vect)
{
    uint16_t top = stored.ticks - 1;

    if (begun == stored.chips) {
        close_shutter();
        owe(0);
        state = DONE;
        plays++;
        return;
    }
    begun++;
    phase += stored.fraction;
    if (phase < stored.fraction)
        top++;
    if (OCR1A != top)
        OCR1A = top;
    preset_level(begun == stored.chips);
    /* A match that has come already, or been jumped over, was played without being told its level. */
    if ((TIFR1 & _BV(OCF1A)) || TCNT1 > top) {
        close_shutter();
        state = FAULT;
        if (missed < 255)
            missed++;
    }
}

void player_init(void)
{
    PORTC &= ~_BV(BUSY_PIN);
    DDRC |= _BV(BUSY_PIN);
    EICRA = _BV(ISC01) | _BV(ISC00);
    if (LIMITS_DUTY && owed_ms_inverted != (uint16_t)~owed_ms)
        owe(0); /* power has been off */
    close_and_rest();
}

uint8_t player_load(const struct program *program, uint16_t length)
{
    uint8_t error;

    if (state != IDLE && state != LOADED && state != DONE)
        return WRONG_STATE;
    error = program_check(program, length);
    if (error)
        return error;
    memcpy(&stored, program, length);
    stored_crc32 = program_crc32(&stored);
    if (LIMITS_DUTY)
        stored_ms = program_ms(&stored);
    begun = 0;
    state = LOADED;
    return OK;
}

uint8_t player_read(const struct program **program)
{
    *program = &stored;
    return state == IDLE ? WRONG_STATE : OK;
}

uint8_t player_arm(const uint8_t *payload, uint16_t length)
{
    uint8_t error = OK;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        uint16_t lease = payload[0] | (uint16_t)payload[1] << 8;

        if (state != LOADED && state != ARMED && state != DONE)
            error = WRONG_STATE;
        else if (length != 2)
            error = BAD_LENGTH;
        else if (!lease)
            error = OUT_OF_RANGE;
        else if (LIMITS_DUTY && state != ARMED && owed_ms)
            error = DUTY_LIMIT;
        else {
            lease_ms = lease;
            if (state != ARMED)
                prepare();
            state = ARMED;
        }
    }
    return error;
}

uint8_t player_trigger(uint16_t length)
{
    uint8_t error = OK;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (state != ARMED)
            error = WRONG_STATE;
        else if (length)
            error = BAD_LENGTH;
        else
            start();
    }
    return error;
}

void player_abort(void)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        close_and_rest();
    }
}

void player_status(struct player_status *status)
{
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        status->state = state;
        status->begun = begun;
        status->plays = plays;
        status->missed = missed;
    }
    status->crc32 = stored_crc32;
}

void player_tick(void)
{
    if (LIMITS_DUTY && state != ARMED)
        ATOMIC_BLOCK(ATOMIC_RESTORESTATE) { /* the last chip may end meanwhile */
            if (owed_ms)
                owe(owed_ms - 1);
        }
    if (state != ARMED || --lease_ms)
        return;
    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        if (state == ARMED) /* no trigger has come meanwhile */
            close_and_rest();
    }
}
