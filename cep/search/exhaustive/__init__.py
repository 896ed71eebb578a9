"""Exhaustive search with a proof of optimality."""
