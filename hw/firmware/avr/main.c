/* CXP1 shutter controller on an ATmega328P. */
#include <avr/interrupt.h>
#include <avr/sleep.h>
#include <avr/wdt.h>

#include "clock.h"
#include "frame.h"
#include "player.h"
#include "protocol.h"
#include "uart.h"

/* Between two bytes; the clock's interrupt ends it after a millisecond at most. A trigger met asleep is met at once. */
static void rest(void)
{
    cli();
    if (uart_is_empty()) {
        sleep_enable();
        sei(); /* takes effect after the next instruction: no byte can come between the look and the sleep */
        sleep_cpu();
        sleep_disable();
    }
    sei();
}

int main(void)
{
    static struct frame frame;
    uint8_t byte;

    player_init();
    clock_init();
    uart_init();
    set_sleep_mode(SLEEP_MODE_IDLE);
    wdt_enable(WDTO_60MS);
    for (;;) {
        wdt_reset(); /* here and nowhere else: whatever hangs is reset, and a reset is closed */
        if (!uart_get(&byte))
            rest();
        else if (frame_take(&frame, byte))
            protocol_serve(&frame);
    }
}
