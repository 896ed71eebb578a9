"""Restoration of one scene from several photos of one motion, each through its own code.

Two cameras behind a beam splitter, or side by side before a far scene, whose shutters play
complementary codes during one exposure, see one motion, which need not repeat. The photos show its
order in time, and together they keep the frequencies that each of them loses.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike
from scipy import fft, ndimage, signal

from cep.optics.camera import Camera
from cep.optics.code import ShutterCode
from cep.optics.exposure import shifted_psf
from cep.restoration.blur import channels_first, trimmed_psfs
from cep.restoration.choice import LARGEST_PNP_PX
from cep.restoration.clipping import clipped_warnings, fill_clipped
from cep.restoration.direction import DIRECTIONS, LARGEST_CROP_PX, Direction, orders_in_time
from cep.restoration.plug_and_play import pnp_together
from cep.restoration.result import Restoration, misfit
from motdiff.crops import centre_crop
from motdiff.photo_noise import LEAST_SIGMA, noise_sigma
from motdiff.photo_values import clipped_mask, luminance
from motdiff.psf_frame import in_frame
from motdiff.trajectory import Trajectory
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from motdiff.estimators.base import MotionEstimate

_ESTIMATE_SHARE = 0.8  # of the time, where the motion is not given
_DOUBTFUL = 0.5  # probability of the path
_ALIKE = 1.05  # ratio of two orders' misfits: so near, the photos tell neither
# misfit beyond the noise, over the contrast: 0.1 along a path that is half a pixel off, 0.4 and
# more through a wrong code or in the reverse order
_UNEXPLAINED = 0.2
_LEAST_OVERLAP_PX = 32  # of the photos without the reach of their blur
_FARTHEST = 0.25  # shift, of that overlap: farther off, photos hardly show one scene
_MOST_STEPS = 12  # of the registration, which takes three or four
_LONGEST_STEP_PX = 8.0  # from the peak of the correlation, which is a pixel off or two
_STILL_PX = 1e-3
_INSIDE = 0.1  # of the window, below which a pixel is border
_FLAT = 1e-12  # variance of an image that shows nothing


def restore_together(
    photos: Sequence[ArrayLike],
    codes: Sequence[ShutterCode],
    trajectory: Trajectory | None = None,
    *,
    cameras: Sequence[Camera | None] | None = None,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
) -> Restoration:
    """Restore one scene from photos of one motion, each taken through its own code.

    Photos may be shifted by some px and differ in brightness. Without a trajectory it is estimated
    from them, with its order in time
    (:class:`motdiff.estimators.coded.estimator.CodedEstimator`).

    Parameters
    ----------
    photos : sequence of K (H, W) or (H, W, 3) array_like, linear light 0..1, K >= 2
    codes : sequence of K ShutterCode
        Of one duration.
    trajectory : Trajectory, optional
        Of an unknown direction, the order in time is that which leaves least between the photos.
    cameras : sequence of K Camera or None, optional
        Of each photo: gives its noise, which is estimated in the photo where it is None.
    seed : int
        Of the search of the motion.
    progress : callable, optional
        Called with the finished share 0..1 and what is being done.

    Returns
    -------
    Restoration
        At the place and brightness of the first photo; its ``psf`` is that photo's.

    Raises
    ------
    ValueError
        If photos and codes do not fit each other, a photo cannot be searched, the motion does not
        fit into the photos, or they lie too far apart to show one scene.

    References
    ----------
    Agrawal, Xu and Raskar, "Invertible motion blur in video", SIGGRAPH 2009: exposures whose joint
    transform has no null, restored together.

    Examples
    --------
    >>> from cep.optics.capture import capture
    >>> rng = np.random.default_rng(0)
    >>> scene = np.kron(rng.random((12, 12)), np.ones((8, 8)))
    >>> path = Trajectory.from_samples([[0, 0], [8, 1], [12, 9]], direction="known")
    >>> codes = [ShutterCode("1101000101101111"), ShutterCode("1101000101101111").complement()]
    >>> photos = [capture(scene, path, code, rng=rng) for code in codes]
    >>> sharp = restore_together(photos, codes, path)
    >>> sharp.image.shape == photos[0].shape, sharp.method
    (True, 'pnp')
    """
    started = time.perf_counter()
    _check(photos, codes, trajectory)
    confidence: float | None = None
    direction = "known"
    warnings: list[str] = []
    estimated = 0.0
    if trajectory is None:
        estimated = _ESTIMATE_SHARE
        estimate = _estimate(
            photos, codes, seed, lambda share, note: progress(estimated * share, note)
        )
        path = estimate.best
        confidence = estimate.confidence
        warnings += estimate.psf_warnings
        if confidence < _DOUBTFUL:
            warnings.insert(
                0,
                f"the motion found is doubtful (confidence {confidence:.2f}): compare the restored"
                " photo with those taken",
            )
    elif trajectory.direction == "unknown":
        progress(0.0, "finding the order in time")
        path, direction = _order_in_time(photos, codes, trajectory)
        if direction == "undecidable":
            warnings.append("the photos do not tell the order in time of the motion")
    else:
        path = trajectory
    progress(estimated, "aligning the photos")
    light = [
        fill_clipped(photo, shifted_psf(path, code))
        for photo, code in zip(photos, codes, strict=True)
    ]
    psfs, apart = registered_psfs(light, path, codes)
    warnings += _doubts(photos, apart)
    image = pnp_together(
        light,
        list(psfs),
        cameras=cameras,
        progress=lambda share: progress(estimated + (1 - estimated) * share, "restoring"),
    )
    residuals = [misfit(photo, image, psf) for photo, psf in zip(photos, psfs, strict=True)]
    return Restoration(
        image=image,
        method="pnp",
        psf=psfs[0],
        psf_source="photo" if trajectory is None else "trajectory",
        psf_confidence=confidence,
        direction=direction,
        trajectory=Trajectory(path.t, path.xy, direction="known"),
        residual=float(np.sqrt(np.mean(np.square(residuals)))),
        unreliable_px=trimmed_psfs(psfs).shape[-1] // 2,
        saturated_fraction=_clipped_share(photos),
        warnings=tuple(warnings),
        seconds=time.perf_counter() - started,
    )


def _check(
    photos: Sequence[ArrayLike], codes: Sequence[ShutterCode], trajectory: Trajectory | None
) -> None:
    """Refuse photos of several sizes, and codes that do not fit them."""
    from motdiff.estimators.coded.codes import check_codes

    tell_order = trajectory is None or trajectory.direction == "unknown"
    check_codes([code.bits for code in codes], photos=len(photos), tell_order=tell_order)
    if len(photos) < 2:
        raise ValueError("photos: need at least two; restore() takes a single one")
    images = [channels_first(photo) for photo in photos]
    for i, image in enumerate(images[1:], 2):
        if image.shape != images[0].shape:
            first_size, size = (
                f"{w} x {h} px in {'colour' if colours > 1 else 'grey'}"
                for colours, h, w in (images[0].shape, image.shape)
            )
            raise ValueError(f"photo {i}: has {size}, the first one {first_size}")
    if images[0][0].size > LARGEST_PNP_PX:
        raise ValueError(
            f"photos: at most {LARGEST_PNP_PX / 1e6:g} megapixels are restored together; crop them"
        )


def _estimate(
    photos: Sequence[ArrayLike],
    codes: Sequence[ShutterCode],
    seed: int,
    progress: Callable[[float, str], None],
) -> MotionEstimate:
    """Estimate the motion, with its order in time, from the photos."""
    progress(0.02, "loading torch")  # some seconds
    from motdiff.estimators.coded.estimator import CodedEstimator

    estimator = CodedEstimator(
        [code.bits for code in codes],
        seed=seed,
        progress=lambda share: progress(0.05 + 0.95 * share, "searching the motion"),
    )
    return estimator.estimate_from(photos)


def _order_in_time(
    photos: Sequence[ArrayLike], codes: Sequence[ShutterCode], trajectory: Trajectory
) -> tuple[Trajectory, Direction]:
    """Path in the order in time that leaves least between the photos, and how it was run."""
    paths = orders_in_time(trajectory)
    crops = [centre_crop(luminance(photo), LARGEST_CROP_PX, LARGEST_CROP_PX) for photo in photos]
    misfits = []
    refusals = []
    for path in paths:
        try:
            misfits.append(registered_psfs(crops, path, codes)[1])
        except ValueError as error:  # a wrong order may lay the photos far from each other
            misfits.append(np.inf)
            refusals.append(error)
    if len(refusals) == len(paths):
        raise refusals[0]
    best, second = np.argsort(misfits)[:2]
    if misfits[second] < _ALIKE * misfits[best]:
        return paths[best], "undecidable"
    return paths[best], DIRECTIONS[min(best, 2)]


def _clipped_share(photos: Sequence[ArrayLike]) -> float:
    return float(np.mean([clipped_mask(photo).mean() for photo in photos]))


def _doubts(photos: Sequence[ArrayLike], apart: float) -> list[str]:
    """Warn of what a photo alone would be warned of, and where the photos do not fit together."""
    doubts = []
    greys = [luminance(photo) for photo in photos]
    noise = float(np.mean([max(noise_sigma(grey), LEAST_SIGMA) for grey in greys]))
    unexplained = max(apart**2 - noise**2, 0.0) ** 0.5
    if unexplained > _UNEXPLAINED * greys[0].std():
        doubts.append(
            "the photos do not fit together along this motion: do they show one scene and one"
            " motion, and are the codes given in the order of the photos?"
        )
    return [*doubts, *clipped_warnings(_clipped_share(photos))]


def registered_psfs(
    photos: Sequence[ArrayLike], trajectory: Trajectory, codes: Sequence[ShutterCode]
) -> tuple[FloatArray, float]:
    """Draw the PSF of each photo, moved and scaled as its photo is against the first.

    The first photo blurred by the PSF of another is that photo blurred by the PSF of the first,
    but for a shift and a factor.

    Parameters
    ----------
    photos : sequence of K (H, W) or (H, W, 3) array_like, linear light
    trajectory : Trajectory
    codes : sequence of K ShutterCode

    Returns
    -------
    psfs : (K, S, S) float
        Light-true beside the first, zero displacement at index ``S // 2``.
    apart : float
        Rms of what one photo blurred by another's PSF and the other blurred by the first's leave
        between them, over the norm of both PSFs: about the noise, where the path is right.

    References
    ----------
    Lucas and Kanade, "An iterative image registration technique", IJCAI 1981.
    """
    greys = [luminance(photo) for photo in photos]
    psfs = [shifted_psf(trajectory, codes[0])]
    squares = []
    for i, (grey, code) in enumerate(zip(greys[1:], codes[1:], strict=True), 2):
        psf = shifted_psf(trajectory, code)
        frame = max(len(psf), len(psfs[0]))
        overlap_px = min(grey.shape) - frame + 1
        if overlap_px < _LEAST_OVERLAP_PX:
            raise ValueError(
                f"trajectory: the motion spans {frame} px around its zero, the photos are only"
                f" {min(grey.shape)} px on their shorter side"
            )
        shift_px, gain, rms = shift_and_gain(
            _blurred(greys[0], in_frame(psf, frame)), _blurred(grey, in_frame(psfs[0], frame))
        )
        if not max(map(abs, shift_px)) < _FARTHEST * overlap_px or gain <= 0:
            raise ValueError(
                f"photo {i}: does not show the scene of the first one where this motion leaves it;"
                " give photos of one scene, and their codes in the same order"
            )
        psfs.append(gain * shifted_psf(trajectory, code, shift_px))
        squares.append(rms**2 / (np.sum(psfs[0] ** 2) + np.sum(psfs[-1] ** 2)))
    frame = max(map(len, psfs))
    stacked = np.stack([in_frame(psf, frame) for psf in psfs])
    return stacked, float(np.sqrt(np.mean(squares)))


def _blurred(photo: FloatArray, psf: FloatArray) -> FloatArray:
    """Blur a photo where no light comes from beyond its border."""
    return np.asarray(signal.fftconvolve(photo, psf, mode="valid"), dtype=np.float64)


def shift_and_gain(a: FloatArray, b: FloatArray) -> tuple[tuple[float, float], float, float]:
    """Shift (right, down), px, and factor that make an image ``a`` (H, W) into ``b``.

    Returns
    -------
    shift, factor, and rms of what they leave
    """
    window = np.outer(*(np.hanning(side + 2)[1:-1] for side in a.shape))
    cross = fft.irfft2(
        fft.rfft2(window * (b - b.mean())) * np.conj(fft.rfft2(window * (a - a.mean()))), a.shape
    )
    peak = np.unravel_index(int(cross.argmax()), cross.shape)
    down_right = np.array(
        [(i + n // 2) % n - n // 2 for i, n in zip(peak, cross.shape, strict=True)], np.float64
    )
    is_inside = window > _INSIDE
    gain = float(b.sum() / a.sum()) if a.sum() > 0 else 1.0

    def remainder(shift: FloatArray, gain: float) -> tuple[FloatArray, float]:
        a_there: FloatArray = ndimage.shift(a, shift, mode="nearest")
        return a_there, float(np.sqrt(np.mean((b - gain * a_there)[is_inside] ** 2)))

    a_there, rms = remainder(down_right, gain)
    for _ in range(_MOST_STEPS):
        if min(a.var(), b.var()) < _FLAT:
            break
        slopes = [-gain * np.gradient(a_there, axis=axis)[is_inside] for axis in (0, 1)]
        design = np.stack([a_there[is_inside], *slopes], axis=1)
        new_gain, *step = np.linalg.lstsq(design, b[is_inside], rcond=None)[0].tolist()
        if np.hypot(*step) > _LONGEST_STEP_PX:  # beyond the range of the linear model
            break
        a_next, new_rms = remainder(down_right + step, new_gain)
        if not new_rms < rms:
            break
        down_right = down_right + step
        a_there, rms, gain = a_next, new_rms, new_gain
        if np.hypot(*step) < _STILL_PX:
            break
    return (float(down_right[1]), float(down_right[0])), gain, rms
