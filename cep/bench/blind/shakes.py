"""Motions of a protocol: random walks, and hand shake from a gyroscope's recording or from noise that resembles one."""

from __future__ import annotations

import numpy as np

from cep.bench.blind.protocol import Protocol
from motdiff.gyro import GyroTrace
from motdiff.motions import boracchi_foi, random_gyro_motion
from motdiff.trajectory import Trajectory

__all__ = ["drawn_shakes", "synthetic_trace"]

_TRIES = 100
_DURATION_S, _RATE_HZ, _RATE_RAD_S = 60.0, 200.0, 0.1
_LOW_HZ, _FALL_HZ = 0.5, 4.0


def drawn_shakes(protocol: Protocol, trace: GyroTrace | None = None, *, stream: int = 0) -> tuple[Trajectory, ...]:
    """Draw the motions of a protocol; motion i depends on the protocol's seed and motions, and on i.

    Parameters
    ----------
    protocol : Protocol
    trace : GyroTrace, optional
        Recording for the hand shake; :func:`synthetic_trace` when omitted.
    stream : int
        Others of the same kind.

    Raises
    ------
    ValueError
        If no drawn motion fits the protocol's frame, or the recording is too short or too still.
    """
    if trace is None and protocol.motion.gyro > 0:
        trace = synthetic_trace()
    return tuple(
        _drawn(protocol, trace, np.random.default_rng([protocol.seed, stream, i])) for i in range(protocol.motions)
    )


def synthetic_trace(seed: int = 0) -> GyroTrace:
    """Make angular rates that resemble a hand's: noise of 1 to 12 Hz, 0.1 rad/s rms, one minute at 200 Hz."""
    rng = np.random.default_rng(seed)
    count = round(_DURATION_S * _RATE_HZ)
    freq_hz = np.fft.rfftfreq(count, 1 / _RATE_HZ)
    real, imaginary = rng.standard_normal((2, 3, freq_hz.size))
    spectrum = (real + 1j * imaginary) * np.exp(-freq_hz / _FALL_HZ) * (freq_hz > _LOW_HZ)
    rate = np.fft.irfft(spectrum, count, axis=1).T
    return GyroTrace(np.arange(count) / _RATE_HZ, _RATE_RAD_S * rate / rate.std(axis=0))


def _drawn(protocol: Protocol, trace: GyroTrace | None, rng: np.random.Generator) -> Trajectory:
    wanted = protocol.motion
    share = wanted.gyro / (wanted.gyro + wanted.boracchi_foi)
    for _ in range(_TRIES):
        if trace is not None and rng.random() < share:
            motion = random_gyro_motion(
                trace, rng, exposure_s=rng.uniform(*wanted.exposure_s), extent_px=rng.uniform(*wanted.extent_px)
            )
        else:
            motion = boracchi_foi(rng, max_length_px=wanted.max_length_px)
        if motion.frame_size() <= protocol.psf_px:
            return motion
    raise ValueError(f"motion: {_TRIES} drawn motions did not fit psf_px = {protocol.psf_px} px, make them shorter")
