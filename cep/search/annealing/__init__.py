"""Annealing chains and tabu walks on compiled loops."""
