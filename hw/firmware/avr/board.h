/* The board: an ATmega328P at 16 MHz (Arduino Uno, Nano), and what this firmware promises on it. */
#ifndef BOARD_H
#define BOARD_H

#include <avr/io.h>

#ifndef F_CPU
#define F_CPU 16000000UL
#endif

/* Shutter: D9 = PB1 = OC1A. Nothing else may use port B: writes to it must not come near the shutter's pin. */
#define SHUTTER_PIN PB1
/* Busy: A1 = PC1, high while a program plays. */
#define BUSY_PIN PC1
/* Trigger input: D2 = PD2 = INT0, rising edge. */
#define TRIGGER_PIN PD2

#define BAUD 115200UL

/* Timer 1 counts clk / 8. */
#define TICK_NS 500
#define MIN_TICKS 100
#define MAX_TICKS 65535
#define MAX_CHIPS 1024

/* From a trigger to the first chip. The code from the trigger's edge to the timer's start takes START_CODE_TICKS of it. */
#define LEAD_TICKS 40
#define START_CODE_TICKS 4

/* Limits of the shutter, from `make firmware MAX_ON_US=... MAX_DUTY_PERMILLE=...`. 0 and 1000 are no limit. */
#ifndef MAX_ON_US
#define MAX_ON_US 0
#endif
#ifndef MAX_DUTY_PERMILLE
#define MAX_DUTY_PERMILLE 1000
#endif
#define MAX_ON_TICKS (MAX_ON_US * 1000UL / TICK_NS)
#define LIMITS_DUTY (MAX_DUTY_PERMILLE < 1000)
#if MAX_ON_US < 0 || MAX_ON_US > 4000000
#error "MAX_ON_US must be 0 (no limit) .. 4000000"
#endif
#if MAX_DUTY_PERMILLE < 1 || MAX_DUTY_PERMILLE > 1000
#error "MAX_DUTY_PERMILLE must be 1 .. 1000 (no limit)"
#endif

#endif
