/*
 * An Arduino Uno out of nothing: runs a firmware's .hex on simavr and offers its UART on a pseudo-terminal.
 *
 *   simavr_uno FIRMWARE.hex SPEED CLOCK_PPM NOISE SEED
 *
 * prints "PTY <device>" and then obeys lines on standard input, each answered by one line, or by lines up to a single ".":
 *   trigger PULSES PERIOD   rising edges on D2, PERIOD cycles apart,
 *                           the first within half a millisecond         -> OK
 *   hang                    the program stops where it is, no interrupts -> OK <cycle>
 *   cycle                   how far its time has come                   -> OK <cycle>
 *   unplug                  the pseudo-terminal is gone, the board runs -> OK
 *   plug                    a new pseudo-terminal                       -> OK <device>
 *   events                  what the pins did                           -> <cycle> <pin> <level> ... .
 * It ends with its standard input, so that it never outlives whoever started it.
 */
#define _GNU_SOURCE
#include <errno.h>
#include <poll.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "board.h"
#include "line.h"

#define CYCLES_A_LOOK 7919 /* how often the world outside is looked at: half a millisecond, in step with nothing */
#define LONGEST_LAG_S 0.5  /* a computer slower than the board is forgiven, or it would race to catch up */

/*
 * A timer of the simulated time, for two reasons: a sleeping program would be looked after only when it wakes, and simavr
 * lets it sleep on to the next timer before it returns, so that bytes not fetched here would come in step with the program.
 */
static avr_cycle_count_t look(avr_t *core, avr_cycle_count_t when, void *unused)
{
    (void)core;
    (void)unused;
    line_fetch();
    board_stop_running();
    return when + CYCLES_A_LOOK;
}

static void restart_timers(void)
{
    avr_cycle_timer_cancel(avr, look, NULL);
    avr_cycle_timer_register(avr, CYCLES_A_LOOK, look, NULL);
    line_restart();
}

static void obey(const char *command)
{
    unsigned long long pulses, period;

    if (sscanf(command, "trigger %llu %llu", &pulses, &period) == 2 && pulses && period >= 2) {
        board_trigger(1 + (uint64_t)(chance() * CYCLES_A_LOOK), pulses, period);
        puts("OK");
    } else if (!strcmp(command, "hang")) {
        board_hang();
        printf("OK %llu\n", (unsigned long long)avr->cycle);
    } else if (!strcmp(command, "cycle")) {
        printf("OK %llu\n", (unsigned long long)avr->cycle);
    } else if (!strcmp(command, "unplug")) {
        line_unplug();
        puts("OK");
    } else if (!strcmp(command, "plug")) {
        printf("OK %s\n", line_plug());
    } else if (!strcmp(command, "events")) {
        board_print_events();
        puts(".");
    } else {
        puts("ERROR unknown command");
    }
    fflush(stdout);
}

static void read_commands(void)
{
    static char line[64];
    static size_t length;
    char bytes[64];
    ssize_t count = read(STDIN_FILENO, bytes, sizeof bytes);

    if (count == 0 || (count < 0 && errno != EAGAIN && errno != EINTR))
        exit(0);
    for (ssize_t k = 0; k < count; k++) {
        if (bytes[k] == '\n') {
            line[length] = 0;
            length = 0;
            obey(line);
        } else if (length + 1 < sizeof line) {
            line[length++] = bytes[k];
        }
    }
}

/* Obey commands, and wait for `wait_s` if nothing happens outside. */
static void look_around(double wait_s)
{
    struct pollfd fds[2] = {{.fd = STDIN_FILENO, .events = POLLIN}, {.fd = line_descriptor(), .events = POLLIN}};
    struct timespec wait = {(time_t)wait_s, (long)((wait_s - (time_t)wait_s) * 1e9)};

    if (ppoll(fds, 2, &wait, NULL) > 0 && fds[0].revents)
        read_commands();
}

static double now_s(void)
{
    struct timespec t;

    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int count, char **words)
{
    double speed, rate, start;

    if (count != 6)
        fail("usage: simavr_uno FIRMWARE.hex SPEED CLOCK_PPM NOISE SEED");
    signal(SIGPIPE, SIG_IGN);
    speed = atof(words[2]);
    rate = CLOCK_HZ * (1 + 1e-6 * atof(words[3])) * speed;
    board_make(words[1]);
    line_make(atof(words[4]), strtoull(words[5], NULL, 10));
    board_on_reset(restart_timers);
    printf("PTY %s\n", line_plug());
    fflush(stdout);
    start = now_s();
    for (;;) {
        double ahead_s = 0;

        board_run();
        if (speed > 0) {
            ahead_s = avr->cycle / rate - (now_s() - start);
            if (ahead_s < -LONGEST_LAG_S)
                start -= ahead_s;
            /* Sleeping less than a millisecond is mostly oversleeping. */
            if (ahead_s < 1e-3)
                ahead_s = 0;
        }
        look_around(ahead_s);
    }
}
