/* The serial line: the board's UART on a pseudo-terminal, and noise on the way. */
#ifndef LINE_H
#define LINE_H

#include <stdint.h>

/* `noise`: chance per byte and each way of a loss, a changed bit or a doubling. */
void line_make(double noise, uint64_t seed);

/* Open a new pseudo-terminal; its name. */
const char *line_plug(void);

void line_unplug(void);

/* Its descriptor, -1 when unplugged. */
int line_descriptor(void);

/* Fetch what a host has written. */
void line_fetch(void);

/* After a reset. */
void line_restart(void);

/* Uniform in [0, 1). */
double chance(void);

#endif
