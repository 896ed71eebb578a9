"""An arbitrary-waveform generator of the 33500 class on a TCP socket, written from its manual
(nothing of `hw`).

Messages are parsed as IEEE 488.2 and SCPI say: units joined by semicolons that carry the header
path on, long and short forms, optional nodes, numbers with units, quoted strings, definite-length
blocks that may hold any byte, and an error queue. What the output does after a trigger is computed
from the samples, in exact fractions of a second.
"""

from __future__ import annotations

import re
import socket
import struct
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction

MESSAGES = {
    -102: "Syntax error",
    -104: "Data type error",
    -108: "Parameter not allowed",
    -109: "Missing parameter",
    -113: "Undefined header",
    -161: "Invalid block data",
    -211: "Trigger ignored",
    -221: "Settings conflict",
    -222: "Data out of range",
    -224: "Illegal parameter value",
    -350: "Error queue overflow",
    785: "Specified arb waveform does not exist",
    786: "Specified arb waveform already exists",
}
LONGEST_QUEUE = 20
POINTS = (8, 1_000_000)
RATE = {"OFF": 62_500_000.0, "STEP": 250_000_000.0, "NORM": 250_000_000.0}  # most, by filter
LEAST_RATE = 1e-6


class ScpiError(Exception):
    """A command that failed; its argument is the error number."""


@dataclass(frozen=True)
class Faults:
    """What goes wrong; nothing by default."""

    silent: bool = False
    identity: str = "Agilent Technologies,33522B,MY00000001,3.05-1.19-2.00-52-00"
    hang_up_on: str | None = None  # message or header that cuts the connection
    deaf_on: str | None = None  # message or header from which on nothing is answered
    rate_factor: float = 1.0  # the rate taken silently differs by this
    refuse: dict[str, int] = field(default_factory=dict)  # message begins with -> error number
    ignore: str | None = None  # message that is taken without an error and does nothing


