"""CXP1, the shutter controllers' protocol: frames, requests, link and clock calibration."""
