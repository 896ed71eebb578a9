"""Annealing chains, tabu walks and sweeps on compiled loops."""
