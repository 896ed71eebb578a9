"""Shutter timed by software on a micro:bit, and its console: a demonstration of `cxp.Player`, no
instrument.

Calls are not nested deeper than they must be: the board's stack holds six.
"""

import microbit
import micropython
import utime


class BenchShutter:
    """Closed is low; without trigger input."""

    name = b"cxp-bench 1"
    flags = 0
    max_chips = 64
    tick_ns = 1000
    min_ticks = 1000
    max_ticks = 1000000
    max_on_ticks = 0
    max_duty = 1000
    lead_ns = 0
    reset_cause = 255

    def __init__(self, pin):
        self.pin = pin
        self.level = 1

    def arm(self, ticks, chips, code):
        self.ticks = ticks
        self.chips = chips
        self.code = code

    def start(self):
        self.begin = utime.ticks_us()
        self.at = -1
        self.missed()

    def missed(self):
        chip = utime.ticks_diff(utime.ticks_us(), self.begin) // self.ticks
        late = 0
        while self.at < min(chip, self.chips):
            self.at += 1
            level = self.at < self.chips and self.code[self.at >> 3] << (self.at & 7) >> 7 & 1
            if level != self.level:
                self.pin.write_digital(level)
                self.level = level
                late += self.at < chip
        return late

    def begun(self):
        return False

    def ended(self):
        return self.at >= self.chips

    def close(self):
        if self.level:
            self.pin.write_digital(0)
            self.level = 0


microbit.display.off()
microbit.uart.init(115200)
micropython.kbd_intr(-1)
player = Player(BenchShutter(microbit.pin0), utime)  # noqa: F821  (of cxp.py, which comes before on the board)
while True:
    player.poll()
    if microbit.uart.any():
        reply = player.feed(microbit.uart.read(1))
        if reply:
            sent = microbit.uart.write(reply)  # typed in, a bare call would print its value
