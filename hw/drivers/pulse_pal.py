"""Driver of the Pulse Pal v2: a code as a custom pulse train on its first output.

In its serial protocol a command is a menu byte, an op and its data; few ops are answered.
"""

from __future__ import annotations

import contextlib
import struct
import time
from collections.abc import Sequence
from enum import IntEnum
from typing import Self

from hw.device import DeviceProfile
from hw.drivers.driver import WriteOnlyDevice
from hw.errors import DeviceError
from hw.export.pulse_pal import MAX_PULSES, pulse_train
from hw.port import LinkError, OpenPort, PortError, SerialPort, open_port
from hw.program import Program

_CHANNEL = 1
_TRIGGER_INPUT = 1
_HIGH_VOLTS = 5.0  # TTL
_MENU = 213  # begins every command
_OLDEST = 20  # firmware of model 2 begins at 20; far above, it is some other device that said "K"
_NEWEST = 99
_BYTES_PER_S = 50_000  # slowest transfer waited for; USB is much faster


class _Op(IntEnum):
    HELLO = 72
    SET = 74
    TRAIN_1 = 75
    TRIGGER = 77
    ABORT = 80
    INFO = 94


class Parameter(IntEnum):
    """Parameters of a channel, with the protocol's numbers."""

    BIPHASIC = 1  # 0: one phase, hence one voltage a pulse
    PHASE_1_VOLTS = 2
    PHASE_1_CYCLES = 4  # width of every pulse
    BURST_CYCLES = 8  # 0: no bursts
    TRAIN_CYCLES = 10
    DELAY_CYCLES = 11  # from the trigger to the first pulse
    LINK_1 = 12  # whether trigger input 1 starts the channel
    LINK_2 = 13
    TRAIN = 14  # which custom train, 0 for none
    TRAIN_TARGET = 15  # whether its times are those of pulses (0) or of bursts
    TRAIN_LOOP = 16  # whether it is repeated
    REST_VOLTS = 17  # between pulses
    TRIGGER_MODE = 128  # of an input: 0 starts at a rising edge, others toggle or gate


# parameters of more than one byte
_FORMATS = {
    Parameter.PHASE_1_VOLTS: "<H",
    Parameter.PHASE_1_CYCLES: "<I",
    Parameter.BURST_CYCLES: "<I",
    Parameter.TRAIN_CYCLES: "<I",
    Parameter.DELAY_CYCLES: "<I",
    Parameter.REST_VOLTS: "<H",
}


def dac_code(volts: float) -> int:
    """Turn a voltage of -10..10 V into the 16-bit code of the output."""
    # 65536 steps from -10 V, and none for +10 V itself.
    return min(65535, round((volts + 10) / 20 * 65536))


