"""Pareto fronts of codes in minimum, noise and light."""
