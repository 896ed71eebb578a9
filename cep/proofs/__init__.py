"""Figures of codes and their proofs: measure, certify, verify (which shares no code), audit."""
