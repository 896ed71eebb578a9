"""Report of an upload, with the level of trust that it proves."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Trust(StrEnum):
    """Level of evidence that a shutter plays the program."""

    A = "A"
    """The device sent its stored program back identical, and its firmware's edges are proven on
    emulated hardware."""
    B = "B"
    """The device acknowledged the program, and no more is known."""
    C = "C"
    """A file was written; no device was involved."""

    @property
    def meaning(self) -> str:
        """Meaning of the level, in a few words."""
        return _MEANINGS[self]


_MEANINGS = {
    Trust.A: "read back, edge timing proven on emulated hardware",
    Trust.B: "acknowledged only",
    Trust.C: "file only",
}


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadReport:
    """Outcome of an upload that succeeded.

    Parameters
    ----------
    port : str
        Port of the device.
    chips, chip_ns, pulses, duration_ns, code_crc32 : int
        The program, as `hw.program.Program` names it.
    trust : Trust
        Trust proven by the upload.
    read_back : bool
        Whether the device sent the program back, identical.
    firmware : str
        Firmware, as the device reports it.
    armed : bool
        Whether the device now waits for a trigger; it does not if one came right after arming.
    lease_ms : int or None
        After how long without a trigger an armed device disarms itself.
    clock_ppm : float
        Assumed error of the device's clock, positive when fast.
    warnings : tuple of str
        Deviations from the program, one sentence each.
    retries : int
        Frames sent again because no valid reply came.
    seconds : float
        Time the upload took, s.
    """

    port: str
    chips: int
    chip_ns: int
    pulses: int
    duration_ns: int
    code_crc32: int
    trust: Trust
    read_back: bool
    firmware: str
    armed: bool
    lease_ms: int | None
    retries: int
    seconds: float
    clock_ppm: float = 0.0
    warnings: tuple[str, ...] = ()
