/* The player: Timer 1's output-compare unit makes the edges, its interrupt only says what the next match will do. */
#ifndef PLAYER_H
#define PLAYER_H

#include <stdint.h>

#include "program.h"

enum state { IDLE, LOADED, ARMED, PLAY, DONE, FAULT };

struct player_status {
    uint8_t state;
    uint16_t begun;  /* chips */
    uint16_t plays;  /* ended */
    uint8_t missed;  /* edges */
    uint32_t crc32;  /* of the stored program, 0 without one */
};

void player_init(void);

/* These return error codes of protocol.h; a refused one changes nothing. */
uint8_t player_load(const struct program *program, uint16_t length);
uint8_t player_read(const struct program **program);
uint8_t player_arm(const uint8_t *payload, uint16_t length);
uint8_t player_trigger(uint16_t length);

void player_abort(void);

void player_status(struct player_status *status);

/* Called each millisecond: the lease runs. */
void player_tick(void);

#endif
