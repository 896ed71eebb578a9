"""Codes that no other beats in minimum, noise and light at once."""
