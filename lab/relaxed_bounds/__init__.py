"""Tighter bounds over all codes, by a semidefinite relaxation of the search, and their check."""
