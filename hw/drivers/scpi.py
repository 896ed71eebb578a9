"""Driver of SCPI waveform generators of the 33500 class: a code as a burst at each trigger."""

from __future__ import annotations

import contextlib
import re
import struct
from typing import Any, Self

from hw.device import DeviceProfile
from hw.drivers.driver import WriteOnlyDevice
from hw.errors import DeviceError, WrongStateError, one_line
from hw.export.scpi import WAVEFORM, commands, sample_rate, samples
from hw.port import LinkError, PortError
from hw.program import Program

# Keysight's series that share these commands: 33500, 33600, EDU33210
_MODEL = re.compile(r"33[56]\d\d[A-Z]?|EDU3321\d[A-Z]?")
_ON = re.compile("1|ON")
_OFF = re.compile("0|OFF")
_ONE_CODE_A_TRIGGER = {
    "FUNC?": re.compile("ARB"),
    "BURS:MODE?": re.compile("TRIG"),
    # numbers come in any form of IEEE 488.2, as +1.0000E+00
    "BURS:NCYC?": re.compile(r"\+?1(\.0*)?(E\+?0+)?"),
    "TRIG:SOUR?": re.compile("EXT"),
    "BURS:STAT?": _ON,
}
"""Answers of an instrument that plays at a trigger only, and once: with any other it plays again
and again."""
_CLOCK = 1e-6  # clock error of such an instrument
_NO_ERROR = re.compile(r"[+-]?0+\s*(,|$)")  # as +0,"No error"
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

    def send(self, command: str, data: bytes = b"") -> None:
        """Send a command, with binary data right behind it.

        LinkError if the connection is lost.
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

        LinkError if the connection is lost, or no answer comes.
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
        # all of the queue: an error left in it would be blamed on the next command
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


class ScpiAwg(WriteOnlyDevice):
    """A waveform generator on an open link; it uses channel 1.

    The code begins one chip after the trigger. With the output off, which it is unless armed, the
    connector is open: a resistor must hold the shutter closed then.

    Parameters
    ----------
    link : ScpiLink
        Open link, owned by the driver from now on.

    Raises
    ------
    PortError
        If nothing answers, or another kind of instrument does.

    Examples
    --------
    ::

        with ScpiAwg.open("TCPIP::192.168.0.7::5025::SOCKET") as awg:
            report = awg.upload(program, arm=True)
            awg.trigger()
            awg.wait()
    """

    limits = (samples, sample_rate)

    def __init__(self, link: ScpiLink) -> None:
        self._firmware = _identity(link)
        super().__init__(name=link.name)
        self.link = link
        self._armed = False

    @classmethod
    def open(cls, resource: str, *, backend: str = "@py", timeout_s: float = 3.0) -> Self:
        """Open a VISA resource, and check the identity of the instrument.

        Parameters
        ----------
        resource : str
            VISA name, as ``TCPIP::192.168.0.7::5025::SOCKET`` or
            ``USB0::0x0957::0x2C07::MY52800000::INSTR``.
        backend : str
            VISA library: ``@py`` is pyvisa-py, an empty text the one of the system.
        timeout_s : float
            How long to wait for an answer.
        """
        try:
            import pyvisa
        except ImportError:
            raise PortError(
                f"{resource} needs an extra: pip install coded-exposure[visa]"
            ) from None
        try:
            # VISA counts ms; on a socket nothing but a line feed ends a message
            instrument = pyvisa.ResourceManager(backend).open_resource(
                resource, timeout=1000 * timeout_s, read_termination="\n", write_termination="\n"
            )
        except Exception as error:  # VisaIOError, ValueError, OSError or a bare Exception
            raise PortError(
                f"{resource} cannot be opened: {one_line(error)}; name a VISA resource"
            ) from None
        link = ScpiLink(instrument, name=resource)
        try:
            return cls(link)
        except BaseException:
            link.close()
            raise

    @property
    def firmware(self) -> str:
        """Firmware, as the device reports it."""
        return self._firmware

    def trigger(self) -> None:
        """Play the program once, now; WrongStateError if it is not armed, or is still playing."""
        if not self._armed:
            raise WrongStateError(f"{self.name} is not armed: arm before trigger")
        super().trigger()

    def play(self) -> None:
        """Play the program once and wait for its end; what was not armed is not left armed."""
        if self._armed:
            super().play()
            return
        self.arm()  # with the output off nothing would be seen of it
        with self._aborted_on_error():
            super().play()
        self.abort()

    def _lasts_ns(self, program: Program) -> int:
        return len(samples(program)) * program.chip_ns  # with the closed samples around the code

    def _load(self, program: Program, *, profile: DeviceProfile) -> None:
        # From the least voltage on, no order of setting the levels makes them cross.
        for command in ("VOLT MIN", "VOLT:OFFS 0", *commands(program, profile)):
            if command.startswith(f"DATA:ARB {WAVEFORM},"):
                self.link.do("FORM:BORD SWAP")  # little-endian floats follow
                self.link.do(f"DATA:ARB {WAVEFORM},", _block(samples(program, profile)))
            # the list is the export format too: only arming opens the output
            elif not command.endswith("?") and command != "OUTP ON":
                self.link.do(command)
        rate = float(sample_rate(program))
        answer = self.link.ask("FUNC:ARB:SRAT?")
        try:
            actual_rate = float(answer)
        except ValueError:
            raise DeviceError(
                f"{self.name} says its sample rate is {answer[:40]!r}: a number is needed"
            ) from None
        # The instrument rounds to what its clock divides to. Written so that NaN is refused too.
        if not abs(actual_rate - rate) <= _CLOCK * rate:
            raise DeviceError(
                f"{self.name} would play at {actual_rate:.9g} Sa/s: chips of"
                f" {program.chip_ns} ns need {rate:.9g} Sa/s"
            )

    def _arm(self) -> None:
        # Without a burst the output runs freely: it is off before the burst is, and until the
        # instrument confirms one.
        self.abort()
        # A burst that an abort cut off may still be running behind the output: it must not go on.
        self.link.do("BURS:STAT OFF")
        self.link.do("BURS:STAT ON")
        for question, right in _ONE_CODE_A_TRIGGER.items():
            self._confirm(question, right)
        self.link.do("OUTP ON")
        self._confirm("OUTP?", _ON)
        self._armed = True

    def _trigger(self) -> None:
        self.link.do("TRIG")  # works while an external trigger is waited for

    def _abort(self) -> None:
        self._armed = False  # first: whatever fails below, it needs to be armed anew
        # Without the error query of `do`: closing must not wait for it.
        self.link.send("OUTP OFF")
        self.link.send("*CLS")  # clear errors of earlier commands
        answer = self.link.ask("OUTP?")
        if not _OFF.fullmatch(answer):
            raise LinkError(
                f"{self.name} says {answer[:40]!r} to OUTP?: its output must be off, look at the"
                " instrument"
            )

    def _disconnect(self) -> None:
        self.link.close()

    def _confirm(self, question: str, right: re.Pattern[str]) -> None:
        answer = self.link.ask(question)
        if not right.fullmatch(answer):
            raise DeviceError(
                f"{self.name} says {answer[:40]!r} to {question}: it is not armed, look at the"
                " instrument"
            )


def _identity(link: ScpiLink) -> str:
    """Model and firmware, of an instrument that understands the commands of this driver."""
    try:
        answer = link.ask("*IDN?")
    except LinkError as error:
        raise PortError(str(error)) from None
    fields = [field.strip() for field in answer.split(",")]
    # IEEE 488.2: maker, model, serial number, firmware.
    if len(fields) != 4 or not _MODEL.fullmatch(fields[1]):
        raise PortError(
            f"{link.name} is {answer[:60]!r}: a 33500-class generator (335xx, 336xx, EDU3321x) is"
            " needed"
        )
    return f"{fields[1]} {fields[3]}"


def _block(values: tuple[int, ...]) -> bytes:
    """IEEE 488.2 definite-length block of 32-bit floats: a cut transfer is an error."""
    data = struct.pack(f"<{len(values)}f", *values)
    length = str(len(data))
    return f"#{len(length)}{length}".encode("ascii") + data
