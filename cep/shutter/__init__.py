"""A code on a shutter controller: played, and read back."""
