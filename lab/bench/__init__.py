"""Benchmarks: the paper's tables, tables of published codes, and their reports."""
