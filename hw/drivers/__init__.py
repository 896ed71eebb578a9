"""Drivers: a program onto a real controller, and what is then known about it."""

from hw.drivers.report import Trust, UploadReport

__all__ = ["Trust", "UploadReport"]
