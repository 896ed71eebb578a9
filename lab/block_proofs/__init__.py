"""Proofs in blocks of the largest minimum of |P|, kept in files and checked by separate code."""
