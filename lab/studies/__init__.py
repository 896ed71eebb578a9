"""Measurements of speed and quality, a script each; README.md lists them with their records."""
