"""Blur of a photo as a linear operator: PSF, OTF, photo's frame and borders in one object.

Several photos of one scene, each with its PSF, are one operator as well.

Beyond real borders the photo is extended periodically, by a membrane between opposite edges.
"""

from __future__ import annotations

from typing import Literal, TypeVar

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from scipy import fft

from motdiff.psf_frame import in_frame
from motdiff.threads import threads_here
from motdiff.types import ComplexArray, FloatArray

Border = Literal["real", "periodic"]
_Number = TypeVar("_Number", bound=np.generic)
SMALLEST_POWER = 1e-12  # of |H|^2 in a divisor: frequencies that the blur removes stay finite
_SMALLEST_GAP_PX = 16  # a membrane over fewer pixels is a step at the seam, which rings


class Blur:
    """Blur ``A`` of a scene by a PSF, as seen in the frame of a photo.

    The scene lives on a periodic grid, on which A is a product with the OTF; the photo is the
    grid's top left corner. At real borders the grid is larger than the photo by the reach of the
    PSF along each axis, so that no light wraps around into it.

    Parameters
    ----------
    psf : (S, S) or (K, S, S) array_like
        Zero displacement at index ``size // 2``; of K photos of one scene, one for each.
    photo_shape : (H, W)
    border : {"real", "periodic"}
        Whether light came in from outside the frame, or the photo is one period of its scene.
    dtype : {np.float64, np.float32}
        Of images and spectra. Transforms of float32 take half the time and memory; their rounding
        stays below the noise of photos where nothing divides by less than a noise level.

    Attributes
    ----------
    psf : (S', S') or (K, S', S') float ndarray
        The PSF in the smallest odd frame around its zero displacement.
    grid_shape : (H', W')
    H : (H', W' // 2 + 1) or (K, H', W' // 2 + 1) complex ndarray
        OTF on the ``rfft2`` grid.
    power : (H', W' // 2 + 1) float ndarray
        ``|H|^2``, summed over the photos: the spectrum of A^T A without borders.

    Notes
    -----
    For a scene x, a photo y and the discrete Fourier transform F, with P cropping to the frame:
    ``A x = P F^-1 H F x`` and ``A^T y = F^-1 conj(H) F P^T y``. Of K photos ``A x`` is all of
    them, and ``A^T y`` the sum of what each gives.

    Examples
    --------
    >>> blur = Blur(np.full((1, 3), 1 / 3), (3, 4), "periodic")
    >>> point = np.eye(1, 4) * [[1.0], [0.0], [0.0]]
    >>> (3 * blur.A(point)).round().astype(int)[0].tolist()
    [1, 1, 0, 1]
    """

    def __init__(
        self,
        psf: ArrayLike,
        photo_shape: tuple[int, ...],
        border: Border = "real",
        *,
        dtype: DTypeLike = np.float64,
    ) -> None:
        self.dtype = dtype
        self.psf = trimmed_psfs(psf) if np.ndim(psf) == 3 else trimmed_psf(psf)
        self.photo_shape = photo_shape[0], photo_shape[1]
        self.grid_shape = self.photo_shape
        *photo, rows, columns = np.nonzero(self.psf)
        if border == "real":
            # a straight motion along an axis needs no gap across it
            reaches = (int(np.abs(axis - self.reach_px).max()) for axis in (rows, columns))
            height, width = (2 * reach + 1 for reach in reaches)
            self.grid_shape = extended_shape(self.photo_shape, (height, width))
        wrapped = np.zeros((*self.psf.shape[:-2], *self.grid_shape))
        # np.add.at, since a PSF larger than a periodic photo wraps onto the same pixel twice
        np.add.at(
            wrapped,
            (
                *photo,
                (rows - self.reach_px) % self.grid_shape[0],
                (columns - self.reach_px) % self.grid_shape[1],
            ),
            self.psf[self.psf != 0],
        )
        self.H: ComplexArray = fft.rfft2(wrapped).astype(np.result_type(dtype, np.complex64))
        self.power: FloatArray = self._over_photos(np.abs(self.H) ** 2)

    @property
    def reach_px(self) -> int:
        """Farthest row or column that light travels."""
        return int(self.psf.shape[-1]) // 2

    def A(self, scene: FloatArray) -> FloatArray:
        """Blur a scene (..., H', W') into a photo (..., H, W); (H', W') into K photos."""
        return self.crop(self.image(self.H * self.spectrum(scene)))

    def correlated(self, spectrum: ComplexArray) -> ComplexArray:
        """``conj(H)`` times a spectrum, summed over K photos."""
        return self._over_photos(np.conj(self.H) * spectrum)

    def _over_photos(self, spectra: NDArray[_Number]) -> NDArray[_Number]:
        return np.asarray(spectra.sum(axis=0)) if self.H.ndim == 3 else spectra

    def spectrum(self, image: FloatArray) -> ComplexArray:
        """``rfft2`` on the grid; an image smaller than the grid is padded with zeros."""
        spectrum: ComplexArray = fft.rfft2(
            np.asarray(image, dtype=self.dtype), self.grid_shape, workers=threads_here()
        )
        return spectrum

    def image(self, spectrum: ComplexArray) -> FloatArray:
        """Inverse of :meth:`spectrum`, on the whole grid."""
        image: FloatArray = fft.irfft2(spectrum, self.grid_shape, workers=threads_here())
        return image

    def crop(self, image: FloatArray) -> FloatArray:
        """Part (..., H, W) of an image (..., H', W') that lies in the photo's frame."""
        return image[..., : self.photo_shape[0], : self.photo_shape[1]]

    def extend(
        self, photo: FloatArray, *, noise_to_scene: float = 0.0, rounds: int = 0
    ) -> FloatArray:
        """Extend a photo (H, W) to the grid: by its Wiener restoration, blurred again.

        The scene x minimises ``|A x - y|^2 + noise_to_scene |f X|^2``, X being its spectrum. It is
        found by conjugate gradients, preconditioned with the periodic Wiener filter and started
        from the membrane.

        Parameters
        ----------
        photo : (H, W) or (K, H, W) float
        noise_to_scene : float
            Noise variance over the scene's 1/f^2 constant.
        rounds : int
            Conjugate-gradient steps; 0 leaves the membrane.
        """
        if self.grid_shape == self.photo_shape:
            return photo
        frames = photo.reshape(-1, *self.photo_shape)
        extended = np.stack([membrane_extension(frame, self.grid_shape) for frame in frames])
        extended = extended.reshape(*photo.shape[:-2], *self.grid_shape)
        if rounds <= 0:
            return extended
        penalty = (noise_to_scene * power_law(self.grid_shape)).astype(self.dtype)
        start = self.correlated(self.spectrum(extended))
        start /= np.maximum(self.power + penalty, SMALLEST_POWER)
        data = self.correlated(self.spectrum(photo))
        extended = self.image(self.H * self._least_squares(data, penalty, start, rounds))
        # the measured pixels stay: only the surroundings are the model's
        self.crop(extended)[:] = photo
        return extended

    def nearest(
        self, photo: FloatArray, z: FloatArray, a: float, *, rounds: int, tolerance: float = 0.0
    ) -> FloatArray:
        """Scene x of least ``|A x - y|^2 + a |x - z|^2``, the proximal step of the data.

        On a periodic grid in closed form. At real borders by conjugate gradients, started from
        the x that is right if z is right outside the frame.

        Parameters
        ----------
        photo : (H, W) or (K, H, W) float
        z : (H', W') float
        a : float
        rounds : int
            Conjugate-gradient steps at most.
        tolerance : float
            Of the mean of ``|A e|^2 + a |e|^2`` over the grid, e being the error of x.
        """
        Z = self.spectrum(z)
        periodic = self.grid_shape == self.photo_shape
        guess = photo
        if not periodic:
            guess = self.image(self.H * Z)
            self.crop(guess)[:] = photo
        X = self.correlated(self.spectrum(guess)) + a * Z
        X /= np.maximum(self.power + a, SMALLEST_POWER)
        if not periodic:
            data = self.correlated(self.spectrum(photo)) + a * Z
            penalty = np.full(self.power.shape, a, self.dtype)
            X = self._least_squares(data, penalty, X, rounds, tolerance)
        return self.image(X)

    def _least_squares(
        self,
        data: ComplexArray,
        penalty: FloatArray,
        X: ComplexArray,
        rounds: int,
        tolerance: float = 0.0,
    ) -> ComplexArray:
        """Solve ``(A^T A + penalty) x = data`` by conjugate gradients from X, all as spectra.

        They are preconditioned as if the grid were the frame.
        """
        preconditioner = 1 / np.maximum(self.power + penalty, SMALLEST_POWER)

        def normal_equations(X: ComplexArray) -> ComplexArray:
            photo = self.crop(self.image(self.H * X))
            return self.correlated(self.spectrum(photo)) + penalty * X

        # each column of half a real image's spectrum stands for two, but that of f = 0, and of the
        # Nyquist frequency where there is one
        single = [0] if self.grid_shape[1] % 2 else [0, -1]

        def dot(a: ComplexArray, b: ComplexArray) -> float:
            return float(2 * np.vdot(a, b).real - np.vdot(a[:, single], b[:, single]).real)

        residual = data - normal_equations(X)
        direction = preconditioner * residual
        energy = dot(residual, direction)
        # the sum of a spectrum's squares is the image's times their number
        enough = tolerance * float(np.prod(self.grid_shape)) ** 2
        for _ in range(rounds):
            if energy <= enough:
                break
            product = normal_equations(direction)
            curvature = dot(direction, product)
            if curvature <= 0:  # rounding, as A^T A + penalty is positive
                break
            X = X + (energy / curvature) * direction
            residual = residual - (energy / curvature) * product
            preconditioned = preconditioner * residual
            previous = energy
            energy = dot(residual, preconditioned)
            direction = preconditioned + (energy / previous) * direction
        return X


