/* Milliseconds and microseconds since boot, from Timer 2. */
#ifndef CLOCK_H
#define CLOCK_H

#include <stdint.h>

void clock_init(void);

/* Microseconds since boot, in steps of 4, mod 2^32. */
uint32_t clock_us(void);

#endif
