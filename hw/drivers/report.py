"""What is known after a program was handed over: the report of an upload, and how far it can be trusted."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Trust", "UploadReport"]


class Trust(StrEnum):
    """How far a shutter is known to hold the program; no level says that it was played with the right timing."""

    READ_BACK = "read back"
    """The device sent its stored program back and it is identical."""
    ACKNOWLEDGED = "acknowledged"
    """The device said that it took the program."""
    FILE_ONLY = "file only"
    """A file was written; no device was involved."""


@dataclass(frozen=True, slots=True)
class UploadReport:
    """Outcome of an upload that succeeded.

    Parameters
    ----------
    port : str
        Port of the device.
    chips, chip_ns, pulses, duration_ns, code_crc32 : int
        The program, as `hw.program.Program` names it.
    trust : Trust
        What the upload proves.
    armed : bool
        Whether the device now waits for a trigger.
    lease_ms : int or None
        After how long without a trigger an armed device disarms itself.
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
    armed: bool
    lease_ms: int | None
    retries: int
    seconds: float
