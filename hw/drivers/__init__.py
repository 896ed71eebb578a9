"""Drivers: upload of a program to a real controller, with a report of its trust."""

from hw.drivers.report import Trust, UploadReport

__all__ = ["Trust", "UploadReport"]
