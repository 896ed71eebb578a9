"""Restoration of blurred and coded photos: inverse, Wiener, TV and L0, with real borders, and the direction test."""

from cep.restore.direction import DirectionResult, compare_psfs, test_directions
from cep.restore.inverse import inverse_filter
from cep.restore.l0 import l0, tv_less_ringing
from cep.restore.methods import METHODS, Restoration, misfit, restore, saturated
from cep.restore.tv import tv
from cep.restore.wiener import wiener

__all__ = [
    "METHODS",
    "DirectionResult",
    "Restoration",
    "compare_psfs",
    "inverse_filter",
    "l0",
    "misfit",
    "restore",
    "saturated",
    "test_directions",
    "tv",
    "tv_less_ringing",
    "wiener",
]
