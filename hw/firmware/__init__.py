"""Firmware of shutter controllers: sources, and what is built from them."""
