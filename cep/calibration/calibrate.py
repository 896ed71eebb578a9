"""Motion estimates from photos, and the files of a calibration."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cep.calibration.photo_checks import (
    check_apart,
    check_method_photos,
    check_texture,
    check_times,
)
from cep.files.images import read_image, write_image
from cep.files.psf_files import write_psf
from cep.optics.code import ShutterCode
from cep.plots.canvas import png_bytes, save
from cep.plots.photos import trajectory_figure
from cep.restoration.sharpen import sharpen
from motdiff.estimators.base import Estimator, MotionEstimate, load_estimator
from motdiff.estimators.description import as_estimate
from motdiff.estimators.method import Method, command_options
from motdiff.estimators.registry import METHODS, check_options, make_method
from motdiff.files.gyro_tables import read_gyro
from motdiff.files.outputs import new_folder, summary_on_failure
from motdiff.files.plugins import is_reference
from motdiff.files.trajectories import StoredMotion, trajectory_text, write_motion
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

CALIBRATION_FILES = (
    "trajectory.json",
    "psf.npy",
    "psf.mat",
    "psf.png",
    "map.png",
    "preview.png",
    "sharpened.png",
)
"""What :meth:`Calibration.save` writes; ``map.png`` only where the path fits the 64-px field,
``sharpened.png`` only of a photo with an open shutter, where a restoration is better than the
photo."""

_OPTIONAL_DETAILS = (
    "psf_confidence",
    "path_confidence",
    "order_confidence",
    "path_uncertainty_px",
    "repeatability",
    "left_out",
)
"""Figures of some estimators alone."""


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

    @classmethod
    def of(cls, estimate: MotionEstimate, photo: FloatArray) -> Calibration:
        """Join an estimate and the photo that it is shown with."""
        # not dataclasses.asdict, which would turn the trajectories into dicts too
        values = {key.name: getattr(estimate, key.name) for key in fields(MotionEstimate)}
        return cls(**values, photo=photo)

    def save(
        self,
        folder: Path | str,
        *,
        source: Mapping[str, object] | None = None,
        force: bool = False,
        bits: int = 8,
        gamma: str | float = "srgb",
    ) -> dict[str, Path]:
        """Write trajectory, PSF in three formats, HR map, preview, restored photo; all or nothing.

        Parameters
        ----------
        folder : path of a folder, made when missing
        source : mapping, optional
            ``image``, ``seed``: where the estimate comes from.
        force : bool
            Whether existing files may be replaced.
        bits : {8, 16}
            Of the restored photo's samples: see :func:`cep.restoration.sharpen.sharpen`.
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
        alternatives = tuple(zip(self.weights[1:], self.trajectories[1:], strict=True))
        about: dict[str, object] = {"method": self.method, **(source or {})}
        if self.path_error_px is not None:  # cep advise and cep optimize choose exposures by it
            about["path_uncertainty_px"] = self.path_error_px
        stored = StoredMotion(self.best, self.weights[0], alternatives, about)
        # a full disk must not cost the estimate: its error names the path
        summary = summary_on_failure(trajectory_text(self.best))
        with summary, new_folder(folder, CALIBRATION_FILES, force=force) as staged:
            write_motion(staged / "trajectory.json", stored)
            write_psf(staged, self.psf)
            if self.best.frame_size() <= PSF_PX:
                write_image(staged / "map.png", self.best.hr_map(), gamma="linear")
            save(trajectory_figure(self.photo, self.best), staged / "preview.png")
            # a photo through a code has a PSF of its own, which the path's is not
            if "order_confidence" not in self.details:
                restored = sharpen(self.photo, self)
                if not restored.kept:
                    write_image(staged / "sharpened.png", restored.image, bits=bits, gamma=gamma)
            names = sorted(item.name for item in staged.iterdir())
        return {name: Path(folder) / name for name in names}

    def to_dict(
        self, files: Mapping[str, Path], *, seconds: float, warnings: Sequence[str]
    ) -> dict[str, Any]:
        """Describe the calibration as the JSON of a photo and of a folder has it.

        Parameters
        ----------
        files : mapping from a file's name to its path
            As of :meth:`save`.
        seconds : float
            That the estimate took.
        warnings : sequence of str
            About the photo and the estimate.
        """
        return {
            "method": self.method,
            "trajectory": files["trajectory.json"],
            "psf": files["psf.npy"],
            "length_px": self.best.length_px,
            "extent_px": self.best.extent_px,
            "direction": self.best.direction,
            "confidence": self.confidence,
            **{key: self.details[key] for key in _OPTIONAL_DETAILS if key in self.details},
            "seconds": seconds,
            "warnings": warnings,
            "files": list(files.values()),
            "details": self.details,
        }

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
    method: str | Method | Estimator | None = None,
    codes: Sequence[ShutterCode] | None = None,
    seed: int = 0,
    progress: Callable[[float, str], None] = lambda _share, _note: None,
    **options: Any,
) -> Calibration:
    """Estimate the camera's motion from a blurred photo, or from several photos of one motion.

    Parameters
    ----------
    photo : (H, W) or (H, W, 3) array_like, linear light 0..1; or a list or tuple of arrays
        Several show one motion, of one scene or of different ones: with an open shutter they are
        searched together, by "motdiff", "pmp" and estimators with a method
        ``estimate_from(photos)``.
    method : str, Method or Estimator, optional
        A name of :data:`motdiff.estimators.registry.METHODS`: "motdiff", "pmp", "reference",
        "point", "gyro" or "coded"; a user-defined estimator, or its ``module:name``. "motdiff"
        when omitted, "coded" with ``codes``.
    codes : sequence of ShutterCode, optional
        The code of each photo, all open for an open shutter: the order in time of the motion is
        found as well. For "coded", and for "point".
    seed : int
        Of what is drawn at random.
    progress : callable, optional
        Called with the finished share 0..1 of loading and estimating, and what is being done, by
        methods that take long.
    **options
        Those of the method: ``sharp`` of "reference", a sharp photo as
        an array; ``gyro``, ``focal_px``, ``start_s``, ``exposure_s`` and ``axes`` of "gyro", as of
        :class:`motdiff.estimators.gyro.estimator.GyroEstimator`.

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
    >>> blurred = capture(scene, path, rng=rng)
    >>> estimate = estimate_motion(blurred, method="reference", sharp=scene)
    >>> round(path.length_px), round(estimate.best.length_px), estimate.best.direction
    (16, 17, 'unknown')
    """
    photos = _photo_list(photo)
    if codes is not None:
        check_times(codes)
        options["codes"] = tuple(code.bits for code in codes)
        method = method or "coded"
    method = method or "motdiff"
    label = method if isinstance(method, str) else type(method).__name__
    if isinstance(method, str) and not is_reference(method):
        method = make_method(method, options)
    elif set_options := [name for name, value in options.items() if value is not None]:
        reference = f"method={label!r}" if isinstance(method, str) else "an estimator of your own"
        raise ValueError(f"{set_options[0]}: not valid with {reference}")
    if isinstance(method, Method):
        check_method_photos(photos, method)
        estimator = method.load(seed=seed, progress=progress)
        is_together = hasattr(estimator, "estimate_from")
    else:
        for array in photos:
            check_texture(array)
        check_apart(photos)
        estimator = load_estimator(method) if isinstance(method, str) else method
        is_together = len(photos) > 1  # a user's estimator may take one photo alone
    pixels = [_as_light(array) for array in photos]
    if not is_together:
        return Calibration.of(as_estimate(estimator.estimate(pixels[0]), label), pixels[0])
    if not hasattr(estimator, "estimate_from"):
        raise ValueError(
            f"method: {method} takes one photo, for it has no method estimate_from(photos)"
        )
    estimate: MotionEstimate = estimator.estimate_from(pixels)
    left_out = estimate.details.get("left_out", [])
    assert isinstance(left_out, list)
    # a photo that shows another motion is no picture of this one
    first_used = next(light for i, light in enumerate(pixels, 1) if i not in left_out)
    return Calibration.of(estimate, first_used)


