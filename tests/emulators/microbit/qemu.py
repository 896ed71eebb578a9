"""A micro:bit (Cortex-M0, 16 kB) under QEMU with Debian's MicroPython 1.9.2, its console a
pseudo-terminal."""

from __future__ import annotations

import re
import subprocess
from pathlib import Path

import serial

FIRMWARE = Path("/usr/share/firmware-microbit-micropython/firmware.hex")
PIN0 = 3  # GPIO number of the pin labelled 0
PROMPT = b">>> "
_AT_ONCE = 32
_EVENT = re.compile(r"nrf51_gpio_update_output_irq line (\d+) value (\d)")


class LostError(Exception):
    """Bytes that were sent did not arrive."""


class Microbit:
    """The emulated board; a context manager. `log` receives its GPIO events."""

    def __init__(self, log: Path) -> None:
        self._log = log
        # With icount the board's clock counts instructions: a busy host makes it slow, not late.
        command = [
            "qemu-system-arm",
            "-M",
            "microbit",
            "-display",
            "none",
            "-monitor",
            "none",
            "-serial",
            "pty",
            "-icount",
            "shift=2,sleep=on",
            "-trace",
            "nrf51_gpio_update_output_irq",
            "-D",
            str(log),
            "-device",
            f"loader,file={FIRMWARE}",
        ]
        # Killed when its input ends: not even a killed test leaves it running.
        guarded = ["sh", "-c", '"$@" </dev/null & read -r _; kill $!', "sh", *command]
        self._process = subprocess.Popen(
            guarded,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        line = self._process.stdout.readline()
        self.port = line.split("redirected to ")[1].split(" ")[0]

    def __enter__(self) -> Microbit:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.stdin.close()
        self._process.wait(timeout=10)
        self._process.stdout.close()

    def execute(self, pieces: list[str], *, last: str = "") -> list[str]:
        """Execute sources one by one, then `last`, which need not end; return what each of the
        others prints."""
        with serial.Serial(self.port, 115200, timeout=2) as line:
            line.write(b"\r")
            line.read_until(PROMPT)
            printed = []
            for piece in pieces:
                _paste(line, piece)
                printed.append(_expect(line, PROMPT).decode())
                assert "Traceback" not in printed[-1], f"{printed[-1]}: {piece}"
            if last:
                _paste(line, last)
            return printed

    def events(self, gpio: int) -> list[int]:
        """Levels that a pin was set to, in order."""
        found = _EVENT.findall(self._log.read_text())
        return [int(level) for number, level in found if int(number) == gpio]


def _paste(line: serial.Serial, piece: str) -> None:
    """Send a source by paste mode, which echoes what has arrived: the board loses bytes that come
    in a rush."""
    for _ in range(10):
        line.write(b"\x05")
        try:
            _expect(line, b"\r\n=== ")
            for text in piece.encode().split(b"\n"):
                for k in range(0, len(text), _AT_ONCE):
                    line.write(text[k : k + _AT_ONCE])
                    _expect(line, text[k : k + _AT_ONCE])
                line.write(b"\r")
                _expect(line, b"\r\n=== ")
        except LostError:
            line.write(b"\x03")
            line.read_until(PROMPT)
            continue
        line.write(b"\x04")
        _expect(line, b"\r\n")
        return
    raise LostError(f"the board does not get {piece!r}")


def _expect(line: serial.Serial, end: bytes) -> bytes:
    found = line.read_until(end)
    if not found.endswith(end):
        raise LostError(f"{found!r} came, {end!r} was waited for")
    return found[: -len(end)]
