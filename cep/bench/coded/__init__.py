"""The coded-exposure table: every way to choose a code, on the same photos, motions, light and restoration."""