class Awg:
    """The instrument; use as a context manager. `resource` is its VISA name."""

    def __init__(self, faults: Faults | None = None) -> None:
        self.faults = faults or Faults()
        self.messages: list[str] = []  # headers and data as received, blocks as <n bytes>
        self.plays: list[
            list[tuple[Fraction, float]]
        ] = []  # (time after the trigger, volts), one list per burst
        self.free_runs = 0  # times the output was live with a waveform that waits for no trigger
        self.errors: list[int] = []
        self.arbs: dict[str, list[float]] = {}
        self._reset()
        self._tree = self._commands()
        self._server = socket.create_server(("127.0.0.1", 0))
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _reset(self) -> None:
        self.output = False
        self.load = 50.0
        self.function = "SIN"
        self.arb = "EXP_RISE"
        self.filter = "STEP"
        self.rate = 40_000.0
        self.high = 0.05
        self.low = -0.05
        self.burst = False
        self.burst_mode = "TRIG"
        self.cycles = 1.0
        self.phase = 0.0
        self.source = "IMM"
        self.slope = "POS"
        self.delay = 0.0
        self.border = "NORM"
        self._running: tuple[float, Fraction, list[tuple[Fraction, float]]] | None = None

    def __enter__(self) -> Awg:
        self.resource = f"TCPIP::127.0.0.1::{self._server.getsockname()[1]}::SOCKET"
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=10)
        assert not self._thread.is_alive()

    @property
    def rest_volts(self) -> float | None:
        """Voltage at a high-impedance load while a burst waits for its trigger; None with the
        output off."""
        return self._volts(self.arbs[self.arb][0]) if self.output else None

    def trigger_input(self) -> None:
        """A rising edge on the external trigger input."""
        if (self.source, self.slope) == ("EXT", "POS"):
            self._trigger()

    def _trigger(self) -> None:
        if not self.burst or self.burst_mode != "TRIG" or self.function != "ARB":
            raise ScpiError(-211)
        if not self.output or (
            self._running and time.monotonic() - self._running[0] < self._running[1]
        ):
            return
        if self.filter != "OFF" or self.phase:
            raise NotImplementedError("smoothed or rotated waveforms")
        step = 1 / Fraction(self.rate)
        samples = self.arbs[self.arb]
        edges = []
        level = self.rest_volts
        for index in range(int(self.cycles) * len(samples) + 1):
            # After the last cycle the output goes back to where the burst begins.
            volts = self._volts(samples[index % len(samples)])
            if volts != level:
                edges.append((Fraction(self.delay) + index * step, volts))
                level = volts
        self.plays.append(edges)
        lasts = Fraction(self.delay) + int(self.cycles) * len(samples) * step
        self._running = (time.monotonic(), lasts, edges)

    @property
    def volts_now(self) -> float | None:
        """Voltage at a high-impedance load at this moment; None with the output off."""
        volts = self.rest_volts
        if self._running is not None and volts is not None:
            begin, lasts, edges = self._running
            past = time.monotonic() - begin
            if past < lasts:
                volts = next((level for at, level in reversed(edges) if at <= past), volts)
        return volts

    def _volts(self, sample: float) -> float:
        # The settings hold for the load that the instrument was told; without one the voltage is
        # twice as high.
        volts = self.low + (self.high - self.low) * (sample + 1) / 2
        return volts * (2 if self.load == 50 else 1)

    def _run(self) -> None:
        self._server.settimeout(0.02)
        while not self._stop.is_set():
            try:
                connection, _ = self._server.accept()
            except TimeoutError:
                continue
            with connection:
                connection.settimeout(0.02)
                self._serve(connection)
        self._server.close()

    def _serve(self, connection: socket.socket) -> None:
        pending = b""
        deaf = self.faults.silent
        while not self._stop.is_set():
            try:
                data = connection.recv(65536)
            except TimeoutError:
                continue
            except OSError:
                return
            if not data:
                return
            if hasattr(
                socket, "TCP_QUICKACK"
            ):  # else the other side waits 40 ms before it sends the next message
                connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_QUICKACK, 1)
            pending += data
            while (end := message_end(pending)) is not None:
                message = pending[: end - 1].rstrip(b"\r")
                pending = pending[end:]
                text = message.decode("latin-1")
                if self.faults.hang_up_on in (text, text.partition(" ")[0]):
                    return
                deaf = deaf or self.faults.deaf_on in (text, text.partition(" ")[0])
                answers = self.execute(message)
                if answers and not deaf:
                    connection.sendall(";".join(answers).encode() + b"\n")

    def execute(self, message: bytes) -> list[str]:
        """Do one program message and return the answers of its queries."""
        answers: list[str] = []
        path: list[str] = []
        for unit in split_outside(message, b";"):
            text = re.sub(
                r"#.*", f"<{len(unit)} bytes>", unit.decode("latin-1"), flags=re.DOTALL
            ).strip()
            self.messages.append(text)
            try:
                for start, number in self.faults.refuse.items():
                    if text.startswith(start):
                        raise ScpiError(number)
                if text == self.faults.ignore:
                    continue
                answer, path = self._unit(unit.strip(b" \t\r"), path)
            except ScpiError as error:
                self.errors.append(error.args[0])
                if len(self.errors) > LONGEST_QUEUE:
                    self.errors[LONGEST_QUEUE - 1 :] = [-350]
                break  # the rest of the message is not executed
            answers += [] if answer is None else [answer]
        return answers

    def _unit(self, unit: bytes, path: list[str]) -> tuple[str | None, list[str]]:
        if not unit:
            return None, path
        header, _, rest = unit.partition(b" ")
        name = header.decode("ascii", errors="replace")
        if name.startswith("*"):
            action = self._tree.get(name.upper().rstrip("?"))
            nodes = path
        else:
            nodes = name.rstrip("?").lstrip(":").split(":")
            nodes = nodes if name.startswith(":") else path + nodes
            action = next((do for long, do in self._tree.items() if matches(long, nodes)), None)
            nodes = nodes[:-1]
        if action is None:
            raise ScpiError(-113)
        data = [part.strip() for part in split_outside(rest, b",")] if rest.strip() else []
        return action(name.endswith("?"), data), nodes

    def _commands(self) -> dict[str, Callable[[bool, list[bytes]], str | None]]:
        return {
            "*IDN": lambda ask, data: self.faults.identity if ask else undefined(),
            "*RST": lambda ask, data: undefined() if ask else self._reset(),
            "*CLS": lambda ask, data: undefined() if ask else self.errors.clear(),
            "*OPC": lambda ask, data: "1" if ask else None,
            "SYSTem:ERRor[:NEXT]": lambda ask, data: self._next_error() if ask else undefined(),
            "OUTPut[:STATe]": self._boolean("output", live=True),
            "OUTPut:LOAD": self._number("load", 1, 10_000),
            "FORMat:BORDer": self._choice("border", "NORMal", "SWAPped"),
            "[SOURce:]DATA:VOLatile:CLEar": lambda ask, data: self.arbs.clear(),
            "[SOURce:]DATA:ARBitrary": self._load_arb,
            "[SOURce:]FUNCtion": self._choice(
                "function", "SINusoid", "SQUare", "ARBitrary", "DC", live=True
            ),
            "[SOURce:]FUNCtion:ARBitrary": self._select_arb,
            "[SOURce:]FUNCtion:ARBitrary:FILTer": self._choice("filter", "NORMal", "STEP", "OFF"),
            "[SOURce:]FUNCtion:ARBitrary:SRATe": self._set_rate,
            "[SOURce:]VOLTage": self._set_amplitude,
            "[SOURce:]VOLTage:OFFSet": self._set_offset,
            "[SOURce:]VOLTage:HIGH": lambda ask, data: self._set_level("high", ask, data),
            "[SOURce:]VOLTage:LOW": lambda ask, data: self._set_level("low", ask, data),
            "[SOURce:]BURSt:MODE": self._choice("burst_mode", "TRIGgered", "GATed"),
            "[SOURce:]BURSt:NCYCles": self._number("cycles", 1, 1e8),
            "[SOURce:]BURSt:PHASe": self._number("phase", -360, 360),
            "[SOURce:]BURSt:STATe": self._boolean("burst", live=True),
            "TRIGger": lambda ask, data: undefined() if ask else self._trigger(),
            "TRIGger:SOURce": self._choice("source", "IMMediate", "EXTernal", "BUS", live=True),
            "TRIGger:SLOPe": self._choice("slope", "POSitive", "NEGative"),
            "TRIGger:DELay": self._number("delay", 0, 1000),
        }

    def _next_error(self) -> str:
        number = self.errors.pop(0) if self.errors else 0
        return f'{number:+d},"{MESSAGES.get(number, "No error")}"'

    def _settled(self, live: bool) -> None:
        if not self.burst:
            self._running = None
        if (
            live
            and self.output
            and (self.function != "ARB" or not self.burst or self.source == "IMM")
        ):
            self.free_runs += 1

    def _boolean(
        self, name: str, *, live: bool = False
    ) -> Callable[[bool, list[bytes]], str | None]:
        def do(ask: bool, data: list[bytes]) -> str | None:
            if ask:
                return str(int(getattr(self, name)))
            word = one(data).decode().upper()
            if word not in ("ON", "OFF", "1", "0"):
                raise ScpiError(-224)
            setattr(self, name, word in ("ON", "1"))
            return self._settled(live)

        return do

    def _number(
        self, name: str, least: float, most: float
    ) -> Callable[[bool, list[bytes]], str | None]:
        def do(ask: bool, data: list[bytes]) -> str | None:
            if ask:
                return f"{getattr(self, name):+.15E}"
            value = number(one(data), least, most)
            setattr(self, name, min(max(value, least), most) if value != 9.9e37 else value)
            if not least <= value <= most and value != 9.9e37:
                raise ScpiError(-222)
            return None

        return do

    def _choice(
        self, name: str, *words: str, live: bool = False
    ) -> Callable[[bool, list[bytes]], str | None]:
        def do(ask: bool, data: list[bytes]) -> str | None:
            if ask:
                return str(getattr(self, name))
            found = [
                short(word)
                for word in words
                if one(data).decode().upper() in (word.upper(), short(word))
            ]
            if not found:
                raise ScpiError(-224)
            setattr(self, name, found[0])
            return self._settled(live)

        return do

    def _load_arb(self, ask: bool, data: list[bytes]) -> None:
        if ask or len(data) < 2:
            raise ScpiError(-109)
        name = data[0].decode().strip('"').upper()
        if not re.fullmatch(r"[A-Z][A-Z0-9_]{0,11}", name):
            raise ScpiError(-224)
        if name in self.arbs:
            raise ScpiError(786)
        if data[1].startswith(b"#"):
            digits = int(data[1][1:2])
            count = int(data[1][2 : 2 + digits])
            block = data[1][2 + digits :]
            if count != len(block) or count % 4 or len(data) > 2:
                raise ScpiError(-161)
            samples = list(
                struct.unpack(f"{'<' if self.border == 'SWAP' else '>'}{count // 4}f", block)
            )
        else:
            samples = [number(value, -1, 1) for value in data[1:]]
        if not POINTS[0] <= len(samples) <= POINTS[1] or not all(
            -1 <= sample <= 1 for sample in samples
        ):
            raise ScpiError(-222)
        self.arbs[name] = samples

    def _select_arb(self, ask: bool, data: list[bytes]) -> str | None:
        if ask:
            return f'"{self.arb}"'
        name = one(data).decode().strip('"').upper()
        if name not in self.arbs:
            raise ScpiError(785)
        self.arb = name
        return None

    def _set_rate(self, ask: bool, data: list[bytes]) -> str | None:
        most = RATE[self.filter]
        if ask:
            return f"{self.rate:+.15E}"
        value = number(one(data), LEAST_RATE, most)
        self.rate = min(max(value, LEAST_RATE), most) * self.faults.rate_factor
        if not LEAST_RATE <= value <= most:
            raise ScpiError(-222)
        return None

    def _set_level(self, name: str, ask: bool, data: list[bytes]) -> str | None:
        if ask:
            return f"{getattr(self, name):+.15E}"
        value = number(one(data), -10, 10)
        setattr(self, name, value)
        if abs(value) > 10 or self.high <= self.low:
            # The other level gives way, and the queue says so.
            other = "low" if name == "high" else "high"
            setattr(self, other, value + (0.001 if other == "high" else -0.001))
            raise ScpiError(-221)
        return None

    def _set_amplitude(self, ask: bool, data: list[bytes]) -> None:
        middle = (self.high + self.low) / 2
        amplitude = number(one(data), 0.002, 20)
        self.high = middle + amplitude / 2
        self.low = middle - amplitude / 2

    def _set_offset(self, ask: bool, data: list[bytes]) -> None:
        middle = (self.high + self.low) / 2
        shift = number(one(data), -10, 10)
        self.high = self.high - middle + shift
        self.low = self.low - middle + shift
        if max(self.high, -self.low) > 10:
            raise ScpiError(-221)


