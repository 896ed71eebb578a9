/* What happens before anything else, and why it happened. */
#ifndef RESET_H
#define RESET_H

#include <stdint.h>

/* Cause of the last reset, as HELLO tells it. */
uint8_t reset_cause(void);

#endif
