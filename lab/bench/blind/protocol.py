"""Protocols of the blind table: photos, motions, light levels and repetitions, as TOML files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from motdiff.files.inputs import one_line, read_toml, typed_fields
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.psf_frame import PSF_PX
from motdiff.simulate import border_px
from motdiff.trajectory import Trajectory

NAMES = ("paper", "ours", "card-walks", "card-gyro")
"""Protocols of the package."""

_FOLDER = Path(__file__).parent


@dataclass(frozen=True)
class Motions:
    """Distribution of the simulated motions.

    Attributes
    ----------
    boracchi_foi, gyro : float
        Shares of random walks and of hand shake.
    max_length_px : float, px
        Length of the random walks.
    extent_px : (float, float), px
        Range of the larger side of a hand shake.
    exposure_s : (float, float), seconds
        Range of exposures of a hand shake.
    """

    boracchi_foi: float = 1.0
    gyro: float = 0.0
    max_length_px: float = 60.0
    extent_px: tuple[float, float] = (12.0, 36.0)
    exposure_s: tuple[float, float] = (0.05, 0.5)

    def __post_init__(self) -> None:
        if min(self.boracchi_foi, self.gyro) < 0 or self.boracchi_foi + self.gyro <= 0:
            raise ValueError(
                "boracchi_foi and gyro: must be shares of 0 or more, one above 0, got"
                f" {self.boracchi_foi}, {self.gyro}"
            )
        if not 1 <= self.max_length_px <= 1000:
            raise ValueError(
                f"max_length_px: must lie within 1..1000 px, got {self.max_length_px}"
            )
        for name in ("extent_px", "exposure_s"):
            low, high = getattr(self, name)
            if not 0 < low <= high < 1000:
                raise ValueError(
                    f"{name}: must be two numbers above 0, the smaller first, got {low}, {high}"
                )


@dataclass(frozen=True)
class Protocol:
    """Photos of a blind table; they are restored as in :data:`lab.evaluation.measure.RESTORATION`.

    Attributes
    ----------
    name : str
    photos, motions : int
    pairs : {"all", "each"}
        Every photo is taken with every motion, or motion i with photo i alone (the photos come
        again in turns).
    crop_px : int, px
        Side of the photos taken.
    psf_px : int, px
        Frame that every motion fits.
    real_photos : int
        Largest number of photos used from a folder with real blur.
    borders : {"symmetric", "real"}
        The scene is mirrored at the photo's border, or light comes from beyond it.
    gamma : {"linear", "srgb"}
        Whether code values are used as light, or decoded to it.
    light_photons : tuple of float, photo-electrons
        Light levels: photo-electrons at full scale. Without one there is no noise.
    read_noise_e : float, electrons
        Standard deviation of the read noise at every level.
    read_sigma : float
        Standard deviation of the noise without light levels, full scale 1.
    grey : bool
        Photos of one channel, the mean of the three.
    seed : int
    motion : Motions
    """

    name: str
    photos: int
    motions: int
    pairs: Literal["all", "each"] = "all"
    crop_px: int = 256
    psf_px: int = PSF_PX
    real_photos: int = 100
    borders: Literal["symmetric", "real"] = "symmetric"
    gamma: Literal["linear", "srgb"] = "linear"
    light_photons: tuple[float, ...] = ()
    read_noise_e: float = 0.0
    read_sigma: float = 0.0
    grey: bool = False
    seed: int = 0
    motion: Motions = field(default_factory=Motions)

    def __post_init__(self) -> None:
        for name, low, high in (
            ("photos", 1, 10_000),
            ("motions", 1, 10_000),
            ("real_photos", 1, 100_000),
            ("crop_px", 64, 4096),
            ("psf_px", 8, PSF_PX),
            ("seed", 0, 2**31),
        ):
            if not low <= getattr(self, name) <= high:
                raise ValueError(
                    f"{name}: must lie within {low}..{high}, got {getattr(self, name)}"
                )
        if self.pairs not in ("all", "each"):
            raise ValueError(f'pairs: must be "all" or "each", got {self.pairs!r}')
        if self.pairs == "each" and self.psf_px != PSF_PX:
            raise ValueError(f'psf_px: must be {PSF_PX} px with pairs = "each", got {self.psf_px}')
        if self.borders not in ("symmetric", "real"):
            raise ValueError(f'borders: must be "symmetric" or "real", got {self.borders!r}')
        if self.gamma not in ("linear", "srgb"):
            raise ValueError(f'gamma: must be "linear" or "srgb", got {self.gamma!r}')
        if wrong := [level for level in self.light_photons if not 0 < level <= 1e9]:
            raise ValueError(f"light_photons: must lie within 0..1e9 and above 0, got {wrong[0]}")
        if len(set(self.light_photons)) < len(self.light_photons):
            raise ValueError(
                f"light_photons: every level must come once, got {list(self.light_photons)}"
            )
        if not 0 <= self.read_noise_e <= 1e4:
            raise ValueError(
                f"read_noise_e: must lie within 0..1e4 electrons, got {self.read_noise_e}"
            )
        if self.read_noise_e > 0 and not self.light_photons:
            raise ValueError("read_noise_e: needs light_photons, the electrons of full scale")
        if not 0 <= self.read_sigma <= 1:
            raise ValueError(f"read_sigma: must lie within 0..1, got {self.read_sigma}")
        if self.read_sigma > 0 and self.light_photons:
            raise ValueError(
                "read_sigma: not valid with light_photons, whose noise is read_noise_e"
            )

    @property
    def least_px(self) -> int:
        """Shortest side, px, of a sharp photo: with real borders the scene reaches beyond the
        photo.
        """
        return self.crop_px + border_px(self.borders, self.psf_px)

    @property
    def levels(self) -> tuple[float | None, ...]:
        """Light levels, a single None where the noise depends on no light."""
        return self.light_photons or (None,)

    @classmethod
    def load(cls, name_or_path: str | Path, *, quick: bool = False) -> Protocol:
        """Read a protocol of the package by name, or a TOML file.

        Parameters
        ----------
        name_or_path : name in :data:`NAMES`, or a .toml file
        quick : bool
            Whether the file's section ``[quick]`` replaces its other entries.

        Raises
        ------
        ValueError
            If the name is not known, or the file is no protocol; the line names the file and the
            entry.
        OSError
            If the file cannot be read.
        """
        is_bundled = str(name_or_path) in NAMES
        path = _FOLDER / f"{name_or_path}.toml" if is_bundled else Path(name_or_path)
        if path.suffix != ".toml":
            raise ValueError(
                f"protocol: must be {', '.join(NAMES)}, or a .toml file, got {str(name_or_path)!r}"
            )
        table = read_toml(path)
        try:
            return _read(path.stem, table, quick=quick)
        except (ValueError, OverflowError) as error:  # whole numbers that no float reaches
            raise ValueError(f"{path}: {one_line(error)}") from None


def _read(name: str, table: Mapping[str, Any], *, quick: bool) -> Protocol:
    entries = {key: value for key, value in table.items() if key not in ("motion", "quick")}
    for key in ("photos", "motions"):
        if key not in entries:
            raise ValueError(f"{key}: is missing")
    quick_entries = _section(table, "quick")
    for table_entries in (entries, quick_entries):
        if unknown := table_entries.keys() & {"name", "motion"}:
            raise ValueError(f"{min(unknown)}: is not known here")
    motion = Motions(**typed_fields(_section(table, "motion"), Motions))
    protocol = Protocol(**typed_fields(entries, Protocol), name=name, motion=motion)
    # read even where it is not used: a mistake in it should not wait for the first quick run
    smaller = replace(protocol, **typed_fields(quick_entries, Protocol))
    return smaller if quick else protocol


def _section(table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    section = table.get(name, {})
    if not isinstance(section, Mapping):
        raise ValueError(f"{name}: must be a section, [{name}]")
    return section


_TRIES = 100
_PAIRS = 0x6576616C  # streams, apart from those of a training run of the same seed
_OTHER_PAIRS = 0x6D65616E
_RATE_RAD_S = 0.1
_LOW_HZ = 0.5
_FALL_HZ = 4.0


def drawn_shakes(
    protocol: Protocol, trace: GyroTrace | None = None, *, stream: int = 0
) -> tuple[Trajectory, ...]:
    """Draw the motions of a protocol; motion i depends on the protocol's seed and motions, and on
    i.

    Parameters
    ----------
    protocol : Protocol
    trace : GyroTrace, optional
        Recording for the hand shake; :func:`synthetic_trace` when omitted.
    stream : int
        Number of an independent random stream with the same distribution.

    Raises
    ------
    ValueError
        If no drawn motion fits the protocol's frame, or the recording is too short or too still.
    """
    if trace is None and protocol.motion.gyro > 0:
        trace = synthetic_trace()
    return tuple(
        _drawn(protocol, trace, np.random.default_rng([protocol.seed, stream, i]))
        for i in range(protocol.motions)
    )


def paired_shakes(
    protocol: Protocol, trace: GyroTrace | None = None, *, others: int = 0
) -> tuple[tuple[Trajectory, Mapping[str, Any]], ...]:
    """Draw the motions of a protocol whose photos have one motion each, and the generator of each
    photo.

    One generator draws a motion, then the crop and the noise of its photo. The figures of the
    weights' cards are of such photos.

    Parameters
    ----------
    protocol : Protocol
    trace : GyroTrace, optional
        Recording for the hand shake; :func:`synthetic_trace` when omitted.
    others : int
        So many motions of an independent stream instead, where it is not 0.

    Returns
    -------
    tuple of (Trajectory, state of the generator after the motion)

    Raises
    ------
    ValueError
        If no drawn motion fits the frame, or the recording is too short or too still.
    """
    from motdiff.training.motion_bank import MotionMix, draw_motion

    range_px = protocol.motion
    low_px, high_px = range_px.extent_px
    mix = MotionMix(
        boracchi_foi=range_px.boracchi_foi,
        gyro=range_px.gyro,
        max_length_px=range_px.max_length_px,
        min_length_px=min(MotionMix.min_length_px, range_px.max_length_px),
        min_extent_px=low_px,
        max_extent_px=high_px,
        exposure_s=range_px.exposure_s,
        gyro_trace="trace",  # is given to draw_motion
    )
    if trace is None and range_px.gyro > 0:
        trace = synthetic_trace()
    shakes = []
    for i in range(others or protocol.motions):
        rng = np.random.default_rng([_OTHER_PAIRS if others else _PAIRS, protocol.seed, i])
        shakes.append((draw_motion(mix, rng, trace), rng.bit_generator.state))
    return tuple(shakes)


def synthetic_trace(
    seed: int | np.random.Generator = 0, *, duration_s: float = 60.0, rate_hz: float = 200.0
) -> GyroTrace:
    """Synthetic hand shake: angular rates as noise of 1 to 12 Hz, 0.1 rad/s rms."""
    rng = np.random.default_rng(seed)
    count = round(duration_s * rate_hz)
    freq_hz = np.fft.rfftfreq(count, 1 / rate_hz)
    real, imaginary = rng.standard_normal((2, 3, freq_hz.size))
    spectrum = (real + 1j * imaginary) * np.exp(-freq_hz / _FALL_HZ) * (freq_hz > _LOW_HZ)
    rate = np.fft.irfft(spectrum, count, axis=1).T
    return GyroTrace(np.arange(count) / rate_hz, _RATE_RAD_S * rate / rate.std(axis=0))


def _drawn(protocol: Protocol, trace: GyroTrace | None, rng: np.random.Generator) -> Trajectory:
    range_px = protocol.motion
    share = range_px.gyro / (range_px.gyro + range_px.boracchi_foi)
    for _ in range(_TRIES):
        if trace is not None and rng.random() < share:
            motion = random_gyro_motion(
                trace,
                rng,
                exposure_s=rng.uniform(*range_px.exposure_s),
                extent_px=rng.uniform(*range_px.extent_px),
            )
        else:
            motion = boracchi_foi(rng, max_length_px=range_px.max_length_px)
        if motion.frame_size() <= protocol.psf_px:
            return motion
    raise ValueError(
        f"motion: {_TRIES} drawn motions did not fit psf_px = {protocol.psf_px} px, make them"
        " shorter"
    )
