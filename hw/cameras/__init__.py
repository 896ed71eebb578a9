"""Cameras: one protocol, and adapters that are loaded when they are named."""
