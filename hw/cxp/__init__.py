"""CXP1, the shutter controllers' protocol: frames, requests, and a link to a controller."""
