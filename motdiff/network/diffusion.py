"""Diffusion process of trajectory maps: schedules, noising, and samplers (DDPM, DDIM,
DPM-Solver++).

Everything is in x0 form. At the last timestep of the cosine schedule ``alpha_bar`` is 2.4e-9,
where a guess of x0 is still well defined but one of the noise would be divided by 5e-5.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True, eq=False)
class Schedule:
    """Noise schedule: share of the signal's power at each timestep.

    Parameters
    ----------
    alpha_bar : (T,) float64 tensor
        Share of the signal's power left at timestep index 0..T-1 (the paper's ``alpha_t`` for t =
        1..T), strictly decreasing, between 0 and 1.

    Raises
    ------
    ValueError
        If ``alpha_bar`` is anything else.
    """

    alpha_bar: Tensor

    def __post_init__(self) -> None:
        a = self.alpha_bar
        if a.ndim != 1 or a.dtype != torch.float64:
            raise ValueError(
                f"alpha_bar must be a (T,) float64 tensor, got {tuple(a.shape)} {a.dtype}"
            )
        if not (len(a) and a[-1] > 0 and a[0] < 1 and (a.diff() < 0).all()):
            raise ValueError(
                "alpha_bar must decrease strictly inside (0, 1), as cosine_schedule() does"
            )

    @property
    def steps(self) -> int:
        """T, the number of timesteps."""
        return len(self.alpha_bar)

    def timesteps(self, steps: int) -> tuple[int, ...]:
        """Timestep indices to visit in ``steps`` steps, from T-1 downwards.

        "Trailing" spacing: pure noise is always visited, since it is where sampling starts.

        Parameters
        ----------
        steps : int
            1..T.

        Raises
        ------
        ValueError
            If ``steps`` is outside 1..T.

        References
        ----------
        Lin et al., "Common diffusion noise schedules and sample steps are flawed", WACV 2024,
        table 2.
        """
        if not 1 <= steps <= self.steps:
            raise ValueError(
                f"steps must be 1..{self.steps}, the schedule's timesteps; got {steps}"
            )
        return tuple(round(self.steps * left / steps) - 1 for left in range(steps, 0, -1))


def cosine_schedule(steps: int = 1000) -> Schedule:
    """Cosine schedule, with each step's noise ``beta`` clipped at 0.999.

    Parameters
    ----------
    steps : int
        T, at least 1.

    Raises
    ------
    ValueError
        If ``steps`` is below 1.

    References
    ----------
    Nichol and Dhariwal, "Improved denoising diffusion probabilistic models", ICML 2021, eq. 17.
    """
    if steps < 1:
        raise ValueError(f"steps must be at least 1, got {steps}")
    fraction = torch.arange(steps + 1, dtype=torch.float64) / steps
    signal_power = torch.cos((fraction + 0.008) / 1.008 * math.pi / 2).square()
    beta = (1 - signal_power[1:] / signal_power[:-1]).clamp(max=0.999)
    return Schedule(torch.cumprod(1 - beta, dim=0))


def to_signal(x0: Tensor) -> Tensor:
    """Trajectory map, 0..1, as the signal that is diffused, -1..1."""
    return 2 * x0 - 1


def from_signal(signal: Tensor) -> Tensor:
    """Signal, -1..1, as a trajectory map, 0..1."""
    return (signal + 1) / 2


def stochastic_trajectory_pixel_dropout(
    x0: Tensor, p: float, generator: torch.Generator
) -> Tensor:
    """Trajectory map with gaps: each path pixel becomes background with probability ``p`` (STPD).

    Only the network's input is built from this map. Its target stays the whole one, so that it
    learns to close gaps.

    Parameters
    ----------
    x0 : tensor of any shape
        Trajectory map, 1 on the path and 0 elsewhere.
    p : float
        0..1; 0 gives the map itself.
    generator : torch.Generator
        On the map's device, or on the CPU for draws that do not depend on the device.

    Raises
    ------
    ValueError
        If ``p`` is outside 0..1.

    References
    ----------
    Choi et al., "MoTDiff", arXiv:2510.26173, eq. 8 (first line).
    """
    if not 0 <= p <= 1:
        raise ValueError(f"p must be a probability, 0..1; got {p}")
    kept = torch.rand(x0.shape, generator=generator, device=generator.device) >= p
    return torch.where(kept.to(x0.device), x0, torch.zeros_like(x0))


def q_sample(schedule: Schedule, signal: Tensor, t: Tensor, noise: Tensor) -> Tensor:
    """Noisy signal ``sqrt(alpha_bar[t]) signal + sqrt(1 - alpha_bar[t]) noise``.

    Parameters
    ----------
    schedule : Schedule
    signal : (B, ...) float tensor
        Clean signal, -1..1 (`to_signal`).
    t : (B,) int64 tensor
        Timestep index of each sample, 0..T-1.
    noise : (B, ...) float tensor
        Standard normal, shaped like ``signal``.

    Raises
    ------
    ValueError
        If the shapes do not fit.

    References
    ----------
    Choi et al., "MoTDiff", arXiv:2510.26173, eq. 1 and eq. 8 (second line); Ho et al., NeurIPS
    2020, eq. 4.
    """
    if t.shape != signal.shape[:1]:
        raise ValueError(
            f"t must hold one timestep per sample, shape {tuple(signal.shape[:1])}; got"
            f" {tuple(t.shape)}"
        )
    if noise.shape != signal.shape:
        raise ValueError(
            f"noise must be shaped like the signal, {tuple(signal.shape)}; got"
            f" {tuple(noise.shape)}"
        )
    per_sample = (-1, *(1 for _ in signal.shape[1:]))
    kept = (
        schedule.alpha_bar.sqrt().to(signal)[t].view(per_sample)
    )  # (B, 1, ...); roots and 1 - a in float64
    added = (1 - schedule.alpha_bar).sqrt().to(signal)[t].view(per_sample)  # (B, 1, ...)
    return kept * signal + added * noise


# One step serves all methods: from x_t and the estimate x0 to the next, less noisy timestep t',
# x_t' = sqrt(a') x0 + sqrt(1 - a' - sigma^2) eps + sigma noise,      eps = (x_t - sqrt(a) x0) /
# sqrt(1 - a),
# sigma = eta sqrt((1 - a') / (1 - a) (1 - a / a')),                  a = alpha_bar[t], a' =
# alpha_bar[t'], where a method of order 2 extrapolates x0 along log(SNR) with the step before.
#
# method     eta     order   description ddpm       1       1       ancestral sampling with the
# posterior's variance: Ho et al. 2020, eq. 6-7 ddim       0..1    1       Song et al., ICLR 2021,
# eq. 12 and 16; eta = 0 is deterministic, eta = 1 is ddpm dpm++2m    0       2
# DPM-Solver++(2M): Lu et al., arXiv:2211.01095, algorithm 2; its first step is ddim's
_ORDER = {"ddpm": 1, "ddim": 1, "dpm++2m": 2}


def samples(
    predict_x0: Callable[[Tensor, Tensor], Tensor],
    shape: Sequence[int],
    *,
    schedule: Schedule,
    steps: int,
    generator: torch.Generator,
    method: str = "ddim",
    eta: float = 0.0,
    device: torch.device | str | None = None,
    dtype: torch.dtype = torch.float32,
) -> Iterator[Tensor]:
    """Draw signals from noise; yields the estimate of x0 at each step, and the last one is the
    result.

    Runs without gradients: a ``predict_x0`` that needs them turns them on itself
    (``torch.enable_grad``).

    Parameters
    ----------
    predict_x0 : callable
        ``predict_x0(x_t, t)``: noisy signal (B, ...) and timestep index (B,) int64, 0..T-1, to
        clean signal (B, ...).
    shape : sequence of int
        (B, ...), the batch to draw.
    schedule : Schedule
    steps : int
        1..T network calls, at trailing timesteps (`Schedule.timesteps`).
    generator : torch.Generator
        Noise is drawn on its device and moved to ``device``: with a CPU generator it is the same
        on all devices.
    method : {"ddim", "ddpm", "dpm++2m"}
        See the table above this function in the source.
    eta : float
        Noise put back in "ddim", 0 (none) to 1 (as much as "ddpm"). The other methods fix it.
    device : torch.device or str, optional
        Where to work; the generator's device unless given.
    dtype : torch.dtype
        Of all that is yielded.

    Yields
    ------
    (B, ...) tensor
        The estimate of x0 as ``predict_x0`` gave it, -1..1 (`from_signal`), ``steps`` times.

    Raises
    ------
    ValueError
        At the call, if ``method`` is unknown, ``steps`` is outside 1..T, or ``eta`` is outside
        0..1 or given to a method that fixes it.
    """
    if method not in _ORDER:
        raise ValueError(f"method must be one of {', '.join(_ORDER)}; got {method!r}")
    if not 0 <= eta <= 1:
        raise ValueError(f"eta must be 0..1, got {eta}")
    if eta and method != "ddim":
        raise ValueError(f"eta must be left out with {method}, which fixes it; got {eta}")
    timesteps = schedule.timesteps(steps)
    place = torch.device(generator.device if device is None else device)
    eta = 1.0 if method == "ddpm" else eta

    def noise() -> Tensor:
        return torch.randn(
            tuple(shape), generator=generator, device=generator.device, dtype=dtype
        ).to(place)

    return _descend(predict_x0, noise, timesteps, schedule.alpha_bar.tolist(), eta, _ORDER[method])


@torch.no_grad()
def _descend(
    predict_x0: Callable[[Tensor, Tensor], Tensor],
    noise: Callable[[], Tensor],
    timesteps: Sequence[int],
    alpha_bar: Sequence[float],
    eta: float,
    order: int,
) -> Iterator[Tensor]:
    x = (
        noise()
    )  # (B, ...) pure noise: what the signal adds at T-1, sqrt(alpha_bar) = 5e-5, is left out
    earlier: tuple[float, Tensor] | None = None  # log(SNR) / 2 and x0 one step before
    for t, following in itertools.zip_longest(timesteps, timesteps[1:]):
        x0 = predict_x0(x, torch.full((len(x),), t, dtype=torch.int64, device=x.device)).to(
            x.dtype
        )  # (B, ...)
        yield x0
        if following is None:
            return
        now = alpha_bar[t]
        then = alpha_bar[following]
        ahead = x0
        if order == 2:
            if earlier is not None:
                ratio = (_half_log_snr(then) - _half_log_snr(now)) / (
                    _half_log_snr(now) - earlier[0]
                )
                ahead = x0 + ratio / 2 * (x0 - earlier[1])
            earlier = _half_log_snr(now), x0
        variance = eta**2 * (1 - then) / (1 - now) * (1 - now / then)
        kept = math.sqrt(max(1 - then - variance, 0) / (1 - now))
        x = kept * x + (math.sqrt(then) - kept * math.sqrt(now)) * ahead
        if variance > 0:
            x = x + math.sqrt(variance) * noise()


def _half_log_snr(alpha_bar: float) -> float:
    return 0.5 * math.log(alpha_bar / (1 - alpha_bar))
