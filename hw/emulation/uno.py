"""Emulated Arduino Uno: the shipped firmware on simavr, its UART on a pseudo-terminal.

The board is compiled on the user's machine: linked with simavr (GPL), it is never shipped.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
import os
import shutil
import subprocess
import sys
import tempfile
import threading
from importlib.resources import as_file, files
from pathlib import Path
from typing import Self

CLOCK_HZ = 16_000_000
"""Nominal clock of the board, Hz."""
SIGNALS = ("shutter", "busy", "trigger")
"""Pins watched: D9, A1 and D2."""

_CYCLE_UNITS = 625  # 62.5 ns in units of 100 ps
_WANTED = "install gcc, libsimavr-dev and libelf-dev (as they are called on Debian and Ubuntu)"
_MISSING = {
    "sim_avr.h": "libsimavr-dev",
    "-lsimavr": "libsimavr-dev",
    "-lelf": "libelf-dev",
    "libelf": "libelf-dev",
}


class EmulationError(RuntimeError):
    """An emulated device cannot be built, or has died."""


class EmulatedUno:
    """An emulated Uno, running from `start` (or entering its context) to `stop`.

    Parameters
    ----------
    firmware : path, optional
        Intel hex file; by default the one that is shipped.
    speed : float
        How fast its time runs, 1 for real time; 0 lets it run as fast as it can, which suits
        anything but leases.
    clock_ppm : float
        Error of its crystal, parts per million, positive when fast.
    noise : float
        Chance, per byte and each way, that a byte is lost, changed in one bit, or doubled on the
        line.
    noise_seed : int
        Seed of that, and of the moments at which triggers come.

    Examples
    --------
    ::

        with EmulatedUno() as uno, Controller.open(uno.port) as controller:
            controller.upload(program, arm=True)
            uno.trigger()
    """

    def __init__(
        self,
        firmware: str | Path | None = None,
        *,
        speed: float = 1.0,
        clock_ppm: float = 0.0,
        noise: float = 0.0,
        noise_seed: int = 0,
    ) -> None:
        if not (math.isfinite(speed) and speed >= 0):
            raise ValueError(f"speed is {speed}: 0 (unpaced) or above is needed")
        if not abs(clock_ppm) <= 100_000:
            raise ValueError(f"clock_ppm is {clock_ppm}: at most 100000 either way is needed")
        if not 0 <= noise <= 1:
            raise ValueError(f"noise is {noise}: a chance 0..1 is needed")
        if noise_seed < 0:
            raise ValueError(f"noise_seed is {noise_seed}: 0 or above is needed")
        if firmware is not None and not Path(firmware).is_file():
            raise ValueError(f"firmware {firmware} is no file: name an Intel hex file")
        self.firmware = None if firmware is None else Path(firmware)
        self.clock_ppm = clock_ppm
        numbers = (speed, clock_ppm, noise)
        self._words = [*(repr(float(number)) for number in numbers), str(noise_seed)]
        self._board: subprocess.Popen[str] | None = None
        self._port = ""
        self._events: tuple[tuple[int, str, int], ...] = ()
        self._talk = threading.Lock()  # a command and its answer belong together

    @property
    def port(self) -> str:
        """Name of its serial port."""
        self._running()
        return self._port

    def start(self) -> Self:
        """Switch it on.

        EmulationError if the emulator cannot be compiled, or refuses the firmware, or runs
        already.
        """
        if self._board is not None:
            raise EmulationError("emulated Uno is on already: stop it first")
        program = build_board()
        shipped = files("hw.firmware").joinpath("avr", "cxp-avr.hex")
        with contextlib.ExitStack() as resources:
            firmware = self.firmware or resources.enter_context(as_file(shipped))
            self._board = subprocess.Popen(
                [str(program), str(firmware), *self._words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,  # simavr logs there; errors come on stdout
                text=True,
                # Ctrl-C on our terminal must not end it before its pins have been asked for
                start_new_session=True,
            )
            try:
                word, self._port = self._line(
                    f"emulated Uno refuses {self.firmware or 'its firmware'}"
                ).split(" ", 1)
                if word != "PTY":
                    raise EmulationError(
                        f"emulated Uno says {word} {self._port}: a port was expected"
                    )
            except BaseException:
                self._end()
                raise
        return self

    def stop(self) -> None:
        """Switch it off; its edges can still be read."""
        if self._board is not None:
            with contextlib.suppress(EmulationError):
                self._events = self._ask_events()
            self._end()

    def check(self) -> None:
        """Check that it still runs.

        EmulationError if it has ended, as when its firmware crashed.
        """
        if self._running().poll() is not None:
            self._line()

    def trigger(self, *, pulses: int = 1, hertz: float = 5000.0) -> None:
        """Give rising edges on the trigger input, the first within half a millisecond.

        Pulses of an earlier call that are still to come are dropped.

        Parameters
        ----------
        pulses : int
            Number of edges.
        hertz : float
            Edges a second; each pulse is high for half of its period, in whole clock cycles.

        Raises
        ------
        ValueError
            If there is no edge, or if they are slower than 1 Hz or faster than half the clock.
        """
        if pulses < 1:
            raise ValueError(f"pulses is {pulses}: at least 1 is needed")
        if not 1 <= hertz <= CLOCK_HZ / 2:
            raise ValueError(f"hertz is {hertz}: 1..{CLOCK_HZ // 2} is needed")
        self._command(f"trigger {pulses} {round(CLOCK_HZ / hertz)}")

    def hang(self) -> int:
        """Stop the program where it is, interrupts off; return the cycle since start."""
        return int(self._command("hang"))

    def cycle(self) -> int:
        """Return the clock cycles it has run, which lag behind on a busy computer."""
        return int(self._command("cycle"))

    def unplug(self) -> None:
        """Pull the cable: the port is gone, the board runs on."""
        self._command("unplug")

    def plug(self) -> None:
        """Plug the cable in again: there is a new `port`."""
        self._port = self._command("plug")

    def edges(self, signal: str = "shutter") -> tuple[tuple[int, int], ...]:
        """Return the changes of a pin as (time in clock cycles, level); all pins begin low."""
        if signal not in SIGNALS:
            raise ValueError(f"signal is {signal!r}: one of {', '.join(SIGNALS)} is needed")
        return tuple(
            (cycle, level) for cycle, name, level in self._known_events() if name == signal
        )

    def write_vcd(self, path: str | Path) -> None:
        """Write the pins' edges as an ideal logic analyser records them, in units of 100 ps."""
        marks = dict(zip(SIGNALS, "sbt", strict=True))
        lines = ["$timescale 100 ps $end", "$scope module uno $end"]
        lines += [f"$var wire 1 {mark} {name} $end" for name, mark in marks.items()]
        lines += ["$upscope $end", "$enddefinitions $end", "#0", "$dumpvars"]
        lines += [f"0{mark}" for mark in marks.values()] + ["$end"]
        last = 0
        for cycle, name, level in self._known_events():
            # A fast crystal makes its cycles in less time.
            time = round(cycle * _CYCLE_UNITS / (1 + self.clock_ppm * 1e-6))
            if time != last:
                lines.append(f"#{time}")
                last = time
            lines.append(f"{level}{marks[name]}")
        Path(path).write_text("\n".join(lines) + "\n", encoding="ascii")

    def __enter__(self) -> Self:
        return self.start()

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        self.stop()

    def _known_events(self) -> tuple[tuple[int, str, int], ...]:
        return self._events if self._board is None else self._ask_events()

    def _ask_events(self) -> tuple[tuple[int, str, int], ...]:
        events = []
        with self._talk:
            self._say("events")
            while (line := self._line()) != ".":
                cycle, name, level = line.split()
                events.append((int(cycle), name, int(level)))
        return tuple(events)

    def _command(self, command: str) -> str:
        with self._talk:
            self._say(command)
            return self._line().removeprefix("OK").strip()

    def _running(self) -> subprocess.Popen[str]:
        if self._board is None:
            raise EmulationError("emulated Uno is off: start it, or use it as a context manager")
        return self._board

    def _say(self, command: str) -> None:
        board = self._running()
        assert board.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # the answer tells why
            board.stdin.write(command + "\n")
            board.stdin.flush()

    def _line(self, failed: str = "emulated Uno has stopped") -> str:
        board = self._running()
        assert board.stdout is not None
        line = board.stdout.readline().rstrip("\n")
        if not line or line.startswith("ERROR"):
            raise EmulationError(f"{failed}: {line.removeprefix('ERROR ') or 'it was ended'}")
        return line

    def _end(self) -> None:
        board = self._board
        self._board = None
        if board is not None:
            board.kill()  # it has nothing to save, and may hang
            assert board.stdin is not None
            with contextlib.suppress(BrokenPipeError):  # a command may be left that nobody read
                board.stdin.close()
            with board:  # closes its other pipe and waits
                pass


