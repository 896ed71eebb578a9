# mypy: disable-error-code="import-not-found,name-defined,no-untyped-call,untyped-decorator"
# ruff: noqa: F821  (the names of PIO instructions exist only while rp2.asm_pio runs the function)
"""Shutter played by a PIO state machine of an RP2040: every edge on its clock cycle, whatever the
processor does.

The whole code lies in the state machine before it is armed. When the last word is used up the
state machine stalls, and what it stalls on is a closed chip behind the code: neither a crash nor a
stopped host can hold the shutter open.
"""

CLOCK_HZ = 125_000_000

_TXSTALL = 1 << 24
_FDEBUG = 0x50200008  # PIO 0: sticky flags, among them TXSTALL of state machine 0
_ADDR = 0x502000D4  # where state machine 0 is in its program
_INSTR = 0x502000D8  # what is written here state machine 0 executes at once
_IO_BANK = 0x40014000
_INPUT_LOW = 2 << 16  # GPIO control: what peripherals see of the pin
_INPUT_HIGH = 3 << 16
_INPUT = 3 << 16
_REASON = 0x40058008  # watchdog: 1 its timer ran out, 2 software asked for the reset
_CHIP_RESET = 0x40064008

# Instructions, as PIO.asm_pio_encode would give them.
_PULL = 0x80A0  # pull(block)
_MOV_ISR_OSR = 0xA0C7
_OUT_NULL = 0x6060  # + number of bits, 0 for 32
_SET_PINS_0 = 0xE000


class PioShutter:
    """Shutter on one pin, trigger input on another.

    Parameters
    ----------
    shutter_pin, trigger_pin : int
        GPIO numbers. High is open; a rising edge triggers.
    max_on_us : int
        Longest opening, us; 0 for no limit.
    max_duty : int
        Largest open fraction of a code in 1/1000.
    """

    name = b"cxp-rp2040 1"
    flags = 2
    # nine words of 32: one in the shift register, eight in the joined queue, less one closed chip
    max_chips = 287
    tick_ns = 8
    min_ticks = 125
    max_ticks = 0xFFFFFFFF
    lead_ns = 32  # two cycles of input synchronizer, one of `wait`, one of `out`

    def __init__(
        self, shutter_pin: int, trigger_pin: int, *, max_on_us: int = 0, max_duty: int = 1000
    ) -> None:
        import machine
        import rp2

        self.max_on_ticks = max_on_us * 1000 // self.tick_ns
        if self.max_on_ticks > 0xFFFFFFFF:
            raise ValueError(
                "max_on_us must be at most 34359738: HELLO could not tell a longer one"
            )
        self.max_duty = max_duty
        self.reset_cause = reset_cause(machine.mem32)
        self._registers = machine.mem32
        self._shutter = machine.Pin(shutter_pin, machine.Pin.OUT, value=0)
        self._trigger = machine.Pin(trigger_pin, machine.Pin.IN, machine.Pin.PULL_DOWN)
        self._trigger_ctrl = _IO_BANK + 8 * trigger_pin + 4
        self._program = _program(rp2)
        self._machine = rp2.StateMachine(0)
        self._wait = 0
        self._init()

    def arm(self, ticks: int, chips: int, code: bytes) -> None:
        """Put the whole code into the state machine, and let it wait for a rising edge.

        Parameters
        ----------
        ticks : int
            Clock cycles a chip.
        chips : int
            Number of chips.
        code : bytes
            Chips as bits, the first in the highest bit of the first byte.
        """
        self._init()
        registers = self._registers
        machine = self._machine
        machine.put(ticks - 3)  # a chip is `out`, `mov` and one more `jmp` than this number
        registers[_INSTR] = _PULL
        registers[_INSTR] = _MOV_ISR_OSR
        registers[_INSTR] = _OUT_NULL  # empties the shift register
        # Filled up in front, so that the last word ends with just one closed chip and the end is
        # seen at once.
        words = chips // 32 + 1
        bits = int.from_bytes(code, "big") >> 8 * len(code) - chips << 1
        machine.put(bits >> 32 * (words - 1))
        registers[_INSTR] = _PULL
        if words * 32 - chips - 1:
            registers[_INSTR] = _OUT_NULL | words * 32 - chips - 1
        for k in range(words - 2, -1, -1):
            machine.put(bits >> 32 * k & 0xFFFFFFFF)
        registers[_FDEBUG] = _TXSTALL
        machine.active(1)

    def start(self) -> None:
        """Make the rising edge inside the chip: one that comes from outside at the same moment
        does no harm.
        """
        registers = self._registers
        control = self._trigger_ctrl
        normal = registers[control] & ~_INPUT
        registers[control] = normal | _INPUT_LOW
        registers[control] = normal | _INPUT_HIGH
        registers[control] = normal

    def begun(self) -> bool:
        """Whether the state machine is past its two `wait` instructions."""
        return bool(self._registers[_ADDR] - self._wait >= 2)

    def ended(self) -> bool:
        """Whether the state machine has run out of chips; seen one chip after the end."""
        return bool(self._registers[_FDEBUG] & _TXSTALL)

    def missed(self) -> int:
        """Nothing can be missed: the edges need no software."""
        return 0

    def close(self) -> None:
        """Stop the state machine and close."""
        self._machine.active(0)
        self._registers[_INSTR] = _SET_PINS_0

    def _init(self) -> None:
        # Also empties the queue and closes the shutter.
        self._machine.init(
            self._program, in_base=self._trigger, out_base=self._shutter, set_base=self._shutter
        )
        self._wait = self._registers[_ADDR]


def reset_cause(registers: "dict[int, int]") -> int:
    """Cause of the last reset as CXP1 counts: 0 power, 1 reset line, 3 watchdog, 255 unknown
    (software, too).
    """
    reason = registers[_REASON]
    if reason:
        return 3 if reason & 1 else 255
    chip = registers[_CHIP_RESET]
    return 0 if chip & 1 << 8 else 1 if chip & 1 << 16 else 255


def _program(rp2):  # type: ignore[no-untyped-def]
    @rp2.asm_pio(
        out_init=rp2.PIO.OUT_LOW,
        set_init=rp2.PIO.OUT_LOW,
        out_shiftdir=rp2.PIO.SHIFT_LEFT,
        autopull=True,
        pull_thresh=32,
        fifo_join=rp2.PIO.JOIN_TX,
    )
    def play():  # type: ignore[no-untyped-def]
        wait(0, pin, 0)  # a trigger that is high already is no edge
        wait(1, pin, 0)
        wrap_target()
        out(pins, 1)
        mov(x, isr)
        label("hold")
        jmp(x_dec, "hold")
        wrap()

    return play