def undefined() -> None:
    """Refuse a query that is none, or a command that is only a query."""
    raise ScpiError(-113)


def one(data: list[bytes]) -> bytes:
    """Return the only parameter."""
    if len(data) != 1:
        raise ScpiError(-109 if not data else -108)
    return data[0]


def number(text: bytes, least: float, most: float) -> float:
    """Read a decimal number, MINimum, MAXimum or INFinity."""
    word = text.decode("ascii", errors="replace").upper()
    special = {
        "MIN": least,
        "MINIMUM": least,
        "MAX": most,
        "MAXIMUM": most,
        "INF": 9.9e37,
        "INFINITY": 9.9e37,
    }
    if word in special:
        return special[word]
    if not re.fullmatch(r"[+-]?(\d+\.?\d*|\.\d+)(E[+-]?\d+)?", word):
        raise ScpiError(-104)
    return float(word)


def short(word: str) -> str:
    """Short form of a mnemonic: its capitals."""
    return re.sub("[a-z]", "", word)


def matches(long: str, nodes: list[str]) -> bool:
    """Whether header nodes are this command, in long or short form, with optional nodes left out,
    channel 1 named."""
    pattern = ""
    for optional, node in re.findall(r"(\[)?:?([A-Za-z]+):?\]?", long):
        words = f"(?:{node.upper()}|{short(node)})1?:"
        pattern += f"(?:{words})?" if optional else words
    return re.fullmatch(pattern, "".join(f"{node.upper()}:" for node in nodes)) is not None


