"""Drivers: upload of a program to a real controller, with a report of its trust."""

from collections.abc import Mapping
from types import MappingProxyType

from hw.drivers.cxp import Controller
from hw.drivers.driver import Driver, Trust, UploadReport
from hw.drivers.pulse_pal import PulsePal
from hw.drivers.scpi import ScpiAwg

__all__ = ["DRIVERS", "Driver", "Trust", "UploadReport"]

# pyserial and pyvisa are imported when a port is opened: this table costs no start-up time.
DRIVERS: Mapping[str, type[Driver]] = MappingProxyType(
    {"cxp": Controller, "pulse-pal": PulsePal, "scpi": ScpiAwg}
)
"""Driver name to its class: our firmware, a Pulse Pal, a waveform generator with SCPI."""
