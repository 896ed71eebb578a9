"""Proofs about codes: certified minima, their independent check, and audits of any code."""
