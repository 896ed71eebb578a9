"""Independent verification of certificates: no code is shared with their making."""
