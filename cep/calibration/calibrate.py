"""From a photo to a motion on disk: the choice of an estimator, and the files of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from importlib import import_module
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cep.files.files import write_psf
from cep.files.images import write_image
from cep.files.outputs import new_folder
from cep.optics.code import ShutterCode
from cep.plots import png_bytes, save, trajectory_figure
from cep.restoration.sharpen import sharpen
from motdiff.crops import LEAST_PX, check_size
from motdiff.estimators.base import Estimator, MotionEstimate, load_estimator
from motdiff.estimators.coded.codes import check_codes
from motdiff.estimators.from_kernel import as_estimate
from motdiff.files.plugins import is_reference
from motdiff.files.trajectories import StoredMotion, write_motion
from motdiff.gyro import GyroTrace
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

METHODS = ("motdiff", "pmp", "reference", "point", "gyro", "coded")
"""Names of the estimators: blind by diffusion model and classically, with a sharp photo, of a
light, by gyroscope, from photos taken through known codes."""

CALIBRATION_FILES = (
    "trajectory.json",
    "psf.npy",
    "psf.mat",
    "psf.png",
    "map.png",
    "preview.png",
    "sharpened.png",
)
"""What :func:`write_calibration` writes; ``map.png`` only where the path fits the 64-px field,
``sharpened.png`` only of a photo with an open shutter, where a restoration is better than the
photo."""

_TOGETHER = ("motdiff", "pmp")  # search photos of one motion together

_LEAST_PX = {
    "motdiff": PSF_PX,
    "pmp": LEAST_PX,
    "coded": LEAST_PX,
}  # their smallest_px, known before anything slow is loaded
_LEAST_CONTRAST = 2 / 255
_LOADING = {"motdiff": (0.12, 0.28, 0.36), "pmp": (0.12, 0.26, 0.32), "coded": (0.02, 0.05, 0.06)}
"""Of an estimate's share: torch is on its way, is there, and so is the estimator;
docs/decisions/code.md."""
_NEEDED = {
    "reference": {"sharp"},
    "gyro": {"gyro", "focal_px", "start_s", "exposure_s"},
    "coded": {"codes"},
}
_ALLOWED = {"motdiff": {"samples"}, "gyro": {"axes", "rate_unit"}, "point": {"codes"}}


def check_options(method: str, options: Mapping[str, object]) -> None:
    """Check a method's name and options before anything is loaded.

    Parameters
    ----------
    method : str
    options : mapping
        Those of :func:`make_estimator` that differ from method to method, and ``rate_unit``, that
        of the recording for "gyro"; None is not given.

    Raises
    ------
    ValueError
        If the method is not known, or an option it needs is missing or one that is not its own is
        given.
    """
    if method not in METHODS and not is_reference(method):
        raise ValueError(
            f"method: must be one of {', '.join(METHODS)}, or module:name, got {method!r}"
        )
    given = {name for name, value in options.items() if value is not None}
    wanted = _NEEDED.get(method, set())
    for name in sorted(wanted - given):
        raise ValueError(f"{name}: needed with method={method!r}")
    for name in sorted(given - wanted - _ALLOWED.get(method, set())):
        raise ValueError(f"{name}: not valid with method={method!r}")


def make_estimator(
    method: str = "motdiff",
    *,
    samples: int | None = None,
    seed: int = 0,
    sharp: ArrayLike | None = None,
    gyro: GyroTrace | None = None,
    focal_px: float | None = None,
    start_s: float | None = None,
    exposure_s: float | None = None,
    axes: str | None = None,
    codes: Sequence[ShutterCode] | None = None,
    progress: Callable[[float, str], None] = lambda _share, _what: None,
) -> Estimator:
    """Make the estimator of a name.

    Parameters
    ----------
    method : {"motdiff", "pmp", "reference", "point", "gyro", "coded"}, or ``module:name`` of the
    user's own
    samples : int, optional
        For "motdiff": motions drawn.
    seed : int
        Of what is drawn at random.
    sharp : (H, W) or (H, W, 3) array_like, linear light 0..1
        For "reference": a sharp photo of the same scene.
    gyro, focal_px, start_s, exposure_s
        For "gyro": the recording, the focal length in px, and when on the recording's clock the
        shutter was open.
    axes : str, optional
        For "gyro": directions of the recording's axes, as of
        :func:`motdiff.gyro.image_rates_rad_s`; taken as "right,down,forward", with a warning, when
        omitted. A phone held upright has "right,up,back".
    codes : sequence of ShutterCode, optional
        For "coded", and for "point" where the light was photographed through codes: of each photo,
        in order.
    progress : callable, optional
        Called with the finished share 0..1 of loading and estimating, and what is being done, by
        methods that take long.

    Raises
    ------
    ValueError
        If the method is not known, or an option it needs is missing or one that is not its own is
        given.
    """
    check_options(
        method,
        {
            "samples": samples,
            "sharp": sharp,
            "gyro": gyro,
            "focal_px": focal_px,
            "start_s": start_s,
            "exposure_s": exposure_s,
            "axes": axes,
            "codes": codes,
        },
    )
    if is_reference(method):
        return load_estimator(method)
    if method == "reference" and sharp is not None:
        from motdiff.estimators.reference import ReferenceEstimator

        return ReferenceEstimator(sharp)
    if (
        method == "gyro"
        and gyro is not None
        and focal_px is not None
        and start_s is not None
        and exposure_s is not None
    ):
        from motdiff.estimators.gyro import GyroEstimator

        return GyroEstimator(
            gyro, focal_px=focal_px, start_s=start_s, exposure_s=exposure_s, axes=axes
        )
    if method == "point" and codes is None:
        from motdiff.estimators.point import PointEstimator

        return PointEstimator()
    torch_begun, torch_there, loaded = _LOADING["coded" if codes is not None else method]

    def tell(share: float) -> None:
        progress((1 - share) * loaded + share, "searching the motion")

    progress(torch_begun, "loading torch")
    import_module("torch")  # half of what there is to load
    progress(torch_there, "loading the network" if method == "motdiff" else "loading the search")
    made: Estimator
    if method == "coded" and codes is not None:
        from motdiff.estimators.coded.estimator import CodedEstimator

        made = CodedEstimator([code.bits for code in codes], seed=seed, progress=tell)
    elif method == "point" and codes is not None:
        from motdiff.estimators.coded.trail_estimator import TrailEstimator

        made = TrailEstimator([code.bits for code in codes], seed=seed, progress=tell)
    elif method == "pmp":
        from motdiff.estimators.pmp import PmpEstimator

        made = PmpEstimator(progress=tell)
    else:
        from motdiff.estimators.motdiff import MotDiffEstimator

        made = MotDiffEstimator(
            samples=8 if samples is None else samples, seed=seed, progress=tell
        )
    tell(0.0)
    return made


@dataclass(frozen=True)
class Calibration(MotionEstimate):
    """The motion estimated from a photo, with the photo: it shows and saves itself.

    Attributes
    ----------
    photo : (H, W) or (H, W, 3) float, linear light 0..1
        The first one where there are several, of those not left out. The other attributes are
        those of :class:`motdiff.estimators.base.MotionEstimate`.
    """

    photo: FloatArray = field(kw_only=True, repr=False)

    def save(
        self,
        folder: Path | str,
        *,
        source: Mapping[str, object] | None = None,
        force: bool = False,
        bits: int = 8,
        gamma: str | float = "srgb",
    ) -> dict[str, Path]:
        """Write the files of :data:`CALIBRATION_FILES`; see :func:`write_calibration`."""
        return write_calibration(
            folder, self, self.photo, source=source, force=force, bits=bits, gamma=gamma
        )

    def _repr_png_(self) -> bytes:
        return png_bytes(trajectory_figure(self.photo, self.best))

    def __repr__(self) -> str:
        path = self.best
        return (
            f"<Calibration by {self.method}: path of {path.length_px:.1f} px, {path.extent_px:.1f}"
            f" px wide, direction {path.direction}, confidence {self.confidence:.2f}>"
        )


def estimate_motion(
    photo: ArrayLike | Sequence[ArrayLike],
    *,
    method: str | Estimator | None = None,
    samples: int | None = None,
    seed: int = 0,
    sharp: ArrayLike | None = None,
    gyro: GyroTrace | None = None,
    focal_px: float | None = None,
    start_s: float | None = None,
    exposure_s: float | None = None,
    axes: str | None = None,
    codes: Sequence[ShutterCode] | None = None,
    progress: Callable[[float, str], None] = lambda _share, _what: None,
) -> Calibration:
    """Estimate the camera's motion from a blurred photo, or from several photos of one motion.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1; or a list or tuple of arrays
        Several show one motion, of one scene or of different ones: with an open shutter they are
        searched together, for "motdiff", "pmp" and estimators with a method
        ``estimate_from(photos)``.
    method : str or Estimator, optional
        One of :data:`METHODS`; an estimator of your own, or its ``module:name``. "motdiff" when
        omitted, "coded" with ``codes``.
    samples, seed, sharp, gyro, focal_px, start_s, exposure_s, axes, progress
        As of :func:`make_estimator`.
    codes : sequence of ShutterCode, optional
        The code of each photo, all open for an open shutter: the order in time of the motion is
        found as well. For "coded", and for "point".

    Raises
    ------
    ValueError
        If the method or an option is not valid, the photo is too small or without texture, or the
        estimator refuses it.

    Examples
    --------
    >>> from cep.optics.capture import capture
    >>> from motdiff.trajectory import Trajectory
    >>> rng = np.random.default_rng(0)
    >>> scene = np.kron(rng.random((30, 30)), np.ones((6, 6)))
    >>> path = Trajectory.from_samples([[0, 0], [8, 2], [12, 9]])
    >>> found = estimate_motion(capture(scene, path, rng=rng), method="reference", sharp=scene)
    >>> round(path.length_px), round(found.best.length_px), found.best.direction
    (16, 17, 'unknown')
    """
    options: dict[str, Any] = {
        "samples": samples,
        "sharp": sharp,
        "gyro": gyro,
        "focal_px": focal_px,
        "start_s": start_s,
        "exposure_s": exposure_s,
        "axes": axes,
        "codes": codes,
    }
    if method is None:
        method = "motdiff" if codes is None else "coded"
    if codes is not None:
        return _from_codes(
            photo, options, method=method, codes=codes, seed=seed, progress=progress
        )
    photos = _photos(photo)
    if isinstance(method, str):
        check_options(method, options)
        if len(photos) > 1:  # before anything slow is loaded
            check_several(method)
            check_photos(photos, method)
            check_apart(photos)
        else:
            check_photo(photos[0], method)
        estimator = make_estimator(method, seed=seed, progress=progress, **options)
    elif given := [name for name, value in options.items() if value is not None]:
        raise ValueError(f"{given[0]}: not valid with an estimator of your own")
    else:
        for one in photos:
            check_texture(one)
        check_apart(photos)
        estimator = method
    pixels = [_as_light(one) for one in photos]
    if len(pixels) == 1:
        name = method if isinstance(method, str) else type(method).__name__
        return _calibration(as_estimate(estimator.estimate(pixels[0]), name), pixels[0])
    if not hasattr(estimator, "estimate_from"):
        raise ValueError(
            f"method: {method} takes one photo, for it has no method estimate_from(photos)"
        )
    found: MotionEstimate = estimator.estimate_from(pixels)
    left_out = found.details.get("left_out", [])
    assert isinstance(left_out, list)
    return _calibration(found, next(one for i, one in enumerate(pixels, 1) if i not in left_out))


def check_several(method: str) -> None:
    """Refuse a method that takes one photo with an open shutter, before anything is loaded.

    Raises
    ------
    ValueError
        If the method is one of :data:`METHODS` and not among those that search photos together.
    """
    if method in METHODS and method not in _TOGETHER:
        raise ValueError(
            f"method: {method} takes one photo; several of one motion go with"
            f" {' or '.join(_TOGETHER)}"
        )


def _photos(given: ArrayLike | Sequence[ArrayLike]) -> list[ArrayLike]:
    """List the photos of a list or tuple of arrays; anything else, as an image of nested numbers,
    is one.
    """
    if (
        isinstance(given, list | tuple)
        and given
        and all(isinstance(one, np.ndarray) and one.ndim > 1 for one in given)
    ):
        return [*given]
    return [np.asarray(given)]


def check_apart(photos: Sequence[ArrayLike]) -> None:
    """Refuse a photo given twice: its noise would count as agreement, and no two codes take the
    same photo.

    Raises
    ------
    ValueError
        If two photos are equal.
    """
    for (i, one), (j, other) in combinations(enumerate(photos, 1), 2):
        if np.array_equal(one, other):
            raise ValueError(f"photo {j}: is the same as photo {i}; give each photo once")


def _calibration(found: MotionEstimate, photo: FloatArray) -> Calibration:
    return Calibration(
        **{one.name: getattr(found, one.name) for one in fields(MotionEstimate)}, photo=photo
    )


def _from_codes(
    photos: ArrayLike | Sequence[ArrayLike],
    options: dict[str, Any],
    *,
    method: str | Estimator,
    codes: Sequence[ShutterCode],
    seed: int,
    progress: Callable[[float, str], None],
) -> Calibration:
    if not isinstance(method, str):
        raise ValueError("codes: not valid with an estimator of your own")
    check_options(method, options)
    check_times(codes)
    given = list(photos) if isinstance(photos, Sequence) else [photos]
    if len(given) == 1 < len(codes) and np.ndim(given[0]) >= 3:
        raise ValueError(
            "photo: give the photos of several codes as a list or tuple, not as one array"
        )
    check_codes([code.bits for code in codes], photos=len(given))
    check_photos(given, method)
    check_apart(given)
    estimator = make_estimator(method, seed=seed, progress=progress, **options)
    assert hasattr(estimator, "estimate_from")
    found: MotionEstimate = estimator.estimate_from([_as_light(one) for one in given])
    return _calibration(found, _as_light(given[0]))


def check_times(codes: Sequence[ShutterCode]) -> None:
    """Refuse codes that were played at different speeds: they divide one motion in different ways.

    Raises
    ------
    ValueError
        If the codes' chips last differently.
    """
    for i, code in enumerate(codes, 1):
        if code.chip_ns != codes[0].chip_ns:
            raise ValueError(
                f"code {i}: its chips last {code.chip_ns} ns, those of the first one"
                f" {codes[0].chip_ns} ns; photos of one motion need codes of one duration"
            )


def _as_light(photo: ArrayLike) -> FloatArray:
    """Return the photo as floating point: large ones come in single precision, and stay so."""
    pixels = np.asarray(photo)
    return pixels if pixels.dtype in (np.float32, np.float64) else pixels.astype(np.float64)


def check_photo(photo: ArrayLike, method: str) -> None:
    """Refuse a photo that is too small for a method, or without texture, before anything slow is
    loaded.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
    method : str
        One of :data:`METHODS`.

    Raises
    ------
    ValueError
        If a side is too short, or the photo is constant, black or white.
    """
    check_size(photo, least_px=_LEAST_PX.get(method, 1))
    check_texture(photo)


def check_photos(photos: Sequence[ArrayLike], method: str) -> None:
    """Check each of several photos as :func:`check_photo` does.

    Parameters
    ----------
    photos : sequence of (H, W) or (H, W, 3) array_like, linear light 0..1
    method : str
        One of :data:`METHODS`.

    Raises
    ------
    ValueError
        Beginning with ``photo:``, where there are several with ``photo 2:``, what is wrong with
        it.
    """
    for i, photo in enumerate(photos, 1):
        try:
            check_photo(photo, method)
        except ValueError as error:
            which = f"photo {i}: " if len(photos) > 1 else "photo: "
            raise ValueError(which + str(error).removeprefix("photo: ")) from None


def check_texture(photo: ArrayLike) -> None:
    """Refuse a photo that is constant, black or white.

    Raises
    ------
    ValueError
        If the photo's values span less than two steps of 8 bit.
    """
    pixels = np.asarray(photo)
    low = float(pixels.min())
    high = float(pixels.max())
    if high - low < _LEAST_CONTRAST:
        shade = (
            "black"
            if high < _LEAST_CONTRAST
            else "white"
            if low > 1 - _LEAST_CONTRAST
            else "the same"
        )
        raise ValueError(
            f"the photo is {shade} all over: motion shows only where the scene has texture"
        )


def write_calibration(
    folder: Path | str,
    estimate: MotionEstimate,
    photo: ArrayLike,
    *,
    source: Mapping[str, object] | None = None,
    force: bool = False,
    bits: int = 8,
    gamma: str | float = "srgb",
) -> dict[str, Path]:
    """Write a motion estimate: trajectory, PSF in three formats, HR map, preview, restored photo;
    all or nothing.

    Parameters
    ----------
    folder : path of a folder, made when missing
    estimate : MotionEstimate
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1
        For the preview, and to be restored: see :func:`cep.restoration.sharpen.sharpen`.
    source : mapping, optional
        ``image``, ``seed``: where the estimate comes from.
    force : bool
        Whether existing files may be replaced.
    bits : {8, 16}
        Of the restored photo's samples.
    gamma : str or float
        Of the restored photo, as of :func:`cep.files.images.write_image`.

    Returns
    -------
    dict from file name to Path, of the files written

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given, or the folder cannot be written to.
    """
    best = estimate.trajectories[0]
    alternatives = tuple(zip(estimate.weights[1:], estimate.trajectories[1:], strict=True))
    about: dict[str, object] = {"method": estimate.method, **(source or {})}
    if estimate.path_error_px is not None:  # cep advise and cep optimize choose exposures by it
        about["path_uncertainty_px"] = estimate.path_error_px
    stored = StoredMotion(best, estimate.weights[0], alternatives, about)
    with new_folder(folder, CALIBRATION_FILES, force=force) as made:
        write_motion(made / "trajectory.json", stored)
        write_psf(made, estimate.psf)
        if best.frame_size() <= PSF_PX:
            write_image(made / "map.png", best.hr_map(), gamma="linear")
        save(trajectory_figure(photo, best), made / "preview.png")
        if (
            "order_confidence" not in estimate.details
        ):  # a photo through a code has a PSF of its own
            restored = sharpen(photo, estimate)
            if not restored.kept:
                write_image(made / "sharpened.png", restored.image, bits=bits, gamma=gamma)
        names = sorted(item.name for item in made.iterdir())
    return {name: Path(folder) / name for name in names}
