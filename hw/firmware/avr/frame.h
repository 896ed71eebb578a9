/* Frames on the line: COBS (Cheshire & Baker 1999), CRC-16/CCITT-FALSE, low byte first, 0x00 at the end. */
#ifndef FRAME_H
#define FRAME_H

#include <stdbool.h>
#include <stdint.h>

#include "program.h"

/* Laid out like the body, so that a payload is used where it lies. */
struct frame {
    uint8_t op;
    uint8_t seq;
    union {
        struct program program;
        uint8_t payload[sizeof(struct program)];
    };
    uint16_t length; /* of the whole payload; what does not fit is counted and checked, not kept */
    uint16_t crc;
};

/* Take one byte off the line; true when it ends a good frame. */
bool frame_take(struct frame *frame, uint8_t byte);

/* Frames that were spoilt, up to 255. */
uint8_t frame_bad(void);

/* Send a body of 1..252 bytes. */
void frame_send(const uint8_t *body, uint8_t length);

#endif
