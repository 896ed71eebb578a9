"""Firmware of shutter controllers: sources and builds."""
