"""Emulated controllers that run the real firmware."""
