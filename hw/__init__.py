"""Shutter hardware: timed programs, device limits, exporters and the serial protocol."""
