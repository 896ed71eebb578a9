"""Restoration of blurred and coded photos: inverse, Wiener, TV, L0, a denoiser; real borders; the direction test."""

from cep.restore.direction import DirectionResult, compare_psfs, test_directions
from cep.restore.inverse import inverse_filter
from cep.restore.l0 import l0, tv_less_ringing
from cep.restore.methods import METHODS, Restoration, misfit, restore, saturated
from cep.restore.pnp import pnp
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
    "pnp",
    "restore",
    "saturated",
    "test_directions",
    "tv",
    "tv_less_ringing",
    "wiener",
]
