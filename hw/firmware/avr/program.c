#include "program.h"

#include <stdbool.h>

#include "protocol.h"

static bool is_open(const struct program *program, uint16_t chip)
{
    return program->bits[chip >> 3] & (0x80 >> (chip & 7));
}

static uint16_t size_for(uint16_t chips)
{
    return PROGRAM_HEADER + (chips >> 3) + ((chips & 7) != 0); /* chips + 7 would overflow */
}

uint16_t program_size(const struct program *program)
{
    return size_for(program->chips);
}

uint16_t program_ms(const struct program *program)
{
    uint32_t ticks = LEAD_TICKS + program->chips * (program->ticks + 1);

    return ticks / (1000000 / TICK_NS) + 1;
}

#if MAX_ON_TICKS
static bool opens_too_long(const struct program *program)
{
    uint32_t run = 0;

    for (uint16_t chip = 0; chip < program->chips; chip++) {
        run = is_open(program, chip) ? run + 1 : 0;
        /* Rounding the edges can lengthen an opening to the next whole tick. */
        if (run && run * program->ticks + ((run * program->fraction + 0xFFFF) >> 16) > MAX_ON_TICKS)
            return true;
    }
    return false;
}
#endif

uint8_t program_check(const struct program *program, uint16_t length)
{
    uint16_t open = 0;

    if (length < PROGRAM_HEADER || length != size_for(program->chips))
        return BAD_LENGTH;
    if (program->ticks < MIN_TICKS || program->ticks > MAX_TICKS - (program->fraction != 0))
        return OUT_OF_RANGE;
    if (!program->chips || program->chips > MAX_CHIPS)
        return OUT_OF_RANGE;
    for (uint16_t chip = program->chips; chip & 7; chip++)
        if (is_open(program, chip))
            return OUT_OF_RANGE; /* padding */
    for (uint16_t chip = 0; chip < program->chips; chip++)
        open += is_open(program, chip);
    if (!open)
        return OUT_OF_RANGE;
    if (open * 1000UL > (uint32_t)program->chips * MAX_DUTY_PERMILLE)
        return DUTY_LIMIT;
#if MAX_ON_TICKS
    if (opens_too_long(program))
        return ON_LIMIT;
#endif
    return OK;
}

uint32_t program_crc32(const struct program *program)
{
    const uint8_t *byte = (const uint8_t *)program;
    uint32_t crc = 0xFFFFFFFF;

    for (uint16_t left = program_size(program); left; left--) {
        crc ^= *byte++;
        for (uint8_t bit = 0; bit < 8; bit++)
            crc = crc & 1 ? (crc >> 1) ^ 0xEDB88320 : crc >> 1;
    }
    return ~crc;
}
