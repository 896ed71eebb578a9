"""Photographs of free licence, on which the gain of a way to expose is measured."""
