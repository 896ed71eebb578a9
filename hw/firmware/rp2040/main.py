# mypy: disable-error-code="import-not-found,attr-defined,no-untyped-call"
"""Shutter controller CXP1 on a board with an RP2040: its pins, limits and console."""

SHUTTER_PIN = 15  # high is open; 10 kOhm to ground
TRIGGER_PIN = 14  # a rising edge plays what is armed
MAX_ON_US = 0  # longest opening the shutter stands, 0: any
MAX_DUTY = 1000  # largest open fraction of a code in 1/1000; a play cut short delays the next
WATCHDOG_MS = 2000  # a reply that the host does not fetch may take half a second a packet

_WATCHDOG_STOP = 0x4005B000  # its control register, at the address where ones clear bits
_WATCHDOG_ENABLE = 1 << 30
_OWED_MS = 0x4005800C  # its first scratch register, which its own resets leave alone


def run() -> None:
    """Serve the console until it gets a carriage return and Ctrl-C, as mpremote sends; then the
    shutter is closed.
    """
    import time

    import machine
    import micropython
    from cxp import Player
    from pio_shutter import CLOCK_HZ, PioShutter

    machine.freq(CLOCK_HZ)
    shutter = PioShutter(SHUTTER_PIN, TRIGGER_PIN, max_on_us=MAX_ON_US, max_duty=MAX_DUTY)
    registers = machine.mem32
    player = Player(shutter, time, owed_us=1000 * registers[_OWED_MS] if MAX_DUTY < 1000 else 0)
    micropython.kbd_intr(-1)  # a lone 0x03 is noise or a host of binary frames, no wish to stop
    watchdog = machine.WDT(timeout=WATCHDOG_MS)
    try:
        _serve(player, watchdog, registers)
    finally:
        shutter.close()
        # there is no method for it, and the console must live on
        registers[_WATCHDOG_STOP] = _WATCHDOG_ENABLE
        micropython.kbd_intr(3)


def _serve(player, watchdog, registers):  # type: ignore[no-untyped-def]
    import select
    import sys

    ready = select.poll()
    ready.register(sys.stdin, select.POLLIN)
    before = b""
    while True:
        watchdog.feed()
        player.poll()
        _save(player, registers)
        if not ready.poll(1):
            continue
        byte = sys.stdin.buffer.read(1)
        if before == b"\r" and byte == b"\x03":
            return
        before = byte
        reply = player.feed(byte)
        # a host that does not fetch the reply could hold it up until the reset
        _save(player, registers)
        if reply:
            sys.stdout.buffer.write(reply)


def _save(player, registers):  # type: ignore[no-untyped-def]
    if MAX_DUTY < 1000:
        registers[_OWED_MS] = -(-player.owed_us // 1000)


if __name__ == "__main__":
    run()
