"""A shutter controller that plays codes: opened by its port, whatever its driver."""

from __future__ import annotations

from dataclasses import replace
from types import TracebackType
from typing import Self

from cep.optics.code import ShutterCode
from hw.device import DeviceProfile, load_profile
from hw.drivers.cxp import Controller
from hw.drivers.report import UploadReport
from hw.drivers.write_only import WriteOnlyDevice
from hw.program import Program

__all__ = ["DRIVERS", "Shutter", "open_shutter"]

DRIVERS = ("cxp", "pulse-pal", "scpi")
"""Names of the drivers: our firmware, a Pulse Pal, a waveform generator with SCPI."""


class Shutter:
    """An opened shutter controller; :func:`open_shutter` makes it.

    Use it as a context manager: left by an exception it closes and disarms the shutter.

    Attributes
    ----------
    device : Controller or WriteOnlyDevice
        The driver, for what it can do besides.
    """

    def __init__(self, device: Controller | WriteOnlyDevice) -> None:
        self.device = device

    def upload(
        self,
        code: ShutterCode,
        *,
        profile: DeviceProfile | str | None = None,
        arm: bool = False,
        play: bool = False,
        lease_ms: int = 10_000,
        clock_ppm: float = 0.0,
    ) -> UploadReport:
        """Load a code, read it back where the device can be asked, and arm or play it if wanted.

        Parameters
        ----------
        code : ShutterCode
        profile : DeviceProfile or str, optional
            Limits of the shutter, or their name as of :func:`hw.device.load_profile`; checked before anything is sent.
        arm : bool
            The next trigger plays the code.
        play : bool
            Play it once, now, and wait for its end; it is not armed afterwards.
        lease_ms : int
            An armed "cxp" controller disarms itself after this; other devices stay armed until the next upload.
        clock_ppm : float
            By how much the clock of a "cxp" controller is fast, as ``cep hw calibrate`` finds it.

        Raises
        ------
        ValueError
            If the shutter or the device cannot play the code: the line lists every limit it breaks. Nothing was sent.
        hw.errors.DeviceError, hw.port.LinkError, hw.cxp.player.VerifyError
            If the device refuses, stops answering, or holds another program than it was sent.
        """
        program = Program.from_bits(code.bits, chip_ns=code.chip_ns)
        limits = load_profile(profile) if isinstance(profile, str) else profile
        if isinstance(self.device, Controller):
            report = self.device.upload(
                program, profile=limits, arm=arm or play, lease_ms=lease_ms, clock_ppm=clock_ppm
            )
            if play:
                self.device.play(timeout_s=1.1e-9 * program.duration_ns + 2)
                report = replace(report, armed=False, lease_ms=None)
            return report
        if clock_ppm:
            raise ValueError("clock_ppm: this device cannot stretch chips, only cxp controllers do")
        report = self.device.upload(program, profile=limits, arm=arm)
        if play:
            self.device.play()
        return report

    def abort(self) -> None:
        """Close the shutter and disarm; raises where the device does not confirm it."""
        self.device.abort()

    def __enter__(self) -> Self:
        self.device.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.device.__exit__(kind, error, trace)


def open_shutter(port: str, *, driver: str = "cxp") -> Shutter:
    """Open a shutter controller.

    Parameters
    ----------
    port : str
        Serial port as ``/dev/ttyACM0`` or ``COM3``, a USB serial number, or with "cxp" ``auto`` for the only one
        connected; with "scpi" a VISA resource.
    driver : {"cxp", "pulse-pal", "scpi"}

    Raises
    ------
    ValueError
        If the driver is not known, or the port cannot be used; the line says why.

    Examples
    --------
    ::

        with open_shutter("/dev/ttyACM0") as shutter:
            shutter.upload(ShutterCode("11100101", chip_ns=500_000), arm=True)
    """
    if driver not in DRIVERS:
        raise ValueError(f"driver: must be one of {', '.join(DRIVERS)}, got {driver[:40]!r}")
    if driver == "cxp":
        from hw.drivers.finding import open_controller

        return Shutter(open_controller(port))
    if driver == "pulse-pal":
        from hw.drivers.pulsepal import PulsePal

        return Shutter(PulsePal.open(port))
    from hw.drivers.scpi import ScpiAwg

    return Shutter(ScpiAwg.open(port))
