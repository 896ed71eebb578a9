"""Recordings of shutters by logic analysers, and their comparison with the program."""
