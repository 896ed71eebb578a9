"""Figures: each function returns a matplotlib Figure, without pyplot, global state or windows."""
