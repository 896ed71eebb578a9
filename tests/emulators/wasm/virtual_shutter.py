"""A shutter on a virtual clock, for `cxp.Player` under MicroPython: both are moved by hand."""


class Clock:
    """MicroPython's `time`, standing still until it is told otherwise; wraps as on boards."""

    def __init__(self, start_us=0):
        self.now_us = start_us

    def ticks_us(self):
        return self.now_us % (1 << 30)

    def ticks_diff(self, later, earlier):
        return (later - earlier + (1 << 29)) % (1 << 30) - (1 << 29)


class VirtualShutter:
    """Notes its edges in us; `trigger` is the input."""

    name = b"virtual 1"
    flags = 2
    max_chips = 100
    tick_ns = 1000
    min_ticks = 100
    max_ticks = 1000000
    lead_ns = 0
    reset_cause = 1

    def __init__(self, clock, max_on_ticks=0, max_duty=1000):
        self.clock = clock
        self.max_on_ticks = max_on_ticks
        self.max_duty = max_duty
        self.armed = False
        self.begin_us = None
        self.miss = 0
        self.plays = []
        self.closes = 0

    def arm(self, ticks, chips, code):
        self.armed = True
        self.begin_us = None
        self.ticks = ticks
        self.chips = chips
        self.code = bytes(code)

    def start(self):
        assert self.armed
        if self.begin_us is None:
            self.begin_us = self.clock.now_us
            self.plays.append((self.ticks, self.chips, self.code))

    trigger = start

    def begun(self):
        return self.begin_us is not None

    def ended(self):
        return self.clock.now_us - self.begin_us >= self.ticks * self.chips

    def missed(self):
        return self.miss

    def close(self):
        self.armed = False
        self.begin_us = None
        self.miss = 0
        self.closes += 1
