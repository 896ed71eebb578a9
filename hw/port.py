"""Serial ports: exclusive opening, and lookup by name or USB serial number."""

from __future__ import annotations

import contextlib
import os
from dataclasses import dataclass
from typing import Any, Protocol

from hw.errors import one_line

_BAUD = 115200  # of CXP1; a port over USB, as the Pulse Pal's, has none
_POLL_S = 0.01  # longest wait of a read: deadlines are checked as often
_ERRNO_HINTS = {
    # The numbers of Linux, and 35 of macOS: pyserial passes on nothing else that tells them apart.
    2: "there is no such port: plug the device in, or look at the port's name",
    6: "the device is gone: plug it in again",
    11: "another program has it open: close that one first",
    13: (
        "no permission: add yourself to the port's group (dialout), or close the program that"
        " uses it"
    ),
    16: "another program has it open: close that one first",
    21: "it is a folder: name a serial port",
    25: "it is no serial port: name one",
    35: "another program has it open: close that one first",
}


class PortError(ValueError):
    """The named port is missing, busy, silent, or another device than expected."""


class LinkError(RuntimeError):
    """A device that had answered stopped to do so: unplugged, hung, or the line is too noisy."""


class SerialPort(Protocol):
    """The part of ``serial.Serial`` that drivers use; `read` returns after a short timeout."""

    @property
    def in_waiting(self) -> int:
        """Bytes that can be read at once."""

    def read(self, size: int, /) -> bytes:
        """Read at most `size` bytes."""

    def write(self, data: bytes, /) -> int | None:
        """Write all bytes."""

    def close(self) -> None:
        """Close the port."""


class OpenPort:
    """An open port whose loss is a one-line error, after which it is closed.

    Parameters
    ----------
    port : SerialPort
        Owned from now on.
    name : str
        For messages.
    """

    def __init__(self, port: SerialPort, *, name: str) -> None:
        self.name = name
        self._port: SerialPort | None = port

    @property
    def is_open(self) -> bool:
        """Whether it is still open on our side."""
        return self._port is not None

    def read(self, size: int | None = None) -> bytes:
        """Read up to `size` bytes, waiting for a short time only.

        LinkError if the port was closed or is gone.
        """
        port = self._opened()
        try:
            return port.read(size or max(1, port.in_waiting))
        # termios.error is no OSError, and pyserial lets TypeError through on a closed port
        except Exception as error:
            raise self._gone(error) from error

    def write(self, data: bytes) -> None:
        """Write all bytes; errors as `read`."""
        port = self._opened()
        try:
            port.write(data)
        except Exception as error:
            raise self._gone(error) from error

    def close(self) -> None:
        """Close it; may be called again."""
        port = self._port
        self._port = None
        if port is not None:
            with contextlib.suppress(Exception):  # an unplugged port may refuse even this
                port.close()

    def _opened(self) -> SerialPort:
        if self._port is None:
            raise LinkError(f"{self.name} is closed: open it again")
        return self._port

    def _gone(self, error: Exception) -> LinkError:
        self.close()
        return LinkError(
            f"{self.name} is gone ({one_line(error)}): plug the device in and open the port again"
        )


@dataclass(frozen=True, slots=True)
class PortInfo:
    """A serial port of this machine.

    Parameters
    ----------
    port : str
        Name by which it is opened.
    description : str
        Description by the system.
    serial_number : str or None
        USB serial number, which stays when the port's name changes.
    """

    port: str
    description: str
    serial_number: str | None


def list_ports() -> tuple[PortInfo, ...]:
    """List the serial ports of this machine, sorted by name."""
    from serial.tools import list_ports as tool

    ports = (
        PortInfo(p.device, p.description or "", p.serial_number or None) for p in tool.comports()
    )
    return tuple(sorted(ports, key=lambda info: info.port))


def port_named(name: str) -> str:
    """Return the port that has a USB serial number, or the name itself when it is none.

    PortError if several ports have that serial number.
    """
    if os.path.exists(name):
        return name
    ports = [info.port for info in list_ports() if info.serial_number == name]
    if len(ports) > 1:
        raise PortError(
            f"serial number {name} is that of {' and '.join(ports)}: name one of the ports"
        )
    return ports[0] if ports else name


def open_port(port: str) -> SerialPort:
    """Open a serial port exclusively, at 115200 baud.

    Where the system allows it, the line that resets an Arduino is left as it is when the port is
    closed, so that opening it again finds the board and its program as they were.

    Parameters
    ----------
    port : str
        Name of a serial port, as ``/dev/ttyUSB0`` or ``COM3``, or its USB serial number.

    Raises
    ------
    PortError
        If it is missing, busy, or not a serial port.
    """
    import serial

    if not isinstance(port, str) or not port.strip():
        raise PortError(f"port is {port!r}: name a serial port")
    try:
        serial_port: Any = serial.Serial(
            # exclusive: two hosts on one line would take each other's replies
            port_named(port),
            _BAUD,
            timeout=_POLL_S,
            write_timeout=1.0,
            exclusive=True,
        )
    except PortError:
        raise
    except (
        Exception
    ) as error:  # SerialException, ValueError, OSError or termios.error, by platform and driver
        hint = _ERRNO_HINTS.get(_errno(error), one_line(error))
        raise PortError(f"{port} cannot be opened: {hint}") from None
    with contextlib.suppress(Exception):
        _keep_lines_on_close(serial_port.fileno())
    return serial_port  # type: ignore[no-any-return]


def _errno(error: BaseException | None) -> int:
    # pyserial wraps termios.error, which has its number in its arguments only.
    while error is not None:
        for number in (getattr(error, "errno", None), *error.args[:1]):
            if isinstance(number, int):
                return number
        error = error.__context__
    return 0


def _keep_lines_on_close(descriptor: int) -> None:
    import termios

    attributes = termios.tcgetattr(descriptor)
    attributes[2] &= ~termios.HUPCL  # else closing drops DTR, which resets an Arduino
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