class PulsePalLink:
    """Commands and replies on an open port.

    There are no sequence numbers and no check sums: a reply that does not come makes everything
    after it uncertain, hence only the handshake is ever repeated.

    Parameters
    ----------
    port : SerialPort
        Open port, owned by the link from now on.
    name : str
        Name of the port, for messages.
    timeout_s : float
        How long to wait for a reply.
    """

    def __init__(self, port: SerialPort, *, name: str, timeout_s: float = 0.5) -> None:
        self.name = name
        self.timeout_s = timeout_s
        self.retries = 0
        self.firmware = 0
        self._port = OpenPort(port, name=name)

    def hello(self, *, hello_s: float) -> None:
        """Greet the device for `hello_s` seconds and note its firmware.

        PortError if nothing answers, or it is no Pulse Pal of model 2 with 50 us cycles.
        """
        heard = self._greet(hello_s)
        if not heard:
            raise PortError(
                f"{self.name} is silent for {hello_s:g} s: plug the Pulse Pal out and in again, or"
                " name another port"
            )
        firmware = _firmware(heard)
        if firmware is None:
            raise PortError(
                f"{self.name} sends {len(heard)} bytes but no handshake: not a Pulse Pal"
            )
        if firmware < _OLDEST:
            raise PortError(
                f"{self.name} is a Pulse Pal of model 1 (firmware {firmware}): model 2 is needed"
            )
        self.firmware = firmware
        # until then the op meant something else, and there were no other cycles than 50 us
        if firmware > 21:
            self._port.write(bytes([_MENU, _Op.INFO]))
            cycle_us = struct.unpack("<BIBI", self._take(10, "INFO", self.timeout_s))[1]
            if cycle_us != 50:
                raise PortError(
                    f"{self.name} has cycles of {cycle_us} us: a Pulse Pal with 50 us is needed"
                )

    def check_in_step(self) -> None:
        """Handshake once more: nothing else may come back.

        LinkError if the replies do not fit the commands: it is then unknown which were accepted.
        """
        heard = self._greet(self.timeout_s)
        if heard != b"K" + struct.pack("<I", self.firmware):
            raise LinkError(
                f"{self.name} answers out of step ({heard[:12].hex(' ') or 'nothing'}): load again"
            )

    def set(self, parameter: Parameter, channel: int, value: int) -> None:
        """Set a parameter of an output, or of a trigger input (`Parameter.TRIGGER_MODE`).

        Raises
        ------
        DeviceError
            If the device refuses it.
        LinkError
            If it does not answer.
        """
        data = struct.pack(_FORMATS.get(parameter, "<B"), value)
        self._port.write(bytes([_MENU, _Op.SET, parameter, channel]) + data)
        self._acknowledged(f"{parameter.name} = {value}", self.timeout_s)

    def load_train(self, onsets_cycles: Sequence[int], volts_code: int) -> None:
        """Store custom train 1: pulses of one voltage; errors as `set`."""
        count = len(onsets_cycles)
        data = struct.pack(
            f"<BBI{count}I{count}H",
            _MENU,
            _Op.TRAIN_1,
            count,
            *onsets_cycles,
            *[volts_code] * count,
        )
        try:
            self._port.write(data)
            self._acknowledged(
                f"a train of {count} pulses", self.timeout_s + len(data) / _BYTES_PER_S
            )
        except BaseException:
            # Cut short, the device would take the commands that follow, ABORT too, for the rest of
            # the train.
            if self._port.is_open:
                self._port.write(bytes(len(data)))
            raise

    def trigger(self, channel: int) -> None:
        """Start a channel, if it is idle; there is no reply."""
        self._port.write(bytes([_MENU, _Op.TRIGGER, 1 << (channel - 1)]))

    def stop(self) -> None:
        """Stop all channels; the handshake that follows proves that it was done.

        LinkError if the handshake is not answered.
        """
        self._port.write(bytes([_MENU, _Op.ABORT]))
        if _firmware(self._greet(3 * self.timeout_s)) is None:
            raise LinkError(f"{self.name} does not answer: check cable and power")

    def close(self) -> None:
        """Close the port without sending anything; may be called again."""
        self._port.close()

    def _greet(self, seconds: float) -> bytes:
        """Handshake until an answer comes, and return all received bytes."""
        deadline = time.monotonic() + seconds
        received = b""
        for attempt in range(max(1, round(seconds / self.timeout_s))):
            self.retries += attempt > 0
            # The handshake changes nothing, so it alone may be repeated.
            self._port.write(bytes([_MENU, _Op.HELLO]))
            retry_s = min(deadline, time.monotonic() + self.timeout_s)
            while _firmware(received) is None and time.monotonic() < retry_s:
                # bounded: some other device may send without end
                received = (received + self._port.read())[-4096:]
            if _firmware(received) is not None:
                if attempt:
                    self._quiet()
                break
        return received

    def _quiet(self) -> None:
        """Let late answers to handshakes pass, which would be taken for acknowledgements."""
        heard_s = start_s = time.monotonic()
        while time.monotonic() - heard_s < self.timeout_s:
            if self._port.read():
                heard_s = time.monotonic()
            if heard_s - start_s > 10 * self.timeout_s:
                raise LinkError(
                    f"{self.name} never stops sending: not a Pulse Pal, or plug it out and in"
                    " again"
                )

    def _acknowledged(self, what: str, seconds: float) -> None:
        reply = self._take(1, what, seconds)[0]
        if reply == 0:
            raise DeviceError(
                f"{self.name} refuses {what}: out of range for its firmware {self.firmware}"
            )
        if reply != 1:
            raise LinkError(
                f"{self.name} answers 0x{reply:02x} to {what}: does another program talk to it?"
                " load again"
            )

    def _take(self, size: int, what: str, seconds: float) -> bytes:
        deadline = time.monotonic() + seconds
        reply = b""
        while len(reply) < size:
            reply += self._port.read(size - len(reply))
            if len(reply) < size and time.monotonic() >= deadline:
                raise LinkError(f"{self.name} does not answer {what}: check cable and power")
        return reply


