"""Driver of the Pulse Pal v2: a code as a custom pulse train on one of its outputs."""

from __future__ import annotations

import contextlib
from typing import Self

from hw.device import DeviceProfile
from hw.drivers.pulse_pal_link import Parameter, PulsePalLink, dac_code, open_pulsepal
from hw.drivers.write_only import WriteOnlyDevice
from hw.export.pulse_pal import MAX_PULSES, pulse_train
from hw.port import LinkError
from hw.program import Program

_CHANNEL = 1
_TRIGGER_INPUT = 1
_HIGH_VOLTS = 5.0  # TTL


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
        """Open the Pulse Pal on a serial port; parameters as `open_pulsepal`."""
        return cls(open_pulsepal(port, timeout_s=timeout_s, hello_s=hello_s))

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
            self.link.load_train((*train.onsets_cycles, train.guard_cycles), open_code)
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
