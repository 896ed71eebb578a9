"""Real borders of a photo for FFT methods: periodic extension before a restoration.

The gap between opposite edges is first filled with a membrane (Laplace's equation, as in Liu and
Jia), then with the photo of the most likely scene, given the pixels of the photo.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy import fft

from cep.restoration.spectral import otf_on_grid, power_law
from motdiff.types import ComplexArray, FloatArray

Border = Literal["real", "periodic"]
_SMALLEST_GAP_PX = 16
_SMALLEST_POWER = 1e-12


def extended_shape(shape: tuple[int, int], psf_size: int) -> tuple[int, int]:
    """FFT-friendly size that leaves a gap of at least the PSF's reach on both sides of the
    photo.
    """
    gap = max(psf_size - 1, _SMALLEST_GAP_PX)
    rows, columns = (int(fft.next_fast_len(side + gap, real=True)) for side in shape)
    return rows, columns


def working_shape(shape: tuple[int, int], psf_size: int, border: Border) -> tuple[int, int]:
    """Size to restore a photo at: its own when it is periodic, else with room to join its real
    borders.
    """
    return shape if border == "periodic" else extended_shape(shape, psf_size)


def membrane_extension(image: FloatArray, shape: tuple[int, int]) -> FloatArray:
    """Extend ``image`` to ``shape`` by a membrane that spans from each edge to the opposite one.

    Parameters
    ----------
    image : (H, W) float
    shape : (H', W') at least (H, W)

    Returns
    -------
    (H', W') float ndarray
        ``image`` at the top left; below and to the right of it, values that join up periodically.

    References
    ----------
    Liu and Jia, "Reducing boundary artifacts in image deconvolution", ICIP 2008: the three tiles;
    here each one is harmonic (solved with the DST).
    """
    height, width = image.shape
    rows = shape[0] - height
    columns = shape[1] - width
    out = np.empty(shape)
    out[:height, :width] = image
    below = _tile(image[-1], image[0], rows)  # (rows + 2, W), with the photo's own edge rows
    right = _tile(image[:, -1], image[:, 0], columns).T  # (H, columns + 2)
    out[height:, :width] = below[1:-1]
    out[:height, width:] = right[:, 1:-1]
    if rows and columns:
        corner = np.zeros((rows + 2, columns + 2))
        corner[0], corner[-1] = right[-1], right[0]
        corner[:, 0], corner[:, -1] = below[:, -1], below[:, 0]
        out[height:, width:] = _harmonic(corner)[1:-1, 1:-1]
    return out


def reblurred_extension(
    image: FloatArray,
    psf: FloatArray,
    shape: tuple[int, int],
    *,
    noise_to_scene: float,
    rounds: int,
) -> FloatArray:
    """Extend ``image`` by its Wiener restoration, blurred again.

    The scene minimises ``|M (K x - y)|^2 + noise_to_scene |f X|^2``, M being 1 on the photo; it is
    found by conjugate gradients, preconditioned with the periodic Wiener filter and started from
    the membrane.

    Parameters
    ----------
    image : (H, W) float
    psf : (S, S) float, S odd, light-true
    shape : (H', W')
    noise_to_scene : float
        Noise variance over the scene's 1/f^2 constant.
    rounds : int
        Conjugate-gradient steps; 0 leaves the membrane.
    """
    extended = membrane_extension(image, shape)
    if rounds <= 0:
        return extended
    transfer = otf_on_grid(psf, shape)
    penalty = noise_to_scene * power_law(shape)
    inverse = 1 / np.maximum(np.abs(transfer) ** 2 + penalty, _SMALLEST_POWER)
    seen = (slice(0, image.shape[0]), slice(0, image.shape[1]))
    # inner products of real images from half their spectra
    weight = np.full(transfer.shape[1], 2.0)
    weight[0] = 1.0
    if shape[1] % 2 == 0:
        weight[-1] = 1.0

    def normal_equations(spectrum: ComplexArray) -> ComplexArray:
        blurred = np.zeros(shape)
        blurred[seen] = fft.irfft2(transfer * spectrum, shape)[seen]
        return np.asarray(
            np.conj(transfer) * fft.rfft2(blurred) + penalty * spectrum, dtype=np.complex128
        )

    def dot(a: ComplexArray, b: ComplexArray) -> float:
        return float(((a.real * b.real + a.imag * b.imag) * weight).sum())

    masked = np.zeros(shape)
    masked[seen] = image
    scene = inverse * np.conj(transfer) * fft.rfft2(extended)
    residual = np.conj(transfer) * fft.rfft2(masked) - normal_equations(scene)
    direction = inverse * residual
    energy = dot(residual, direction)
    for _ in range(rounds):
        if energy <= 0:
            break
        product = normal_equations(direction)
        curvature = dot(direction, product)
        if curvature <= 0:
            break
        scene = scene + (energy / curvature) * direction
        residual = residual - (energy / curvature) * product
        preconditioned = inverse * residual
        previous = energy
        energy = dot(residual, preconditioned)
        direction = preconditioned + (energy / previous) * direction
    extended = np.asarray(fft.irfft2(transfer * scene, shape), dtype=np.float64)
    extended[seen] = image
    return extended


def _tile(first: FloatArray, last: FloatArray, gap: int) -> FloatArray:
    """Harmonic strip (gap + 2, N) from row ``first`` to row ``last``, its two sides linear."""
    strip = np.zeros((gap + 2, first.size))
    strip[0], strip[-1] = first, last
    ramp = np.linspace(0, 1, gap + 2)
    for column in (0, -1):
        strip[:, column] = (1 - ramp) * first[column] + ramp * last[column]
    return _harmonic(strip)


def _harmonic(tile: FloatArray) -> FloatArray:
    """Solve the 5-point Laplace equation inside ``tile`` for the values on its frame."""
    rows = tile.shape[0] - 2
    columns = tile.shape[1] - 2
    if rows < 1 or columns < 1:
        return tile
    source = np.zeros((rows, columns))
    source[0] += tile[0, 1:-1]
    source[-1] += tile[-1, 1:-1]
    source[:, 0] += tile[1:-1, 0]
    source[:, -1] += tile[1:-1, -1]
    spectrum = fft.dstn(source, type=1)
    k = np.arange(1, rows + 1)[:, None]
    m = np.arange(1, columns + 1)[None, :]
    eigenvalues = 4 - 2 * np.cos(np.pi * k / (rows + 1)) - 2 * np.cos(np.pi * m / (columns + 1))
    solved = tile.copy()
    solved[1:-1, 1:-1] = fft.idstn(spectrum / eigenvalues, type=1)
    return solved
