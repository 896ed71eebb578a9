"""Light through a coded shutter along a motion: codes, exposure, bands of frequency, MTF, shutter
response, cameras.
"""
