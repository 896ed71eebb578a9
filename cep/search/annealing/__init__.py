"""Annealing chains and sweeps on compiled loops."""
