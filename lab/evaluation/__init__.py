"""Measuring estimators on data sets: simulated shakes and Levin's photos, floors and ceilings,
tables and pictures.
"""