def read_options(
    name: str,
    texts: Mapping[str, Any],
    *,
    gamma: str | float = "srgb",
) -> dict[str, Any]:
    """Return the values of a method's options, after the files that they name are read.

    Parameters
    ----------
    name : str
        Of the method.
    texts : mapping from an option to its value
        A photo and a gyroscope's recording as the path of a file; None where it is not given.
    gamma
        Of a photo, as of :func:`cep.files.images.read_image`.
    """
    values = dict(texts)
    rate_unit = values.pop("rate_unit", None)  # of the file, not of what is read from it
    if name not in METHODS:
        return values
    for key, option in command_options(METHODS[name]).items():
        if values.get(key) is None:
            continue
        if option.kind == "photo":
            values[key] = read_image(values[key], gamma=gamma, variable="x")
        elif option.kind == "gyro":
            values[key] = read_gyro(values[key], rate_unit=rate_unit)
    return values


def check_method(name: str, options_given: Mapping[str, Any]) -> None:
    """Check the name of a method, perhaps ``module:name``, and which options it has.

    Parameters
    ----------
    name : str
    options_given : mapping from an option to its value, None where it is not given

    Raises
    ------
    ValueError
        If the method is not known, or an option is missing or not one of its own.
    """
    options = [key for key, value in options_given.items() if value is not None]
    if not is_reference(name):
        check_options(name, options)
        for key, option in command_options(METHODS[name]).items():
            value = options_given.get(key)
            if option.choices and value not in (None, *option.choices):
                raise ValueError(f"{key}: must be {' or '.join(option.choices)}, got {value!r}")
    elif options:
        raise ValueError(f"{min(options)}: not valid with method={name!r}")


def _photo_list(photo: ArrayLike | Sequence[ArrayLike]) -> list[ArrayLike]:
    """List the photos of a list or tuple of arrays; anything else, as nested numbers, is one."""
    if (
        isinstance(photo, list | tuple)
        and photo
        and all(isinstance(item, np.ndarray) and item.ndim > 1 for item in photo)
    ):
        return [*photo]
    return [np.asarray(photo)]


def _as_light(photo: ArrayLike) -> FloatArray:
    """Return the photo as floating point: large ones come in single precision, and stay so."""
    pixels = np.asarray(photo)
    if pixels.dtype == np.float32:
        return pixels
    return pixels.astype(np.float64, copy=False)