def build_board() -> Path:
    """Return the emulated Uno's program, compiled into the user's cache folder the first time.

    EmulationError if a compiler or a library is missing.
    """
    if not sys.platform.startswith("linux"):
        raise EmulationError("emulated Uno runs on Linux only: on Windows use WSL")
    shipped = files("hw.emulation").joinpath("board")
    sources = {
        file.name: file.read_bytes()
        for file in shipped.iterdir()
        if file.name.endswith((".c", ".h"))
    }
    digest = hashlib.sha256(
        b"".join(name.encode() + text for name, text in sorted(sources.items()))
    ).hexdigest()
    # Named after its sources: an update never runs the board of an earlier version.
    board = _cache() / f"simavr_uno-{digest[:16]}"
    if board.exists():
        return board
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise EmulationError(f"emulated Uno needs a C compiler and simavr: {_WANTED}")
    board.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=board.parent) as folder:
        for name, text in sources.items():
            Path(folder, name).write_bytes(text)
        modules = sorted(name for name in sources if name.endswith(".c"))
        command = [
            compiler,
            "-O2",
            *_include_flags(),
            *modules,
            "-o",
            board.name,
            "-lsimavr",
            "-lelf",
            "-lutil",  # openpty
        ]
        build = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, errors="replace", check=False
        )
        if build.returncode:
            raise EmulationError(_reason(build.stderr))
        # two that compile at once end with the same whole file
        os.replace(Path(folder, board.name), board)
    return board


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "coded-exposure"


def _include_flags() -> list[str]:
    # simavr's headers include one another without their folder's name.
    if shutil.which("pkg-config"):
        flags = subprocess.run(
            ["pkg-config", "--cflags", "simavr"], capture_output=True, text=True, check=False
        )
        if flags.returncode == 0:
            return flags.stdout.split()
    return ["-I/usr/include/simavr", "-I/usr/local/include/simavr"]


def _reason(messages: str) -> str:
    for sign, package in _MISSING.items():
        if sign in messages:
            return f"emulated Uno cannot be compiled without {package}: {_WANTED}"
    first = next(
        (line for line in messages.splitlines() if "error" in line), "the compiler says nothing"
    )
    return f"emulated Uno cannot be compiled ({' '.join(first.split())[:160]}): {_WANTED}"
