/* UART 0, 115200 baud 8N1. */
#ifndef UART_H
#define UART_H

#include <stdbool.h>
#include <stdint.h>

void uart_init(void);

/* Whether a byte was there. */
bool uart_get(uint8_t *byte);

bool uart_is_empty(void);

/* Waits for room. */
void uart_put(uint8_t byte);

#endif
