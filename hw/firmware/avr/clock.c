/* Timer 2, since it alone has a prescaler of its own: Timer 1's is reset by each trigger. */
#include "clock.h"

#include <avr/interrupt.h>
#include <util/atomic.h>

#include "board.h"
#include "player.h"

#define US_A_COUNT (64 * 1000000UL / F_CPU)

static volatile uint32_t whole_ms_us;

void clock_init(void)
{
    TCCR2A = _BV(WGM21);
    OCR2A = 1000 / US_A_COUNT - 1;
    TCNT2 = 0;
    TIFR2 = _BV(OCF2A);
    TIMSK2 = _BV(OCIE2A);
    TCCR2B = _BV(CS22); /* clk / 64 */
}

/* Interruptible: a trigger must not wait for it. */
ISR(TIMER2_COMPA_vect, ISR_NOBLOCK)
{
    whole_ms_us += 1000;
    player_tick();
}

uint32_t clock_us(void)
{
    uint32_t us;
    uint8_t count;

    ATOMIC_BLOCK(ATOMIC_RESTORESTATE) {
        us = whole_ms_us;
        count = TCNT2;
        /* A millisecond may have ended that its interrupt has not yet counted; a high count was read before its end. */
        if ((TIFR2 & _BV(OCF2A)) && count < 128)
            us += 1000;
    }
    return us + count * US_A_COUNT;
}