def normalised(photo: ArrayLike, psf: ArrayLike) -> tuple[FloatArray, FloatArray, float]:
    """Channels (C, H, W) and PSF, both over the PSF's sum, and that sum.

    A prior's weight then means the same for a dark coded photo as for a bright one.
    """
    kernel = trimmed_psf(psf)
    duty = float(kernel.sum())
    return channels_first(photo) / duty, kernel / duty, duty


def channels_first(photo: ArrayLike) -> FloatArray:
    """Return the photo, checked, as (C, H, W) float64, C = 1 or 3.

    Raises
    ------
    ValueError
        If the photo is not (H, W) or (H, W, 3), smaller than 3 x 3, or holds NaN or infinity.
    """
    image = np.asarray(photo, dtype=np.float64)
    if image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
        raise ValueError(f"photo: must be (H, W) or (H, W, 3), got shape {image.shape}")
    if min(image.shape[:2]) < 3:
        raise ValueError(
            f"photo: must be at least 3 x 3 px, got {image.shape[1]} x {image.shape[0]}"
        )
    if not np.isfinite(image).all():
        raise ValueError("photo: must be finite, found NaN or infinity")
    return image[None] if image.ndim == 2 else np.ascontiguousarray(np.moveaxis(image, 2, 0))


def channels_last(image: FloatArray) -> FloatArray:
    """(C, H, W) back to (H, W) or (H, W, 3)."""
    return image[0] if image.shape[0] == 1 else np.ascontiguousarray(np.moveaxis(image, 0, 2))


