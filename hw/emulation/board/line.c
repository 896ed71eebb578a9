#include "line.h"

#include <fcntl.h>
#include <pty.h>
#include <stdbool.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

#include <avr_uart.h>

#include "board.h"

#define CYCLES_A_BYTE 1389 /* ten bits at 115200 baud */
#define QUEUE 4096

static int master = -1, slave = -1;
static uint8_t queue[QUEUE]; /* from the host to the board */
static size_t head, tail;
static bool feeding, uart_ready = true;
static avr_irq_t *uart_input;

static double noise;
static uint64_t random_state;

/* xorshift64* */
double chance(void)
{
    random_state ^= random_state >> 12;
    random_state ^= random_state << 25;
    random_state ^= random_state >> 27;
    return (double)((random_state * 2685821657736338717ULL) >> 11) / 9007199254740992.0;
}

/* One byte through a bad cable: 0, 1 or 2 bytes come out. */
static size_t worn(uint8_t byte, uint8_t out[2])
{
    out[0] = out[1] = byte;
    if (chance() >= noise)
        return 1;
    switch ((int)(chance() * 3)) {
    case 0:
        return 0;
    case 1:
        out[0] ^= 1 << (int)(chance() * 8);
        return 1;
    }
    return 2;
}

static void board_sent(avr_irq_t *irq, uint32_t value, void *unused)
{
    uint8_t bytes[2];
    size_t count = worn(value, bytes);

    (void)irq;
    (void)unused;
    if (master >= 0 && count && write(master, bytes, count) < 0) {
        /* nobody reads, and a UART has no memory either */
    }
}

static void uart_says(avr_irq_t *irq, uint32_t value, void *ready)
{
    (void)irq;
    if (value)
        uart_ready = ready != NULL;
}

static avr_cycle_count_t feed(avr_t *core, avr_cycle_count_t when, void *unused)
{
    (void)core;
    (void)unused;
    if (head == tail) {
        feeding = false;
        return 0;
    }
    if (uart_ready)
        avr_raise_irq(uart_input, queue[tail++ % QUEUE]);
    return when + CYCLES_A_BYTE;
}

static void feed_from_now(void)
{
    feeding = head != tail;
    if (feeding)
        avr_cycle_timer_register(avr, CYCLES_A_BYTE, feed, NULL);
}

void line_fetch(void)
{
    uint8_t bytes[256], through[2];
    ssize_t count;

    if (master < 0 || QUEUE - (head - tail) < 2 * sizeof bytes)
        return;
    count = read(master, bytes, sizeof bytes);
    for (ssize_t k = 0; k < count; k++) {
        size_t copies = worn(bytes[k], through);

        for (size_t c = 0; c < copies; c++)
            queue[head++ % QUEUE] = through[c];
    }
    if (!feeding)
        feed_from_now();
}

void line_restart(void)
{
    avr_cycle_timer_cancel(avr, feed, NULL);
    uart_ready = true;
    feed_from_now();
}

const char *line_plug(void)
{
    struct termios raw;

    line_unplug();
    memset(&raw, 0, sizeof raw);
    cfmakeraw(&raw);
    raw.c_cflag |= CREAD | CLOCAL;
    /* The slave stays open here too, or the master fails whenever no host has it open. */
    if (openpty(&master, &slave, NULL, &raw, NULL) || fcntl(master, F_SETFL, O_NONBLOCK))
        fail("no pseudo-terminal can be opened");
    return ttyname(slave);
}

void line_unplug(void)
{
    if (master >= 0) {
        close(master);
        close(slave);
    }
    master = slave = -1;
    tail = head;
}

int line_descriptor(void)
{
    return master;
}

void line_make(double how_noisy, uint64_t seed)
{
    uint32_t no_flags = 0; /* simavr would print what is sent, and sleep when it is polled */

    noise = how_noisy;
    random_state = 88172645463325252ULL ^ (seed * 0x9E3779B97F4A7C15ULL);
    for (int k = 0; k < 10; k++)
        chance(); /* like seeds grow apart */
    avr_ioctl(avr, AVR_IOCTL_UART_SET_FLAGS('0'), &no_flags);
    uart_input = avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_INPUT);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUTPUT), board_sent, NULL);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XON), uart_says, (void *)1);
    avr_irq_register_notify(avr_io_getirq(avr, AVR_IOCTL_UART_GETIRQ('0'), UART_IRQ_OUT_XOFF), uart_says, NULL);
}
