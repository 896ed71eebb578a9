"""Table of code designs on the same photos, motions, light levels and restoration."""
