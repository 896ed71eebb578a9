#include "board.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <avr_ioport.h>
#include <sim_core.h>
#include <sim_hex.h>

enum pin { SHUTTER, BUSY, TRIGGER, PINS };
static const char *const names[PINS] = {"shutter", "busy", "trigger"};

struct event {
    uint64_t cycle;
    uint8_t pin, level;
};

avr_t *avr;

static struct event *events;
static size_t event_count, event_room;
static uint8_t levels[PINS];
static avr_irq_t *trigger_input;
static struct {
    uint64_t left, period; /* pulses to come, and cycles from one to the next */
} train;

static bool stop_running, was_reset;
static void (*restart_timers)(void);
static void (*core_reset)(avr_t *);

static bool hung;
static uint32_t hung_at;
static uint8_t code_there[2];

void fail(const char *why)
{
    printf("ERROR %s\n", why);
    fflush(stdout);
    exit(1);
}

static void note(enum pin pin, uint8_t level)
{
    if (levels[pin] == level)
        return;
    levels[pin] = level;
    if (event_count == event_room) {
        event_room = event_room ? 2 * event_room : 1024;
        events = realloc(events, event_room * sizeof *events);
        if (!events)
            fail("out of memory");
    }
    events[event_count++] = (struct event){avr->cycle, pin, level};
}

static void pin_changed(avr_irq_t *irq, uint32_t value, void *pin)
{
    (void)irq;
    note((enum pin)(intptr_t)pin, value & 1);
}

/* After a reset all pins are inputs, and resistors pull them down. */
static void pins_reset(avr_t *core)
{
    if (hung)
        memcpy(core->flash + hung_at, code_there, 2);
    hung = false;
    note(SHUTTER, 0);
    note(BUSY, 0);
    was_reset = true;
    if (core_reset)
        core_reset(core);
}

static void log_errors(avr_t *core, const int level, const char *format, va_list list)
{
    (void)core;
    if (level <= LOG_ERROR)
        vfprintf(stderr, format, list);
}

/* simavr's own sleeps as long as the program does; the pace is kept elsewhere. */
static void no_sleep(avr_t *core, avr_cycle_count_t cycles)
{
    (void)core;
    (void)cycles;
}

static avr_irq_t *pin_of(char port, int pin)
{
    return avr_io_getirq(avr, AVR_IOCTL_IOPORT_GETIRQ(port), pin);
}

void board_make(const char *hex)
{
    uint32_t size, start;
    uint8_t *code;

    avr_global_logger_set(log_errors);
    code = read_ihex_file(hex, &size, &start);
    if (!code || !size)
        fail("the firmware is no Intel hex file");
    avr = avr_make_mcu_by_name("atmega328p");
    if (!avr || avr_init(avr))
        fail("simavr has no ATmega328P");
    if (start + size > avr->flashend + 1)
        fail("the firmware does not fit into an ATmega328P");
    avr->frequency = CLOCK_HZ;
    avr->log = LOG_ERROR;
    avr_loadcode(avr, code, size, start);
    avr->codeend = avr->flashend;
    avr->sleep = no_sleep;
    core_reset = avr->reset;
    avr->reset = pins_reset;
    avr_irq_register_notify(pin_of('B', 1), pin_changed, (void *)(intptr_t)SHUTTER);
    avr_irq_register_notify(pin_of('C', 1), pin_changed, (void *)(intptr_t)BUSY);
    trigger_input = pin_of('D', 2);
}

static avr_cycle_count_t toggle_trigger(avr_t *core, avr_cycle_count_t when, void *unused)
{
    uint64_t high = train.period / 2;
    uint8_t level = !levels[TRIGGER];

    (void)core;
    (void)unused;
    note(TRIGGER, level);
    avr_raise_irq(trigger_input, level);
    if (level) {
        train.left--;
        return when + high;
    }
    return train.left ? when + train.period - high : 0;
}

void board_trigger(uint64_t cycles, uint64_t pulses, uint64_t period)
{
    train.left = pulses;
    train.period = period;
    avr_cycle_timer_register(avr, cycles, toggle_trigger, NULL);
}

void board_on_reset(void (*restart)(void))
{
    restart_timers = restart;
    restart_timers();
}

void board_run(void)
{
    for (stop_running = false; !stop_running;) {
        int state = avr_run(avr);

        if (state == cpu_Done || state == cpu_Crashed)
            fail("the firmware crashed");
        if (was_reset) {
            restart_timers();
            if (train.left || levels[TRIGGER]) /* they come from outside and go on */
                avr_cycle_timer_register(avr, train.period / 2, toggle_trigger, NULL);
        }
        was_reset = false;
    }
}

void board_stop_running(void)
{
    stop_running = true;
}

void board_hang(void)
{
    static const uint8_t jump_to_itself[2] = {0xFF, 0xCF};

    if (!hung) {
        hung_at = avr->pc;
        memcpy(code_there, avr->flash + hung_at, 2);
        memcpy(avr->flash + hung_at, jump_to_itself, 2);
        hung = true;
    }
    avr_sreg_set(avr, S_I, 0);
    if (avr->state == cpu_Sleeping) /* simavr ends where a program sleeps for ever */
        avr->state = cpu_Running;
}

void board_print_events(void)
{
    for (size_t k = 0; k < event_count; k++)
        printf("%llu %s %d\n", (unsigned long long)events[k].cycle, names[events[k].pin], events[k].level);
}
