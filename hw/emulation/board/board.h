/* The board: simavr's ATmega328P, what is on its pins, and how to disturb it. */
#ifndef BOARD_H
#define BOARD_H

#include <stdbool.h>
#include <stdint.h>

#include <sim_avr.h>

#define CLOCK_HZ 16000000

extern avr_t *avr;

/* Load a firmware and switch on. */
void board_make(const char *hex);

/* Run until `board_stop_running`, or end the program with a message if the firmware crashes. */
void board_run(void);
void board_stop_running(void);

/* Call `restart` now and after each reset: simavr forgets all its timers then. */
void board_on_reset(void (*restart)(void));

/* Pulses on the trigger input, the first after `cycles`, in place of those that are still to come; `period` is 2 or more. */
void board_trigger(uint64_t cycles, uint64_t pulses, uint64_t period);

/* Stop the program where it is, interrupts off, until a reset. */
void board_hang(void);

/* Print what the pins did, a line each. */
void board_print_events(void);

/* Print why, and end. */
void fail(const char *why);

#endif
