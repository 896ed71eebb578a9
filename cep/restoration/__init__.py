"""Restoration of blurred photos, one file a method, on one operator for the blur."""
