"""Measurements of speed and quality, one script each."""
