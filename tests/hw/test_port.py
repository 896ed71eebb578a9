"""Serial ports: by name or serial number, opened exclusively; their loss is one line."""

import os
import pty
import termios
from types import SimpleNamespace

import pytest
from emulators.scripted_port import ScriptedPort
from serial.tools import list_ports as tool

from hw.port import LinkError, OpenPort, PortError, PortInfo, list_ports, open_port, port_named


@pytest.fixture
def plugged(monkeypatch):
    """Two boards of different serial numbers, and two adapters of the same one."""
    ports = [
        SimpleNamespace(device=device, description=description, serial_number=serial_number)
        for device, description, serial_number in (
            ("ttyZ3", "Adapter", "0001"),
            ("ttyZ1", "Uno", "8533"),
            ("ttyZ2", None, ""),
            ("ttyZ0", "Adapter", "0001"),
            ("ttyZ4", "Pico", "E661"),
        )
    ]
    monkeypatch.setattr(tool, "comports", lambda: ports)


@pytest.mark.usefixtures("plugged")
def test_ports_are_sorted_by_name_and_state_what_the_system_knows():
    ports = list_ports()
    assert [info.port for info in ports] == [f"ttyZ{k}" for k in range(5)]
    assert ports[1] == PortInfo("ttyZ1", "Uno", "8533")
    assert ports[2] == PortInfo("ttyZ2", "", None)


@pytest.mark.usefixtures("plugged")
def test_a_serial_number_is_that_of_its_port():
    assert [port_named(number) for number in ("8533", "E661")] == ["ttyZ1", "ttyZ4"]
    assert port_named("ttyZ2") == "ttyZ2"
    with pytest.raises(PortError, match=r"0001 is that of ttyZ0 and ttyZ3: name one of the ports"):
        port_named("0001")


@pytest.mark.usefixtures("plugged")
def test_a_name_that_exists_is_no_serial_number(monkeypatch, tmp_path):
    (tmp_path / "8533").touch()
    monkeypatch.chdir(tmp_path)
    assert port_named("8533") == "8533"


@pytest.fixture
def terminal():
    """Name of a terminal whose other end is ours."""
    ours, theirs = pty.openpty()
    name = os.ttyname(theirs)
    os.close(theirs)
    yield name
    os.close(ours)


def test_one_program_at_a_time_opens_a_port(terminal):
    with open_port(terminal), pytest.raises(PortError, match="another program has it open"):
        open_port(terminal)
    open_port(terminal).close()


def test_closing_a_port_leaves_the_line_that_resets_a_board(terminal):
    descriptor = os.open(terminal, os.O_RDWR | os.O_NOCTTY)
    attributes = termios.tcgetattr(descriptor)
    attributes[2] |= termios.HUPCL | termios.CSTOPB
    termios.tcsetattr(descriptor, termios.TCSANOW, attributes)
    with open_port(terminal):
        assert not termios.tcgetattr(descriptor)[2] & termios.HUPCL
        assert termios.tcgetattr(descriptor)[2] & termios.CREAD
        assert termios.tcgetattr(descriptor)[4] == termios.B115200
    os.close(descriptor)


@pytest.mark.parametrize("name", ["", "  ", None, 3])
def test_a_port_needs_a_name(name):
    with pytest.raises(PortError, match="name a serial port"):
        open_port(name)


def test_what_is_no_port_is_said_to_be_none(tmp_path):
    (tmp_path / "notes.txt").touch()
    for name, hint in (
        (tmp_path / "ttyNONE", "there is no such port"),
        (tmp_path, "it is a folder"),
        (tmp_path / "notes.txt", "it is no serial port"),
    ):
        with pytest.raises(PortError, match=rf"{name.name} cannot be opened: {hint}"):
            open_port(str(name))


class UnpluggedPort:
    """A port with some bytes waiting, which fails after them."""

    def __init__(self, data: bytes) -> None:
        self.data = data

    @property
    def in_waiting(self) -> int:
        return len(self.data)

    def read(self, size: int) -> bytes:
        if not self.data:
            raise termios.error(5, "Input/output error")
        data = self.data[:size]
        self.data = self.data[size:]
        return data

    def write(self, data: bytes) -> int:
        return len(data)

    def close(self) -> None:
        raise OSError("gone")


def test_all_that_waits_is_read_and_the_loss_closes():
    port = OpenPort(UnpluggedPort(b"abcdef"), name="ttyZ1")
    assert port.read(2) == b"ab"
    assert port.read() == b"cdef"
    assert port.is_open
    with pytest.raises(LinkError, match=r"ttyZ1 is gone .*Input/output error.*plug the device in"):
        port.read()
    assert not port.is_open
    with pytest.raises(LinkError, match="ttyZ1 is closed: open it again"):
        port.write(b"x")
    port.close()


def test_closing_lets_the_port_go():
    scripted = ScriptedPort()
    OpenPort(scripted, name="ttyZ1").close()
    assert scripted.closed
