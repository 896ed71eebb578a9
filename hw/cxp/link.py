"""CXP1 over a serial port: requests, retries, an abort when anything fails; asking all ports."""

from __future__ import annotations

import atexit
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Self

from hw.cxp.protocol import (
    AT_REST,
    BINARY,
    TEXT,
    FrameError,
    Framing,
    Hello,
    Op,
    Reply,
    op_name,
    parse_reply,
    request_body,
    unpack_hello,
    unpack_status,
)
from hw.errors import DeviceError, device_error
from hw.port import LinkError, OpenPort, PortError, PortInfo, SerialPort, list_ports, open_port

_ASKED_S = 2.5  # each port: a board that its opening resets answers late
_LONGEST_FRAME = 20_000  # 65535 chips in hexadecimal digits
_FRAMINGS = (BINARY, TEXT)
# After one of these this host answers for the shutter: it must be closed when anything fails.
_CHANGES = frozenset({Op.LOAD, Op.ARM, Op.TRIG})


class Link:
    """Requests and replies on an open port.

    As a context manager it sends ABORT when left by an exception after it has loaded, armed or
    triggered anything; a program armed by another host is not aborted. Left normally it leaves an
    armed device armed (its lease ends that). A link still open when the interpreter ends is left
    as by an exception.

    Parameters
    ----------
    port : SerialPort
        Open port, owned by the link from now on.
    name : str
        Name of the port, for messages.
    timeout_s : float
        How long to wait for a reply before the same frame is sent again. On USB converters a reply
        may take 16 ms longer than the line needs, so keep it at 0.1 s or more there.
    attempts : int
        How often one frame is sent at most.
    """

    def __init__(
        self, port: SerialPort, *, name: str, timeout_s: float = 0.15, attempts: int = 12
    ) -> None:
        self.name = name
        self.framing = BINARY
        self.timeout_s = timeout_s
        self.attempts = attempts
        self.retries = 0
        self.bad_frames = 0
        self.received_bytes = 0
        self._port = OpenPort(port, name=name)
        self._answerable = False
        self._seq = 0
        self._rest = b""
        atexit.register(self._leave)  # an exit without close leaves no shutter armed

    def request(self, op: int, payload: bytes = b"") -> bytes:
        """Send one request until its reply comes, and return the reply's data.

        The same frame is sent each time, so that the device can distinguish a retry from a second
        request.

        Raises
        ------
        DeviceError
            The subclass for the error the device answered.
        LinkError
            If no reply came, or the port failed.
        """
        self._seq = (self._seq + 1) % 256  # another seq is another request, never a retry
        before = self._answerable
        self._answerable = self._answerable or op in _CHANGES
        for attempt in range(self.attempts):
            self.retries += attempt > 0
            reply = self._ask(op, payload, self.framing, flush=attempt > 0)
            if reply is not None:
                if reply.error:
                    self._answerable = before  # refused: this request changed nothing
                elif op == Op.ABORT:
                    self._answerable = False
                return self._data(reply)
        raise LinkError(
            f"{self.name} does not answer {op_name(op)}, asked {self.attempts} times: "
            "check cable, power and firmware"
        )

    def hello(self, *, hello_s: float = 3.0) -> Hello:
        """Request HELLO for `hello_s` seconds: a board that resets on opening answers late.

        Both framings are tried in turn, and the one that is answered is kept.

        Raises
        ------
        PortError
            If nothing answers, garbage comes, or it is not a CXP1 device.
        LinkError
            If the port fails.
        """
        received = self.received_bytes
        self._seq = (self._seq + 1) % 256
        try:
            # At least one try in each framing.
            for attempt in range(max(2, round(hello_s / self.timeout_s))):
                self.retries += attempt > 1
                framing = _FRAMINGS[(_FRAMINGS.index(self.framing) + attempt) % 2]
                reply = self._ask(Op.HELLO, b"", framing, flush=True)
                if reply is not None:
                    self.framing = framing
                    return unpack_hello(self._data(reply))
        except (FrameError, DeviceError) as error:
            raise PortError(f"{self.name} is not a CXP1 shutter controller: {error}") from None
        heard = self.received_bytes - received
        if heard:
            raise PortError(
                f"{self.name} sends {heard} bytes but no CXP1 reply: wrong baud rate, or not a"
                " shutter controller"
            )
        raise PortError(
            f"{self.name} is silent for {hello_s:g} s: check power and firmware, or name another"
            " port"
        )

    def abort(self) -> bool:
        """Close the shutter and disarm, never raising; False unless the device is then at rest."""
        if not self._port.is_open:
            return False
        try:
            self.request(Op.ABORT)
            return unpack_status(self.request(Op.STATUS)).state in AT_REST
        except (LinkError, DeviceError, FrameError):
            return False

    def close(self) -> None:
        """Close the port without sending anything; may be called again."""
        atexit.unregister(self._leave)
        self._port.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if error is not None and self._answerable:
            self.abort_after(error)
        self.close()

    def abort_after(self, error: BaseException) -> None:
        """Send ABORT because of `error`, with a note on it where the device does not confirm."""
        note = f"{self.name} did not confirm ABORT: the shutter may still be open"
        if not self.abort() and note not in getattr(error, "__notes__", ()):
            error.add_note(note)

    @contextmanager
    def aborted_on_error(self, *but: type[BaseException]) -> Iterator[None]:
        """Send ABORT at once where anything but these errors leaves the context."""
        try:
            yield
        except but:
            raise
        except BaseException as error:
            self.abort_after(error)
            raise

    def _leave(self) -> None:
        if self._answerable:
            self.abort()
        self.close()

    def _ask(self, op: int, payload: bytes, framing: Framing, *, flush: bool) -> Reply | None:
        frame = framing.encode(request_body(op, self._seq, payload))
        # The end in front closes what noise has left half-received in the device, so that a retry
        # is not lost too.
        self._port.write(framing.end + frame if flush else frame)
        deadline = time.monotonic() + self.timeout_s
        while True:
            data = self._port.read()
            self.received_bytes += len(data)
            frames, self._rest = framing.split(self._rest + data)
            self._rest = self._rest[-_LONGEST_FRAME:]
            # Late replies to an earlier request may come first: they have another op or seq.
            for index, received in enumerate(frames):
                try:
                    reply = parse_reply(framing.decode(received))
                except FrameError:
                    self.bad_frames += 1
                    continue
                if (reply.op, reply.seq) == (op, self._seq):
                    self._rest = (
                        b"".join(later + framing.end for later in frames[index + 1 :]) + self._rest
                    )
                    return reply
            if time.monotonic() >= deadline:
                return None

    def _data(self, reply: Reply) -> bytes:
        if reply.error:
            raise device_error(reply.error, request=op_name(reply.op), source=self.name)
        return reply.data


