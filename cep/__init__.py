"""Coded exposure: shutter codes, their MTF along a trajectory, search, restoration and reports."""
