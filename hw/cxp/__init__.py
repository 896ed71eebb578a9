"""CXP1, the protocol of the shutter controllers: frames, requests, programs in ticks, link, and
clock calibration.
"""