def open_link(
    port: str, *, timeout_s: float = 0.15, attempts: int = 12, hello_s: float = 3.0
) -> tuple[Link, Hello]:
    """Open a port and request the HELLO of the device on it.

    Parameters
    ----------
    port : str
        Name of a serial port, as ``/dev/ttyUSB0`` or ``COM3``.
    timeout_s, attempts
        As `Link`.
    hello_s : float
        How long to greet before giving up.

    Returns
    -------
    link : Link
        The open link; close it, or use it as a context manager.
    hello : Hello
        The device's HELLO.

    Raises
    ------
    PortError
        If the port cannot be opened, or no CXP1 device answers on it.
    LinkError
        If the device disappears while it is greeted.
    """
    link = Link(open_port(port), name=port, timeout_s=timeout_s, attempts=attempts)
    try:
        return link, link.hello(hello_s=hello_s)
    except BaseException:
        link.close()
        raise


def ask_ports() -> tuple[tuple[PortInfo, Hello | str], ...]:
    """Request a HELLO on every serial port: each HELLO, or the reason why there is none.

    Opening a port resets many boards, and other devices receive unexpected bytes.
    """
    answers: list[tuple[PortInfo, Hello | str]] = []
    for info in list_ports():
        try:
            link, hello = open_link(info.port, hello_s=_ASKED_S)
        except (PortError, LinkError) as error:
            answers.append((info, str(error)))
        else:
            link.close()
            answers.append((info, hello))
    return tuple(answers)


def only_controller() -> str:
    """Return the port of the only controller that is connected; PortError for none or several."""
    ports = [info.port for info, answer in ask_ports() if isinstance(answer, Hello)]
    if not ports:
        raise PortError(
            "auto finds no shutter controller, no serial port answers as one: plug it in, or name"
            " its port"
        )
    if len(ports) > 1:
        raise PortError(
            f"auto finds {' and '.join(ports)}, all shutter controllers: name one of them"
        )
    return ports[0]
