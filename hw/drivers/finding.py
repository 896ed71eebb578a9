"""Discovery of CXP1 controllers on all serial ports."""

from __future__ import annotations

from hw.cxp.link import open_link
from hw.cxp.protocol import Hello
from hw.drivers.cxp import Controller
from hw.port import LinkError, PortError, PortInfo, list_ports


def ask_ports(*, hello_s: float = 2.5) -> tuple[tuple[PortInfo, Hello | str], ...]:
    """Request a HELLO on every serial port; returns each HELLO, or the reason why there is none in
    one line.

    Opening a port resets many boards, and other devices receive unexpected bytes.
    """
    found: list[tuple[PortInfo, Hello | str]] = []
    for info in list_ports():
        try:
            link, hello = open_link(info.port, hello_s=hello_s)
        except (PortError, LinkError) as error:
            found.append((info, str(error)))
        else:
            link.close()
            found.append((info, hello))
    return tuple(found)


def open_controller(port: str) -> Controller:
    """Open the controller on a port, or with ``"auto"`` the only one that is connected.

    Parameters
    ----------
    port : str
        Name or USB serial number of a port, or ``"auto"``, which greets them all.

    Raises
    ------
    PortError
        If the port cannot be opened or is no controller, or with ``"auto"`` when there is none, or
        more than one.
    """
    if port != "auto":
        return Controller.open(port)
    names = [info.port for info, answer in ask_ports() if isinstance(answer, Hello)]
    if not names:
        raise PortError(
            "auto finds no shutter controller, no serial port answers as one: plug it in, or name"
            " its port"
        )
    if len(names) > 1:
        raise PortError(
            f"auto finds {' and '.join(names)}, all shutter controllers: name one of them"
        )
    return Controller.open(names[0])
