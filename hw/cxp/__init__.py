"""CXP1, our shutter controllers' protocol: frames, requests, programs in ticks, the link, and the clock behind it."""
