"""Smallest |H| over a continuum of frequencies: bounds, exact zeros, certificates."""
