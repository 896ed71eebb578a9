"""Light through a coded shutter along a motion: code, exposure, band, MTF, shutter, camera."""
