"""Published shutter codes, and codes by their bits, file or name."""
