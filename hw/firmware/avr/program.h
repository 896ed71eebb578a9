/* The stored program: chips and their time, as LOAD sends and READ returns them. */
#ifndef PROGRAM_H
#define PROGRAM_H

#include <stdint.h>

#include "board.h"

/* Little endian like the wire, without gaps: the payload itself. */
struct program {
    uint32_t ticks;
    uint16_t fraction;
    uint16_t chips;
    uint8_t bits[MAX_CHIPS / 8];
};

#define PROGRAM_HEADER 8

/* Error code of a LOAD with this payload; `length` may be more than a struct program holds, and is then an error. */
uint8_t program_check(const struct program *program, uint16_t length);

uint16_t program_size(const struct program *program);

/* Milliseconds from a trigger to the end of the last chip, rounded up. */
uint16_t program_ms(const struct program *program);

/* CRC-32 of zlib over the payload. */
uint32_t program_crc32(const struct program *program);

#endif
