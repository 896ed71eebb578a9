"""Camera model: photon noise, read noise, clipping, quantisation; and its files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cep.io.outputs import write_text
from motdiff.io.inputs import one_line, read_json, read_toml
from motdiff.simulate import add_noise, to_display, to_linear

__all__ = ["LIGHT_LEVELS", "SCHEMA", "Camera"]

FloatArray = NDArray[np.float64]
SCHEMA = "cep.camera/1"

LIGHT_LEVELS = (100.0, 1_000.0, 10_000.0, 100_000.0)
"""Photo-electrons at full scale at which coding is compared with not coding: from starlight to studio."""

_LARGEST_PHOTONS = 1e9  # Poisson draws stay exact in float64 and int64 far above any full well


@dataclass(frozen=True)
class Camera:
    """A sensor.

    Parameters
    ----------
    photons_full_scale : float
        Photo-electrons that a pixel of value 1 has collected: the light level and the gain in one figure.
    read_noise_e : float
        Standard deviation of the Gaussian read noise, electrons.
    bits : int, 1..16
        Code values are multiples of ``1 / (2**bits - 1)``.
    response : {"linear", "srgb"}
        Curve on which the code values are evenly spaced. Arrays stay in linear light either way.
    black_level : float, 0..1
        Pedestal: values down to minus this are recorded, not clipped at 0, so that read noise does not brighten
        dark photos. Raw files have one, finished pictures do not.

    Raises
    ------
    ValueError
        If a figure is outside its range.

    Examples
    --------
    >>> Camera(bits=2).quantise([0.1, 0.5, 2.0]).tolist()
    [0.0, 0.6666666666666666, 1.0]
    """

    photons_full_scale: float = 10_000.0
    read_noise_e: float = 5.0
    bits: int = 12
    response: Literal["linear", "srgb"] = "linear"
    black_level: float = 0.0

    def __post_init__(self) -> None:
        for name in ("photons_full_scale", "read_noise_e", "black_level"):
            if isinstance(value := getattr(self, name), bool) or not isinstance(value, int | float | np.number):
                raise ValueError(f"{name}: must be a number, got {value!r}")
            try:
                object.__setattr__(self, name, float(value))
            except OverflowError:  # whole numbers have no largest one
                raise ValueError(f"{name}: must be a number below 1e308, got a larger one") from None
        if not 0 < self.photons_full_scale <= _LARGEST_PHOTONS:
            raise ValueError(f"photons_full_scale: must lie within 0..1e9 and above 0, got {self.photons_full_scale}")
        if not (np.isfinite(self.read_noise_e) and self.read_noise_e >= 0):
            raise ValueError(f"read_noise_e: must be 0 or more electrons, got {self.read_noise_e}")
        if isinstance(self.bits, bool) or not isinstance(self.bits, int) or not 1 <= self.bits <= 16:
            raise ValueError(f"bits: must be a whole number within 1..16, got {self.bits!r}")
        if not 0 <= self.black_level <= 1:
            raise ValueError(f"black_level: must lie within 0..1, got {self.black_level}")
        if self.response not in ("linear", "srgb"):
            raise ValueError(f'response: must be "linear" or "srgb", got {self.response!r}')

    # -- noise --------------------------------------------------------------------------------------------------

    @property
    def noise(self) -> dict[str, float]:
        """Photon and read noise, as :func:`motdiff.simulate.add_noise` takes them."""
        read_sigma = self.read_noise_e / self.photons_full_scale
        return {"photons_full_scale": self.photons_full_scale, "read_sigma": read_sigma}

    def noise_variance(self, signal: ArrayLike) -> FloatArray:
        """Variance of a pixel whose mean is ``signal``: shot + read + quantisation, in full-scale units squared.

        Parameters
        ----------
        signal : (...) array_like, linear light 0..1

        Returns
        -------
        (...) float ndarray
        """
        light = np.clip(np.asarray(signal, dtype=np.float64), 0.0, 1.0)
        shot = light / self.photons_full_scale
        step = self._code_slope(light) / (2**self.bits - 1)
        return np.asarray(shot + self.noise["read_sigma"] ** 2 + step**2 / 12, dtype=np.float64)

    def expose(self, light: ArrayLike, *, rng: np.random.Generator) -> FloatArray:
        """Record ``light``: Poisson shot noise, Gaussian read noise, clipping, rounding to code values.

        Parameters
        ----------
        light : (...) array_like, linear light collected in the exposure, 0..1
        rng : numpy Generator

        Returns
        -------
        (...) float ndarray, linear light ``-black_level``..1, on the camera's code values.
        """
        clean = np.maximum(np.asarray(light, dtype=np.float64), 0.0)
        return self.quantise(add_noise(clean, rng, **self.noise))

    def quantise(self, light: ArrayLike) -> FloatArray:
        """Clip (...) linear light to ``-black_level``..1 and round it to the nearest code value."""
        levels = 2**self.bits - 1
        bounded = np.clip(np.asarray(light, dtype=np.float64), -self.black_level, 1.0)
        if self.response == "linear":
            return np.asarray(np.rint(bounded * levels) / levels, dtype=np.float64)
        return to_linear(np.rint(to_display(bounded) * levels) / levels)

    # -- files --------------------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Fields as a JSON document with its schema."""
        return {"schema": SCHEMA, **asdict(self)}

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Camera:
        """Make a camera from a document; missing fields take their defaults, ``schema`` may be left out.

        Raises
        ------
        ValueError
            If the schema or a field is not known, or a value is out of range.
        """
        known = {field.name for field in fields(cls)}
        values = {key: value for key, value in document.items() if key != "schema"}
        if (found := document.get("schema", SCHEMA)) != SCHEMA:
            raise ValueError(f'wanted schema "{SCHEMA}", found {found!r}')
        if unknown := sorted(set(values) - known):
            raise ValueError(f"unknown field {unknown[0]!r}; a camera has {', '.join(sorted(known))}")
        return cls(**values)

    @classmethod
    def from_file(cls, path: Path | str) -> Camera:
        """Read a camera from ``.json`` or ``.toml``.

        Raises
        ------
        ValueError
            If the file is of another kind or does not describe a camera; the line names the file.
        OSError
            If the file cannot be read.
        """
        document = read_json(path) if _suffix(path) == ".json" else read_toml(path)
        if not isinstance(document, dict):
            raise ValueError(f"{path}: wanted an object with a camera's fields, found {type(document).__name__}")
        try:
            return cls.from_dict(document)
        except ValueError as error:
            raise ValueError(f"{path}: {one_line(error)}") from None

    def to_file(self, path: Path | str) -> None:
        """Write the camera as ``.json`` or ``.toml``, whole or not at all.

        Raises
        ------
        ValueError
            If the file name ends otherwise.
        """
        suffix = _suffix(path)
        items = self.to_dict().items()
        # numbers and plain words read the same in JSON and TOML
        toml = "".join(f"{key} = {json.dumps(value)}\n" for key, value in items)
        write_text(path, toml if suffix == ".toml" else json.dumps(dict(items), indent=1) + "\n")

    def _code_slope(self, light: FloatArray) -> FloatArray:
        """Linear light per unit of code."""
        if self.response == "linear":
            return np.ones_like(light)
        code = to_display(light)
        return np.where(code <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((code + 0.055) / 1.055) ** 1.4)


def _suffix(path: Path | str) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in (".json", ".toml"):
        raise ValueError(f"{path}: a camera file must end in .json or .toml")
    return suffix