class PulsePal(WriteOnlyDevice):
    """A Pulse Pal on an open link.

    Output 1 drives the shutter, at 5 V for an open one and 0 V for a closed one; for a device
    profile with ``closed_level = 1`` it is the other way round. Rising edges of trigger input 1
    play an armed program.

    `upload` and `abort` stop all four outputs, the only way the device has. A trigger takes effect
    some 50 us later.

    Parameters
    ----------
    link : PulsePalLink
        Open link that has been greeted, owned by the driver from now on.

    Examples
    --------
    ::

        with PulsePal.open("/dev/ttyACM0") as device:
            report = device.upload(program)
            device.trigger()
            device.wait()
    """

    limits = (pulse_train,)

    def __init__(self, link: PulsePalLink) -> None:
        super().__init__(name=link.name)
        self.link = link

    @classmethod
    def open(cls, port: str, *, timeout_s: float = 0.5, hello_s: float = 3.0) -> Self:
        """Open the Pulse Pal on a serial port, by its name or USB serial number, and greet it.

        Parameters
        ----------
        port : str
        timeout_s : float
            How long to wait for a reply.
        hello_s : float
            How long to greet before giving up.
        """
        serial_port = open_port(port)
        try:
            link = PulsePalLink(serial_port, name=port, timeout_s=timeout_s)
            link.hello(hello_s=hello_s)
        except BaseException:
            serial_port.close()
            raise
        return cls(link)

    @property
    def firmware(self) -> str:
        """Firmware, as the device reports it."""
        return f"pulse-pal {self.link.firmware}"

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings for the user about this device, one sentence each."""
        if self.link.firmware == 20:
            return (
                "firmware 20 has a fault in gated triggers, which are not used here: update the"
                " Pulse Pal to 21",
            )
        return ()

    @property
    def _retries(self) -> int:
        return self.link.retries

    def _load(self, program: Program, *, profile: DeviceProfile) -> None:
        train = pulse_train(program)
        closed_code = dac_code(0.0)
        open_code = dac_code(_HIGH_VOLTS)
        if profile.closed_level:
            closed_code, open_code = open_code, closed_code
        # The closed level comes first: until it is set the output may be at any voltage.
        for parameter, value in (
            (Parameter.REST_VOLTS, closed_code),
            (Parameter.TRAIN_TARGET, 0),
            (Parameter.TRAIN, 1),
            (Parameter.TRAIN_LOOP, 0),
            (Parameter.BIPHASIC, 0),
            (Parameter.PHASE_1_VOLTS, open_code),
            (Parameter.PHASE_1_CYCLES, train.phase_cycles),
            (Parameter.BURST_CYCLES, 0),
            # Past the last pulse: a train that ends earlier cuts it.
            (Parameter.TRAIN_CYCLES, train.train_cycles),
            (Parameter.DELAY_CYCLES, train.delay_cycles),
        ):
            self.link.set(parameter, _CHANNEL, value)
        # the firmware looks one entry past the train: a closed guard has to lie there
        if len(train.onsets_cycles) < MAX_PULSES:  # behind a full train nothing was ever stored
            self.link.load_train((*train.onsets_cycles, train.train_cycles), open_code)
        self.link.load_train(train.onsets_cycles, open_code)
        # acknowledgements are single bytes: one too many would pass for the next one's
        self.link.check_in_step()

    def _arm(self) -> None:
        self.link.set(Parameter.TRIGGER_MODE, _TRIGGER_INPUT, 0)
        self.link.set(Parameter.LINK_1, _CHANNEL, 1)  # last: nothing plays before it

    def _trigger(self) -> None:
        self.link.trigger(_CHANNEL)

    def _abort(self) -> None:
        try:
            self.link.stop()
        except LinkError:
            # A device whose answers are lost may still obey: its trigger input must not play the
            # code again.
            with contextlib.suppress(LinkError):
                self.link.set(Parameter.LINK_1, _CHANNEL, 0)
            raise
        for linked in (Parameter.LINK_1, Parameter.LINK_2):
            self.link.set(linked, _CHANNEL, 0)
        # A trigger that was waiting at the first stop has started a train right behind it; now
        # none can follow.
        self.link.stop()

    def _disconnect(self) -> None:
        self.link.close()


def _firmware(heard: bytes) -> int | None:
    """Firmware number when the last five bytes are the answer to a handshake."""
    if len(heard) < 5 or heard[-5] != ord("K"):
        return None
    number = int.from_bytes(heard[-4:], "little")
    if not 0 < number <= _NEWEST:
        return None  # chance bytes, or some other device
    return number
