"""CXP1 over a serial port: frames out, replies in, retries, and a shutter that is closed when anything fails."""

from __future__ import annotations

import atexit
import contextlib
import time
from types import TracebackType
from typing import Any, Protocol, Self

from hw.framing import FrameError, split_frames
from hw.protocol import DeviceError, Hello, Op, Reply, decode_reply, device_error, encode_request, unpack_hello

__all__ = ["Link", "LinkError", "PortError", "SerialPort", "open_link", "open_port"]

_POLL_S = 0.01
_LONGEST_FRAME = 9000  # 65535 chips and their stuffing
_ERRNO_HINTS = {
    2: "there is no such port: plug the device in, or look at the port's name",
    6: "the device is gone: plug it in again",
    11: "another program has it open: close that one first",
    13: "no permission: add yourself to the port's group (dialout), or close the program that uses it",
    16: "another program has it open: close that one first",
    35: "another program has it open: close that one first",
}


class PortError(ValueError):
    """The port named cannot be used: missing, busy, silent, or not a CXP1 device."""


class LinkError(RuntimeError):
    """A device that had answered stopped to do so: unplugged, hung, or the line is too noisy."""


class SerialPort(Protocol):
    """The part of ``serial.Serial`` a `Link` uses; `read` returns after a short timeout."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""

    def read(self, size: int, /) -> bytes:
        """Read at most `size` bytes."""

    def write(self, data: bytes, /) -> int | None:
        """Write all bytes."""

    def close(self) -> None:
        """Close the port."""


class Link:
    """Requests and replies on an open port.

    As a context manager it sends ABORT when left by an exception; left normally it leaves an armed device armed
    (its lease ends that). A link still open when the interpreter ends sends ABORT too.

    Parameters
    ----------
    port : SerialPort
        Open port, owned by the link from now on.
    name : str
        Name of the port, for messages.
    timeout_s : float
        How long to wait for a reply before the same frame is sent again. On USB converters a reply may take 16 ms
        longer than the line needs, so keep it at 0.1 s or more there.
    attempts : int
        How often one frame is sent at most.
    """

    def __init__(self, port: SerialPort, *, name: str, timeout_s: float = 0.15, attempts: int = 12) -> None:
        if not timeout_s > 0 or attempts < 1:
            raise ValueError(f"timeout_s is {timeout_s} and attempts is {attempts}: above 0 and at least 1 are needed")
        self.name = name
        self.timeout_s = timeout_s
        self.attempts = attempts
        self.retries = 0
        self.bad_frames = 0
        self.received_bytes = 0
        self._port: SerialPort | None = port
        self._seq = 0
        self._rest = b""
        atexit.register(self._leave)

    @property
    def is_open(self) -> bool:
        """Whether the port is still open on our side."""
        return self._port is not None

    def request(self, op: int, payload: bytes = b"", *, attempts: int | None = None) -> bytes:
        """Send one request until its reply comes, and return the reply's data.

        The very same frame is sent each time, so that the device can tell a retry from a second request.

        Raises
        ------
        DeviceError
            The subclass for the error the device answered.
        LinkError
            If no reply came, or the port failed.
        """
        self._seq = (self._seq + 1) % 256
        frame = encode_request(op, self._seq, payload)
        attempts = self.attempts if attempts is None else attempts
        for attempt in range(attempts):
            self.retries += attempt > 0
            # The 0x00 in front ends what noise has left half-received in the device, so that a retry is not lost too.
            self._write(b"\0" + frame if attempt else frame)
            reply = self._wait(op, self._seq)
            if reply is not None:
                if reply.error:
                    raise device_error(reply, source=self.name)
                return reply.data
        name = Op(op).name if op in Op._value2member_map_ else f"op {op}"
        raise LinkError(f"{self.name} does not answer {name}, asked {attempts} times: check cable, power and firmware")

    def hello(self, *, hello_s: float = 3.0) -> Hello:
        """Ask the device who it is, for `hello_s` seconds: a board that resets on opening is deaf for a while.

        Raises
        ------
        PortError
            If nothing answers, garbage comes, or it is not a CXP1 device.
        """
        received = self.received_bytes
        try:
            self._write(b"\0")
            data = self.request(Op.HELLO, attempts=max(1, round(hello_s / self.timeout_s)))
            return unpack_hello(data)
        except (FrameError, DeviceError) as error:
            raise PortError(f"{self.name} is not a CXP1 shutter controller: {error}") from None
        except LinkError:
            if not self.is_open:
                raise
            heard = self.received_bytes - received
            if heard:
                raise PortError(
                    f"{self.name} sends {heard} bytes but no CXP1 reply: wrong baud rate, or not a shutter controller"
                ) from None
            raise PortError(
                f"{self.name} is silent for {hello_s:g} s: check power and firmware, or name another port"
            ) from None

    def abort(self) -> bool:
        """Close the shutter and disarm, never raising; False when the device did not acknowledge it."""
        if self._port is None:
            return False
        try:
            self.request(Op.ABORT)
        except (LinkError, DeviceError):
            return False
        return True

    def close(self) -> None:
        """Close the port without a word to the device; may be called again."""
        port, self._port = self._port, None
        atexit.unregister(self._leave)
        if port is not None:
            with contextlib.suppress(Exception):  # an unplugged port may refuse even this
                port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if error is not None:
            self.abort_after(error)
        self.close()

    def abort_after(self, error: BaseException) -> None:
        """Send ABORT because of `error`, and note on it when the device did not acknowledge."""
        note = f"{self.name} did not acknowledge ABORT: look whether the shutter is closed"
        if not self.abort() and note not in getattr(error, "__notes__", ()):
            error.add_note(note)

    def _leave(self) -> None:
        self.abort()
        self.close()

    def _wait(self, op: int, seq: int) -> Reply | None:
        deadline = time.monotonic() + self.timeout_s
        while True:
            frames, self._rest = split_frames(self._rest + self._read())
            self._rest = self._rest[-_LONGEST_FRAME:]
            for index, frame in enumerate(frames):
                try:
                    reply = decode_reply(frame)
                except FrameError:
                    self.bad_frames += 1
                    continue
                if (reply.op, reply.seq) == (op, seq):
                    self._rest = b"".join(later + b"\0" for later in frames[index + 1 :]) + self._rest
                    return reply
            if time.monotonic() >= deadline:
                return None

    def _read(self) -> bytes:
        port = self._opened()
        try:
            data = port.read(max(1, port.in_waiting))
        except Exception as error:  # termios.error is no OSError, and pyserial lets TypeError through on a closed port
            raise self._gone(error) from error
        self.received_bytes += len(data)
        return data

    def _write(self, data: bytes) -> None:
        port = self._opened()
        try:
            port.write(data)
        except Exception as error:
            raise self._gone(error) from error

    def _opened(self) -> SerialPort:
        if self._port is None:
            raise LinkError(f"{self.name} is closed: open it again")
        return self._port

    def _gone(self, error: Exception) -> LinkError:
        self.close()
        return LinkError(f"{self.name} is gone ({_one_line(error)}): plug the device in and open the port again")


def open_port(port: str, *, baud: int = 115200) -> SerialPort:
    """Open a serial port for ourselves alone.

    Raises
    ------
    PortError
        If it is missing, busy, not a serial port, or the baud rate is impossible.
    """
    import serial

    if not isinstance(port, str) or not port.strip():
        raise PortError(f"port is {port!r}: name a serial port")
    if isinstance(baud, bool) or not isinstance(baud, int) or not 0 < baud <= 10**7:
        raise PortError(f"baud is {baud!r}: a whole number 1..10000000 is needed, usually 115200")
    try:
        opened: Any = serial.Serial(port, baud, timeout=_POLL_S, write_timeout=1.0, exclusive=True)
    except Exception as error:  # SerialException, ValueError, OSError or termios.error, by platform and driver
        hint = _ERRNO_HINTS.get(getattr(error, "errno", None) or 0, _one_line(error))
        raise PortError(f"{port} cannot be opened: {hint}") from None
    return opened  # type: ignore[no-any-return]


def open_link(
    port: str, *, baud: int = 115200, timeout_s: float = 0.15, attempts: int = 12, hello_s: float = 3.0
) -> tuple[Link, Hello]:
    """Open a port and greet the device on it.

    Parameters
    ----------
    port : str
        Name of a serial port, as ``/dev/ttyUSB0`` or ``COM3``.
    baud : int
        Line rate; CXP1 devices use 115200.
    timeout_s, attempts
        As `Link`.
    hello_s : float
        How long to greet before giving up.

    Returns
    -------
    link : Link
        The open link; close it, or use it as a context manager.
    hello : Hello
        What the device said of itself.

    Raises
    ------
    PortError
        If the port cannot be opened, or no CXP1 device answers on it.
    LinkError
        If the device disappears while it is greeted.
    """
    opened = open_port(port, baud=baud)
    try:
        link = Link(opened, name=port, timeout_s=timeout_s, attempts=attempts)
    except ValueError:
        opened.close()
        raise
    try:
        return link, link.hello(hello_s=hello_s)
    except BaseException:
        link.close()
        raise


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
