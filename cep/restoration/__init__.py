"""Restoration of blurred photos: inverse, Wiener, TV, L0, a denoiser; borders, clipping; blind
PSFs; orders in time.
"""

from cep.restoration.blind import FoundPsf, find_psf
from cep.restoration.clipping import fill_clipped
from cep.restoration.direction import DirectionResult, compare_psfs, detect_direction
from cep.restoration.inverse import inverse_filter
from cep.restoration.l0 import l0, tv_less_ringing
from cep.restoration.methods import METHODS, Restoration, find_method, misfit, restore
from cep.restoration.pnp import pnp
from cep.restoration.tv import tv
from cep.restoration.wiener import wiener

__all__ = [
    "METHODS",
    "DirectionResult",
    "FoundPsf",
    "Restoration",
    "compare_psfs",
    "detect_direction",
    "fill_clipped",
    "find_method",
    "find_psf",
    "inverse_filter",
    "l0",
    "misfit",
    "pnp",
    "restore",
    "tv",
    "tv_less_ringing",
    "wiener",
]
