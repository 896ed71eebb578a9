#include "frame.h"

#include <stddef.h>
#include <util/crc16.h>

#include "uart.h"

#define CRC_START 0xFFFF
#define BODY_HEADER 2

static uint8_t bad;

/* Of the frame being received. */
static bool begun;        /* a byte has come */
static uint8_t left;      /* bytes of the present COBS block */
static bool zero_is_due;  /* between this block and the next, if there is one */
static uint16_t decoded;  /* bytes, with their CRC; stops at 65535 */
static uint16_t last_two; /* decoded bytes; they may be the CRC, and are taken for the body when others follow */
static uint16_t crc;

static void begin(void)
{
    begun = false;
    left = 0;
    zero_is_due = false;
    decoded = 0;
    crc = CRC_START;
}

static void take_decoded(struct frame *frame, uint8_t byte)
{
    if (decoded >= 2) {
        uint16_t at = decoded - 2;
        uint8_t body = last_two; /* its low byte came first */

        crc = _crc_xmodem_update(crc, body);
        if (at < offsetof(struct frame, length))
            ((uint8_t *)frame)[at] = body;
    }
    last_two = last_two >> 8 | (uint16_t)byte << 8;
    if (decoded < 0xFFFF)
        decoded++;
}

static bool end(struct frame *frame)
{
    bool good = left == 0 && decoded >= BODY_HEADER + 2 && crc == last_two;

    if (good) {
        frame->length = decoded - 2 - BODY_HEADER;
        frame->crc = crc;
    } else if (begun && bad < 255) {
        bad++;
    }
    begin();
    return good;
}

bool frame_take(struct frame *frame, uint8_t byte)
{
    if (!byte)
        return end(frame);
    if (!begun)
        begin();
    begun = true;
    if (left) {
        take_decoded(frame, byte);
        left--;
    } else {
        if (zero_is_due)
            take_decoded(frame, 0);
        left = byte - 1;
        zero_is_due = byte != 0xFF;
    }
    return false;
}

uint8_t frame_bad(void)
{
    return bad;
}

void frame_send(const uint8_t *body, uint8_t length)
{
    uint16_t sum = CRC_START;
    uint8_t tail[2];
    uint8_t at = 0;

    for (uint8_t k = 0; k < length; k++)
        sum = _crc_xmodem_update(sum, body[k]);
    tail[0] = sum;
    tail[1] = sum >> 8;
    /* A block is what lies before a zero or the end, its length + 1 in front; 254 bytes are never reached. */
    while (at <= length + 2) {
        uint8_t stop = at;

        while (stop < length + 2 && (stop < length ? body[stop] : tail[stop - length]))
            stop++;
        uart_put(stop - at + 1);
        for (; at < stop; at++)
            uart_put(at < length ? body[at] : tail[at - length]);
        at = stop + 1;
    }
    uart_put(0);
}
