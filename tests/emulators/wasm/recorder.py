"""`machine` and `rp2` that only write down what is asked of them; for CPython and MicroPython
alike."""

import sys

ADDR = 0x502000D4
CHIP_RESET = 0x40064008


class Registers:
    def __init__(self, log):
        self.log = log
        self.values = {ADDR: 27, CHIP_RESET: 1 << 16}

    def __getitem__(self, address):
        self.log.append(("read", address))
        return self.values.get(address, 0)

    def __setitem__(self, address, value):
        self.log.append(("write", address, value))


class Pin:
    IN = 0
    OUT = 1
    PULL_DOWN = 1

    def __init__(self, *args, **options):
        self.told = (args, sorted(options.items()))


class StateMachine:
    def __init__(self, log, number):
        self.log = log
        log.append(("state machine", number))

    def init(self, program, *, in_base, out_base, set_base):
        self.log.append(("init", program, in_base.told, out_base.told, set_base.told))

    def put(self, value):
        self.log.append(("put", value))

    def active(self, on):
        self.log.append(("active", on))


class Module:
    pass


def install():
    """Put both modules where `import` finds them; return the log."""
    log = []
    machine = Module()
    rp2 = Module()
    machine.mem32, machine.Pin = Registers(log), Pin
    rp2.PIO = Module()
    rp2.PIO.OUT_LOW, rp2.PIO.SHIFT_LEFT, rp2.PIO.JOIN_TX = 2, 0, 1
    rp2.StateMachine = lambda number: StateMachine(log, number)
    rp2.asm_pio = lambda **options: lambda function: sorted(options.items())
    sys.modules["machine"], sys.modules["rp2"] = machine, rp2
    return log


def transcript(shutter_class, log, codes):
    """Everything a shutter does with codes given as (ticks, chips, bytes)."""
    shutter = shutter_class(15, 14, max_on_us=300, max_duty=500)
    for ticks, chips, code in codes:
        shutter.arm(ticks, chips, code)
        shutter.start()
        log.append(
            (
                shutter.begun(),
                shutter.ended(),
                shutter.missed(),
                shutter.reset_cause,
                shutter.max_on_ticks,
            )
        )
        shutter.close()
    return log
