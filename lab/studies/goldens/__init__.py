"""Goldens: what every command prints and writes, recorded and compared."""