def trimmed_psf(psf: ArrayLike) -> FloatArray:
    """Return the PSF, checked, in the smallest odd square frame around its zero displacement.

    Raises
    ------
    ValueError
        If it is not two-dimensional, not finite, negative somewhere, or dark.
    """
    kernel = np.asarray(psf, dtype=np.float64)
    if kernel.ndim != 2:
        raise ValueError(f"psf: must be (S, S), got shape {kernel.shape}")
    trimmed: FloatArray = trimmed_psfs(kernel[None])[0]
    return trimmed


def trimmed_psfs(psfs: ArrayLike) -> FloatArray:
    """PSFs (K, S, S), checked as by :func:`trimmed_psf`, in the smallest frame for all of them."""
    kernels = np.asarray(psfs, dtype=np.float64)
    if (
        kernels.size == 0
        or not np.isfinite(kernels).all()
        or kernels.min() < 0
        or not kernels.any(axis=(-2, -1)).all()
    ):
        raise ValueError(
            "psf: must be a finite, non-negative (S, S) array with some light, got shape"
            f" {kernels.shape[1:]}"
        )
    _, rows, columns = np.nonzero(kernels)
    centre = (kernels.shape[1] // 2, kernels.shape[2] // 2)
    reach = int(max(np.abs(rows - centre[0]).max(), np.abs(columns - centre[1]).max()))
    return in_frame(kernels, 2 * reach + 1)


def frequencies(shape: tuple[int, ...]) -> tuple[FloatArray, FloatArray]:
    """Frequencies fy (H, 1) and fx (1, W // 2 + 1) of the ``rfft2`` grid of ``shape``, cy/px."""
    fy: FloatArray = np.fft.fftfreq(shape[0])[:, None].astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(shape[1])[None, :].astype(np.float64)
    return fy, fx


def gradient_power(shape: tuple[int, int]) -> FloatArray:
    """``|Dx|^2 + |Dy|^2`` of periodic forward differences on the ``rfft2`` grid of ``shape``."""
    fy, fx = frequencies(shape)
    return np.asarray(4 * np.sin(np.pi * fy) ** 2 + 4 * np.sin(np.pi * fx) ** 2, dtype=np.float64)


def power_law(shape: tuple[int, int]) -> FloatArray:
    """Squared frequency f^2, (cy/px)^2, on the ``rfft2`` grid: a 1/f^2 scene's inverse power."""
    fy, fx = frequencies(shape)
    return np.asarray(fy**2 + fx**2, dtype=np.float64)


def extended_shape(shape: tuple[int, int], psf_shape: tuple[int, int]) -> tuple[int, int]:
    """FFT-friendly size, with a gap of at least the PSF's reach on both sides of the photo."""
    rows, columns = (
        int(fft.next_fast_len(side + max(psf_side - 1, _SMALLEST_GAP_PX), real=True))
        for side, psf_side in zip(shape, psf_shape, strict=True)
    )
    return rows, columns


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