def _skipped(data: bytes, index: int) -> int | None:
    """Index behind the string or block that begins here, `index` itself if none does, None if it
    is not all there."""
    if data[index : index + 1] in (b'"', b"'"):
        end = data.find(data[index : index + 1], index + 1)
        return None if end < 0 else end + 1
    if data[index : index + 1] == b"#":
        if not (digits := data[index + 1 : index + 2]).isdigit():
            return None if not digits else index
        length = data[index + 2 : index + 2 + int(digits)]
        if len(length) < int(digits):
            return None
        end = index + 2 + int(digits) + int(length)
        return None if end > len(data) else end
    return index


def message_end(data: bytes) -> int | None:
    """Index behind the newline that ends the first message; newlines in strings and blocks do not
    count."""
    index = 0
    while index < len(data):
        after = _skipped(data, index)
        if after is None:
            return None
        if after == index:
            if data[index] == 10:
                return index + 1
            after += 1
        index = after
    return None


def split_outside(data: bytes, separator: bytes) -> list[bytes]:
    """Split at a separator that is in no string and no block."""
    parts = []
    begin = 0
    index = 0
    while index < len(data):
        after = _skipped(data, index)
        if after is None or after == index:
            if data[index : index + 1] == separator:
                parts.append(data[begin:index])
                begin = index + 1
            after = index + 1
        index = after
    return [*parts, data[begin:]]
