"""Bounds over all codes of a problem."""
