"""SCPI messages to a VISA instrument: each command is followed by an error query."""

from __future__ import annotations

import contextlib
import re
from typing import Any

from hw.errors import DeviceError
from hw.port import LinkError, PortError, one_line

_NO_ERROR = re.compile(r"[+-]?0+\s*(,|$)")
_LONGEST_QUEUE = 40  # of errors; an instrument that reports more is of another kind


class ScpiLink:
    """Commands and answers on an open VISA resource.

    Parameters
    ----------
    resource : pyvisa.resources.MessageBasedResource
        Open resource, owned by the link from now on.
    name : str
        Name of the resource, for messages.
    """

    def __init__(self, resource: Any, *, name: str) -> None:
        self.name = name
        self._resource = resource

    @property
    def is_open(self) -> bool:
        """Whether the resource is still open on our side."""
        return self._resource is not None

    def send(self, command: str, data: bytes = b"") -> None:
        """Send a command, with binary data right behind it.

        Raises
        ------
        LinkError
            If the connection is lost.
        """
        try:
            self._opened().write_raw(command.encode("ascii") + data + b"\n")
        except LinkError:
            raise
        except Exception as error:  # VisaIOError or what the bus raises
            raise LinkError(
                f"{self.name} is gone ({one_line(error)}): check power and cable, open it again"
            ) from error

    def ask(self, question: str) -> str:
        """Send a query and return its answer.

        Raises
        ------
        LinkError
            If the connection is lost, or no answer comes.
        """
        self.send(question)
        try:
            return str(self._opened().read()).strip()
        except Exception as error:
            raise LinkError(
                f"{self.name} does not answer {question} ({one_line(error)}): check power and"
                " cable, open it again"
            ) from error

    def do(self, command: str, data: bytes = b"") -> None:
        """Send a command and fetch its errors.

        Raises
        ------
        DeviceError
            If there is any.
        LinkError
            If the connection is lost, or no answer comes.
        """
        self.send(command, data)
        errors: list[str] = []
        while (
            not _NO_ERROR.match(answer := self.ask("SYST:ERR?")) and len(errors) < _LONGEST_QUEUE
        ):
            errors.append(" ".join(answer.split())[:80])
        if errors:
            raise DeviceError(f"{self.name} refuses {command[:40]}: {'; '.join(errors[:3])}")

    def close(self) -> None:
        """Close the resource without sending anything; may be called again."""
        resource = self._resource
        self._resource = None
        if resource is not None:
            with contextlib.suppress(Exception):  # a lost connection may refuse even this
                resource.close()

    def _opened(self) -> Any:
        if self._resource is None:
            raise LinkError(f"{self.name} is closed: open it again")
        return self._resource


def open_scpi(resource: str, *, backend: str = "@py", timeout_s: float = 3.0) -> ScpiLink:
    """Open a VISA resource.

    Parameters
    ----------
    resource : str
        VISA name, as ``TCPIP::192.168.0.7::5025::SOCKET`` or
        ``USB0::0x0957::0x2C07::MY52800000::INSTR``.
    backend : str
        VISA library: ``@py`` is pyvisa-py, an empty text the one of the system.
    timeout_s : float
        How long to wait for an answer.

    Raises
    ------
    PortError
        If pyvisa is missing, or the resource cannot be opened.
    """
    if not timeout_s > 0:
        raise ValueError(f"timeout_s is {timeout_s}: above 0 is needed")
    try:
        import pyvisa
    except ImportError:
        raise PortError(f"{resource} needs an extra: pip install coded-exposure[visa]") from None
    try:
        opened = pyvisa.ResourceManager(backend).open_resource(
            resource, timeout=1000 * timeout_s, read_termination="\n", write_termination="\n"
        )
    except (
        Exception
    ) as error:  # VisaIOError, ValueError, OSError or a bare Exception, by backend and bus
        raise PortError(
            f"{resource} cannot be opened: {one_line(error)}; name a VISA resource"
        ) from None
    return ScpiLink(opened, name=resource)
