"""Camera model: photon and read noise, clipping, quantisation; files and known cameras."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from difflib import get_close_matches
from importlib import resources
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from cep.optics.code import is_whole
from motdiff.files.inputs import one_line, read_json, read_toml
from motdiff.files.json_files import fault, load_schema
from motdiff.files.outputs import write_text
from motdiff.photo_values import to_display, to_linear
from motdiff.simulate import add_noise
from motdiff.types import FloatArray

SCHEMA = "cep.camera/1"

LIGHT_RANGE = (1.0, 1e7)
"""Light levels that can be asked for, photo-electrons at full scale."""

_SIGMAS = 4.0  # of the jitter, on either side
_LARGEST_PHOTONS = 1e9  # Poisson draws stay exact in float64 and int64 far above any full well
_UNITS = {
    "read_noise_e": "electrons",
    "dark_current_e_s": "electrons a second",
    "least_exposure_s": "seconds",
    "trigger_delay_s": "seconds",
    "trigger_jitter_s": "seconds",
    "readout_s": "seconds",
}
"""Figures that are 0 or more, with their units in words."""
_ALWAYS_WRITTEN = ("photons_full_scale", "read_noise_e", "bits", "response", "black_level")
"""Others are written only where they are stated: a camera without them keeps its document, which
caches are keyed by."""


@dataclass(frozen=True)
class Camera:
    """A sensor.

    Parameters
    ----------
    photons_full_scale : float
        Photo-electrons that a pixel of value 1 has collected: the light level and the gain in one
        figure.
    read_noise_e : float
        Standard deviation of the Gaussian read noise, electrons.
    bits : int, 1..16
        Code values are multiples of ``1 / (2**bits - 1)``.
    response : {"linear", "srgb"}
        Curve on which the code values are evenly spaced. Arrays stay in linear light either way.
    black_level : float, 0..1
        Pedestal: values down to minus this are recorded, not clipped at 0, so that read noise does
        not brighten dark photos. Raw files have one, finished pictures do not.
    name, kind, source : str
        What the camera is called, what kind of sensor it has, and where its figures come from; one
        line each.
    full_well_e : float, optional
        Electrons at which a pixel saturates; None where that is not known. It limits which light
        levels can be reached (:attr:`saturation_e`), and no more: values are clipped at 1.
    gain_e_per_dn : float, optional
        Electrons per code value. With it code values are multiples of ``gain_e_per_dn /
        photons_full_scale``, whatever the light level. Without it all code values lie within 0..1,
        as if the gain followed the light.
    dark_current_e_s : float
        Dark current, electrons per pixel and second. Its noise counts where the time is known for
        which the sensor integrates it: in :meth:`at` and :meth:`noise_variance`. Its mean is taken
        as subtracted, but fills the well.
    least_exposure_s : float
        Shortest exposure of the camera's own shutter; 0 where that is not known.
    trigger_delay_s, trigger_jitter_s : float
        From the trigger to the start of the first row's exposure: mean, standard deviation.
    readout_s : float
        From the start of the first row's exposure to that of the last; 0 for a global shutter.
    exposure_offset_s : float
        By so much an exposure is longer than the camera states. ``cep hw timing`` measures these
        four.

    Raises
    ------
    ValueError
        If a figure is outside its range.

    Examples
    --------
    >>> Camera(bits=2).quantise([0.1, 0.5, 2.0]).tolist()
    [0.0, 0.6666666666666666, 1.0]
    >>> dim = Camera.load("sony-imx250").at(500, exposure_s=0.01)
    >>> dim.photons_full_scale, round(dim.read_noise_e, 2), round(dim.code_steps)
    (500.0, 2.4, 189)
    """

    photons_full_scale: float = 10_000.0
    read_noise_e: float = 5.0
    bits: int = 12
    response: Literal["linear", "srgb"] = "linear"
    black_level: float = 0.0
    name: str = ""
    kind: str = ""
    source: str = ""
    full_well_e: float | None = None
    gain_e_per_dn: float | None = None
    dark_current_e_s: float = 0.0
    least_exposure_s: float = 0.0
    trigger_delay_s: float = 0.0
    trigger_jitter_s: float = 0.0
    readout_s: float = 0.0
    exposure_offset_s: float = 0.0

    def __post_init__(self) -> None:
        for name in ("photons_full_scale", "black_level", "exposure_offset_s", *_UNITS):
            object.__setattr__(self, name, _number(name, getattr(self, name)))
        for name in ("full_well_e", "gain_e_per_dn"):
            if (electrons := getattr(self, name)) is not None:
                object.__setattr__(self, name, value := _number(name, electrons))
                if not (math.isfinite(value) and value > 0):
                    raise ValueError(
                        f"{name}: must be above 0 electrons, got {value}; leave it out where not"
                        " known"
                    )
        if not 0 < self.photons_full_scale <= _LARGEST_PHOTONS:
            raise ValueError(
                "photons_full_scale: must lie within 0..1e9 and above 0, got"
                f" {self.photons_full_scale}"
            )
        for name, unit in _UNITS.items():
            if not (math.isfinite(value := getattr(self, name)) and value >= 0):
                raise ValueError(f"{name}: must be 0 or more {unit}, got {value}")
        if not abs(self.exposure_offset_s) < math.inf:
            raise ValueError(f"exposure_offset_s: must be seconds, got {self.exposure_offset_s}")
        if not (is_whole(self.bits) and 1 <= self.bits <= 16):
            raise ValueError(f"bits: must be a whole number within 1..16, got {self.bits!r}")
        object.__setattr__(self, "bits", int(self.bits))
        if not 0 <= self.black_level <= 1:
            raise ValueError(f"black_level: must lie within 0..1, got {self.black_level}")
        if self.response not in ("linear", "srgb"):
            raise ValueError(f'response: must be "linear" or "srgb", got {self.response!r}')
        if self.gain_e_per_dn is not None and self.response != "linear":
            raise ValueError(
                'gain_e_per_dn: needs response "linear": code values of "srgb" differ in electrons'
            )
        for name in ("name", "kind", "source"):
            if not isinstance(text := getattr(self, name), str) or not text.isprintable():
                raise ValueError(f"{name}: must be one line of text, got {one_line(repr(text))}")

    # -- light ------------------------------------------------------------------------------------

    @property
    def code_steps(self) -> float:
        """Code values between light 0 and 1; not whole where the last one ends above 1."""
        if self.gain_e_per_dn is None:
            return float(2**self.bits - 1)
        return self.photons_full_scale / self.gain_e_per_dn

    @property
    def saturation_e(self) -> float:
        """Electrons, of light and dark current, at which the pixel or its code range is full.

        The pedestal is added after the pixel: it takes from the code range and not from the full
        well. Infinite where neither is known. A light level above it cannot be recorded: expose
        for less.
        """
        full_well_e = self.full_well_e or math.inf
        if self.gain_e_per_dn is None:
            return full_well_e
        pedestal_e = self.black_level * self.photons_full_scale
        range_e = self.gain_e_per_dn * float(2**self.bits - 1) - pedestal_e
        return min(full_well_e, max(range_e, 0.0))

    def at(self, photons: float, *, exposure_s: float | None = None) -> Camera:
        """Return the camera at a light level.

        ValueError if a figure is outside its range.

        Parameters
        ----------
        photons : float, 1..1e7
            Photo-electrons that the open shutter collects where the scene has the value 1. Levels
            above :attr:`saturation_e` are computed as if the pixel could hold them.
        exposure_s : float, optional
            Duration of the whole exposure, seconds. The dark current's noise over it is added to
            the read noise, and the camera returned has no dark current left; without it the dark
            current is not counted.
        """
        level = _number("photons", photons)
        if not LIGHT_RANGE[0] <= level <= LIGHT_RANGE[1]:
            raise ValueError(
                f"photons: must lie within 1..1e7 photo-electrons at full scale, got {level:g}"
            )
        black = self.black_level
        # the pedestal is so many code values, and with a gain those are electrons
        if self.gain_e_per_dn is not None:
            black = min(black * self.photons_full_scale / level, 1.0)
        camera = replace(self, photons_full_scale=level, black_level=black)
        if exposure_s is None:
            return camera
        if not (math.isfinite(time_s := _number("exposure_s", exposure_s)) and time_s > 0):
            raise ValueError(f"exposure_s: must be above 0 seconds, got {time_s:g}")
        return camera.with_dark_noise(time_s)

    def with_dark_noise(self, integration_s: float) -> Camera:
        """Return the camera with its dark current's noise counted as read noise."""
        noise_e = math.sqrt(self.read_noise_e**2 + float(self.dark_e(integration_s)))
        return replace(self, read_noise_e=noise_e, dark_current_e_s=0.0)

    def dark_e(self, integration_s: ArrayLike) -> FloatArray:
        """Electrons of dark current after (...) seconds: mean, and variance (Poisson)."""
        return np.asarray(self.dark_current_e_s * np.asarray(integration_s, dtype=np.float64))

    @property
    def lead_in_s(self) -> float:
        """Closed time before a code, after which all rows are exposed; 0 where not measured."""
        return self.trigger_delay_s + self.readout_s + _SIGMAS * self.trigger_jitter_s

    def least_stated_s(self, duration_s: float) -> float:
        """Return the exposure to set for a code that begins after the lead-in."""
        margin_s = self.readout_s + 2 * _SIGMAS * self.trigger_jitter_s
        return duration_s + margin_s - self.exposure_offset_s

    # -- noise ------------------------------------------------------------------------------------

    @property
    def noise(self) -> dict[str, float]:
        """Photon and read noise, as :func:`motdiff.simulate.add_noise` takes them."""
        read_sigma = self.read_noise_e / self.photons_full_scale
        return {"photons_full_scale": self.photons_full_scale, "read_sigma": read_sigma}

    def noise_variance(self, signal: ArrayLike, *, integration_s: ArrayLike = 0.0) -> FloatArray:
        """Variance of pixels: shot, read, dark and quantisation noise.

        ``signal`` (...) is their mean in linear light, 1 is full scale.

        Dark current is integrated for so many seconds (...), as
        :attr:`cep.optics.code.ShutterCode.integration_ns` says; at 0 it is not counted.
        """
        light = np.clip(np.asarray(signal, dtype=np.float64), 0.0, 1.0)
        # the variance of a Poisson number is its mean: signal / N in units of full scale
        shot = light / self.photons_full_scale
        step = self._code_slope(light) / self.code_steps
        dark = self.dark_e(integration_s) / self.photons_full_scale**2
        # rounding to steps is an error of uniform density: variance step^2 / 12
        return np.asarray(shot + self.noise["read_sigma"] ** 2 + dark + step**2 / 12)

    def expose(self, light: ArrayLike, *, rng: np.random.Generator) -> FloatArray:
        """Record linear light (...), 1 is full scale: shot noise, read noise, clipping, rounding.

        The result is linear light ``-black_level``..1, on the camera's code values.
        """
        clean = np.maximum(np.asarray(light, dtype=np.float64), 0.0)  # a Poisson mean
        return self.quantise(add_noise(clean, rng, **self.noise))

    def quantise(self, light: ArrayLike) -> FloatArray:
        """Clip (...) linear light to ``-black_level``..1 and round it to code values."""
        steps = self.code_steps
        bounded = np.clip(np.asarray(light, dtype=np.float64), -self.black_level, 1.0)
        if self.response == "linear":
            codes = np.rint(bounded * steps) / steps
            # the last step may end above 1
            return np.asarray(np.minimum(codes, 1.0), dtype=np.float64)
        return to_linear(np.rint(to_display(bounded) * steps) / steps)

    # -- files ------------------------------------------------------------------------------------

    def to_dict(self) -> dict[str, Any]:
        """Fields as a JSON document with its schema; unstated ones are left out."""
        values = asdict(self).items()
        entries = {key: value for key, value in values if key in _ALWAYS_WRITTEN or value}
        return {"schema": SCHEMA, **entries}

    @classmethod
    def load(cls, name_or_file: str | Path) -> Camera:
        """Load a profile by its name, or a camera's ``.json`` or ``.toml`` file by its path.

        Raises
        ------
        ValueError
            If there is no such profile, or the file does not describe a camera.
        OSError
            If the file cannot be read.
        """
        suffix = Path(name_or_file).suffix.lower()
        if isinstance(name_or_file, Path) or suffix in (".json", ".toml"):
            return cls.from_file(name_or_file)
        names = camera_names()
        if name_or_file in names:
            with resources.as_file(_profiles() / f"{name_or_file}.toml") as path:
                return cls.from_file(path)
        alike = get_close_matches(name_or_file.lower(), names, n=3, cutoff=0.5)
        right = f"known are {', '.join(names)}."
        if alike:
            right = f"did you mean {' or '.join(alike)}?"
        raise ValueError(
            f"camera: {one_line(name_or_file)!r} is not known; {right} Or name a .json or .toml"
            " file"
        )

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Camera:
        """Make a camera from a document; missing fields and schema take their defaults.

        ValueError if the schema or a field is not known, or a value is out of range.
        """
        values = {key: value for key, value in document.items() if key != "schema"}
        if (schema := document.get("schema", SCHEMA)) != SCHEMA:
            raise ValueError(f'wanted schema "{SCHEMA}", found {schema!r}')
        if (wrong := fault(dict(document), load_schema("cep.files", "camera"))) is not None:
            raise ValueError(wrong)
        if isinstance(bits := values.get("bits"), float):
            values["bits"] = int(bits)  # as some programs write whole numbers
        return cls(**values)

    @classmethod
    def from_file(cls, path: Path | str) -> Camera:
        """Read a camera from ``.json`` or ``.toml``; OSError if the file cannot be read.

        ValueError, which names the file, if it is of another kind or describes no camera.
        """
        read = {".json": read_json, ".toml": read_toml}[_suffix(path)]
        document: Any = read(path)
        if not isinstance(document, dict):
            raise ValueError(
                f"{path}: wanted an object with a camera's fields, found {type(document).__name__}"
            )
        try:
            return cls.from_dict(document)
        except ValueError as error:
            raise ValueError(f"{path}: {one_line(error)}") from None

    def to_file(self, path: Path | str) -> None:
        """Write the camera, whole or not at all, as ``.json`` or ``.toml``, else ValueError."""
        document = self.to_dict()
        text = json.dumps(document, indent=1) + "\n"
        if _suffix(path) == ".toml":
            # numbers and printable text read the same in JSON and TOML
            text = "".join(
                f"{key} = {json.dumps(value, ensure_ascii=False)}\n"
                for key, value in document.items()
            )
        write_text(path, text)

    def _code_slope(self, light: FloatArray) -> FloatArray:
        """Linear light per unit of code."""
        if self.response == "linear":
            return np.ones_like(light)
        code = to_display(light)
        # derivative of the sRGB curve, IEC 61966-2-1
        return np.where(code <= 0.04045, 1 / 12.92, 2.4 / 1.055 * ((code + 0.055) / 1.055) ** 1.4)


def camera_names() -> tuple[str, ...]:
    """Names of the profiles that :meth:`Camera.load` knows, sorted."""
    files = (item.name for item in _profiles().iterdir())
    return tuple(sorted(name.removesuffix(".toml") for name in files if name.endswith(".toml")))


def _profiles() -> Any:
    """Folder of the profiles, a Traversable."""
    return resources.files("cep") / "optics" / "cameras"


def _number(name: str, value: Any) -> float:
    """Check that a field is a number."""
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise ValueError(f"{name}: must be a number, got {value!r}")
    try:
        return float(value)
    except OverflowError:  # whole numbers have no largest one
        raise ValueError(f"{name}: must be a number below 1e308, got a larger one") from None


def _suffix(path: Path | str) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in (".json", ".toml"):
        raise ValueError(f"{path}: a camera file must end in .json or .toml")
    return suffix
