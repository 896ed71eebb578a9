#include "reset.h"

#include <avr/wdt.h>

#include "board.h"

enum cause { POWER, RESET_LINE, BROWN_OUT, WATCHDOG, UNKNOWN = 255 };

static uint8_t flags __attribute__((section(".noinit"))); /* written before the C library clears the rest */

/* Before main, before memory is cleared: the pin is driven low, and a watchdog still running from before is stopped. */
void reset_first(void) __attribute__((naked, used, section(".init3")));
void reset_first(void)
{
    PORTB &= ~_BV(SHUTTER_PIN);
    DDRB |= _BV(SHUTTER_PIN);
    flags = MCUSR;
    MCUSR = 0; /* the watchdog cannot be stopped while it says that it fired */
    wdt_disable();
}

uint8_t reset_cause(void)
{
    if (flags & _BV(PORF))
        return POWER;
    if (flags & _BV(WDRF))
        return WATCHDOG;
    if (flags & _BV(BORF))
        return BROWN_OUT;
    if (flags & _BV(EXTRF))
        return RESET_LINE;
    return UNKNOWN; /* a bootloader has taken the flags */
}
