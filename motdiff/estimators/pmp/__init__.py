"""Blind estimation with the patch-wise minimal pixels prior (PMP)."""
