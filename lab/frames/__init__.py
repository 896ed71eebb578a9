"""Codes of several exposures of one scene that complement each other."""
