"""Gains of codes as photographs show them, beside those that the program promises."""
