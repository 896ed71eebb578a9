"""Codes of others, and what a code is compared with."""
