"""Diffusion of trajectory maps: schedule, noising, losses, samplers (DDPM, DDIM, DPM-Solver++).

The network predicts x0. At the last timestep of the cosine schedule ``alpha_bar`` is 2.4e-9: an
estimate of x0 is still well defined there, but x0 from ``eps`` would divide by 5e-5.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional

_ORDER = {"ddpm": 1, "ddim": 1, "dpm++2m": 2}  # of the extrapolation of x0 from step to step


@dataclass(frozen=True, eq=False)
class Schedule:
    """Noise schedule.

    Parameters
    ----------
    alpha_bar : (T,) float64 tensor
        Share of the signal's power left at timestep index 0..T-1 (MoTDiff's ``alpha_t`` for t =
        1..T), strictly decreasing, between 0 and 1.
    """

    alpha_bar: Tensor

    @property
    def steps(self) -> int:
        """T, the number of timesteps."""
        return len(self.alpha_bar)

    def timesteps(self, steps: int) -> tuple[int, ...]:
        """Timestep indices to visit in ``steps`` steps (1..T, else ValueError), from T-1 down.

        "Trailing" spacing: pure noise is always visited, since it is where sampling starts.

        References
        ----------
        Lin et al., "Common diffusion noise schedules and sample steps are flawed", WACV 2024,
        table 2.
        """
        if not 1 <= steps <= self.steps:
            raise ValueError(
                f"steps must be 1..{self.steps}, the schedule's timesteps; got {steps}"
            )
        return tuple(round(self.steps * i / steps) - 1 for i in range(steps, 0, -1))


def cosine_schedule(steps: int = 1000) -> Schedule:
    """Cosine schedule of T = ``steps`` timesteps.

    References
    ----------
    Nichol and Dhariwal, "Improved denoising diffusion probabilistic models", ICML 2021, eq. 17.
    """
    fraction = torch.arange(steps + 1, dtype=torch.float64) / steps
    # eq. 17; the offset s = 0.008 keeps the noise of the first steps near a pixel's quantisation
    f = torch.cos((fraction + 0.008) / 1.008 * math.pi / 2).square()
    # beta_T would be 1: alpha_bar_T = 0 has no logarithm, and sampling from it no direction
    beta = (1 - f[1:] / f[:-1]).clamp(max=0.999)
    return Schedule(torch.cumprod(1 - beta, dim=0))


def to_signal(x0: Tensor) -> Tensor:
    """Signal -1..1, which is diffused, of a trajectory map 0..1."""
    return 2 * x0 - 1


def from_signal(signal: Tensor) -> Tensor:
    """Trajectory map 0..1 of a signal -1..1."""
    return (signal + 1) / 2


def stpd(x0: Tensor, p: float, generator: torch.Generator) -> Tensor:
    """Stochastic trajectory pixel dropout: path pixels become background with probability ``p``.

    Only the network's input has these gaps; its target is ``x0``, so that it learns to close them.

    Parameters
    ----------
    x0 : tensor of any shape
        Trajectory map, 1 on the path and 0 elsewhere.
    p : float
        0..1.
    generator : torch.Generator
        On the map's device, or on the CPU for draws that do not depend on the device.

    References
    ----------
    Choi et al., "MoTDiff", arXiv:2510.26173, eq. 8 (first line).
    """
    mask = torch.rand(x0.shape, generator=generator, device=generator.device) >= p
    return torch.where(mask.to(x0.device), x0, torch.zeros_like(x0))


def q_sample(schedule: Schedule, x0: Tensor, t: Tensor, eps: Tensor) -> Tensor:
    """Noisy signal ``x_t = sqrt(alpha_bar_t) x0 + sqrt(1 - alpha_bar_t) eps``.

    Parameters
    ----------
    x0 : (B, ...) float tensor
        Clean signal, -1..1 (`to_signal`).
    t : (B,) int64 tensor
        Timestep index of each sample, 0..T-1.
    eps : (B, ...) float tensor
        Standard normal.

    References
    ----------
    Choi et al., "MoTDiff", arXiv:2510.26173, eq. 1 and eq. 8 (second line); Ho et al., NeurIPS
    2020, eq. 4.
    """
    per_sample = (-1, *(1 for _ in x0.shape[1:]))
    # 1 - alpha_bar and the roots in float64: float32 would lose the first timesteps' noise
    sqrt_alpha_bar = schedule.alpha_bar.sqrt().to(x0)[t].view(per_sample)  # (B, 1, ...)
    sqrt_one_minus = (1 - schedule.alpha_bar).sqrt().to(x0)[t].view(per_sample)
    return sqrt_alpha_bar * x0 + sqrt_one_minus * eps


# -- losses of the estimate of x0 -----------------------------------------------------------------


def structure_loss(logits: Tensor, x0: Tensor, *, path_weight: float, iou: float = 1.0) -> Tensor:
    r"""Weighted cross-entropy plus weighted intersection over union, the mean over the batch.

    With ``p = sigmoid(logits)``, sums over the pixels of one sample, and the weight (eq. 6) ::

        w     = path_weight * x0 + 1
        wBCE  = sum(w * BCE(p, x0)) / sum(w)
        wIoU  = 1 - (sum(w p x0) + 1) / (sum(w (p + x0)) - sum(w p x0) + 1)
        loss  = wBCE + wIoU                                                     (eq. 7)

    Parameters
    ----------
    logits : (B, 1, H, W) float
        The network's output, before the sigmoid.
    x0 : (B, 1, H, W) float
        True trajectory map, 1 on the path and 0 elsewhere, without dropout.
    path_weight : float
        The paper's lambda, at least 0: a path pixel counts ``path_weight + 1`` times a background
        pixel.
    iou : float
        Weight of wIoU; 1 is the paper's. With 0 and ``path_weight = 0`` the best ``p`` is the
        posterior mean that the diffusion's steps take it for; otherwise it is larger, and samples
        fill in where the path is uncertain.

    Returns
    -------
    () tensor
        float32 for float16, bfloat16 and float32 logits, also under autocast; float64 for float64.

    Raises
    ------
    ValueError
        If the shapes differ.

    References
    ----------
    Choi et al., "MoTDiff", arXiv:2510.26173, eq. 6 and 7; Wei et al., "F3Net", AAAI 2020 (pixel
    position aware loss), for the two weighted terms.
    """
    logits, x0 = _full_precision(logits, x0)
    w = path_weight * x0 + 1  # eq. 6, (B, 1, H, W)
    return (weighted_bce(logits, x0, w) + iou * weighted_iou(logits, x0, w)).mean()  # eq. 7


def weighted_bce(logits: Tensor, x0: Tensor, w: Tensor) -> Tensor:
    """``wBCE`` (B,) of `structure_loss`."""
    # F3Net's code passes `reduce='none'`, which PyTorch reads as reduce=True: it then returns the
    # batch's plain mean, the weights cancel and thin paths count for nothing. Many copies inherit
    # it. `reduction` is the right name.
    bce = functional.binary_cross_entropy_with_logits(logits, x0, reduction="none")
    return (w * bce).flatten(1).sum(1) / w.flatten(1).sum(1)


def weighted_iou(logits: Tensor, x0: Tensor, w: Tensor) -> Tensor:
    """``wIoU`` (B,) of `structure_loss`: one minus the soft intersection over union."""
    p = torch.sigmoid(logits)
    intersection = (w * p * x0).flatten(1).sum(1)  # (B,)
    total = (w * (p + x0)).flatten(1).sum(1)  # (B,)
    return 1 - (intersection + 1) / (total - intersection + 1)


def denoising_loss(logits: Tensor, x0: Tensor) -> Tensor:
    """Mean squared error of the signal: DDPM's loss, for the ablation; else as `structure_loss`.

    References
    ----------
    Ho et al., NeurIPS 2020, eq. 14, here for x0 instead of the noise; Choi et al., "MoTDiff",
    arXiv:2510.26173, ablation table, note b ("the standard denoising loss").
    """
    logits, x0 = _full_precision(logits, x0)
    return functional.mse_loss(to_signal(torch.sigmoid(logits)), to_signal(x0))


def dwell_loss(logits: Tensor, dwell: Tensor, x0: Tensor) -> Tensor:
    """Smooth L1 error of the predicted dwell, ``softplus(logits)``, on the path alone.

    The mean over the path pixels of each sample, then over the batch; a sample without a path
    contributes 0. Without dwell a map reaches MNC 0.82-0.90 at best on real hand shake.

    Parameters
    ----------
    logits : (B, 1, H, W) float
        The network's second output.
    dwell : (B, 1, H, W) float
        True time spent at each path pixel, at least 0, relative: its mean over the sample's path
        pixels is 1. Not read elsewhere.
    x0 : (B, 1, H, W) float
        True trajectory map, 1 on the path and 0 elsewhere.

    Returns
    -------
    () tensor
        In the precision of `structure_loss`.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    logits, dwell, x0 = _full_precision(logits, dwell, x0)
    path = x0 > 0.5  # (B, 1, H, W)
    # a NaN off the path would reach the gradient as 0 * NaN
    dwell = torch.where(path, dwell, torch.zeros_like(dwell))
    error = functional.smooth_l1_loss(functional.softplus(logits), dwell, reduction="none") * path
    return (error.flatten(1).sum(1) / path.flatten(1).sum(1).clamp(min=1)).mean()


def _full_precision(logits: Tensor, *targets: Tensor) -> tuple[Tensor, ...]:
    """Tensors in at least float32, the targets in the logits' type."""
    for target in targets:
        # (B, H, W) would broadcast against (B, 1, H, W) to (B, B, H, W)
        if target.shape != logits.shape:
            raise ValueError(
                f"logits must be shaped like the target, {tuple(target.shape)}; got"
                f" {tuple(logits.shape)}"
            )
    dtype = torch.promote_types(logits.dtype, torch.float32)  # 65,536 pixels overflow float16
    return logits.to(dtype), *(target.to(dtype) for target in targets)


# -- sampling -------------------------------------------------------------------------------------


def samples(
    predict_x0: Callable[[Tensor, Tensor], Tensor],
    shape: Sequence[int],
    *,
    schedule: Schedule,
    steps: int,
    generator: torch.Generator,
    method: str = "ddim",
    device: torch.device | str | None = None,
    dtype: torch.dtype = torch.float32,
) -> Iterator[Tensor]:
    """Draw signals from noise; yields the estimate of x0 at each step, the last one the result.

    Runs without gradients: a ``predict_x0`` that needs them enables them (``torch.enable_grad``).

    Parameters
    ----------
    predict_x0 : callable
        ``predict_x0(x_t, t)``: noisy signal (B, ...) and timestep index (B,) int64, 0..T-1, to
        clean signal (B, ...).
    shape : sequence of int
        (B, ...), the batch to draw.
    steps : int
        1..T network calls, at trailing timesteps (`Schedule.timesteps`).
    generator : torch.Generator
        Noise is drawn on its device and moved to ``device``: with a CPU generator it is the same
        on all devices.
    method : {"ddim", "ddpm", "dpm++2m"}
        Implicit, ancestral, or DPM-Solver++(2M), whose first step is ddim's.
    device : torch.device or str, optional
        Where to work; the generator's device unless given.
    dtype : torch.dtype
        Of all that is yielded.

    Yields
    ------
    (B, ...) tensor
        Estimate of x0, -1..1 (`from_signal`), ``steps`` times.

    Raises
    ------
    ValueError
        At the call, if ``method`` is unknown or ``steps`` is outside 1..T.

    References
    ----------
    "ddpm": Ho et al., NeurIPS 2020, eq. 6-7. "ddim": Song et al., ICLR 2021, eq. 12 and 16.
    "dpm++2m": Lu et al., arXiv:2211.01095, algorithm 2.
    """
    if method not in _ORDER:
        raise ValueError(f"method must be one of {', '.join(_ORDER)}; got {method!r}")
    timesteps = schedule.timesteps(steps)
    target = torch.device(device or generator.device)

    def noise() -> Tensor:
        return torch.randn(
            tuple(shape), generator=generator, device=generator.device, dtype=dtype
        ).to(target)

    # Song et al., section 4.1: ddim with eta = 1 is ddpm
    eta = float(method == "ddpm")
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
    x_t = noise()  # pure noise: the signal at T-1, sqrt(alpha_bar) = 5e-5 of x0, is left out
    previous: tuple[float, Tensor] | None = None  # lambda_t and x0 one step before
    for t, t_next in itertools.zip_longest(timesteps, timesteps[1:]):
        x0 = predict_x0(x_t, torch.full((len(x_t),), t, dtype=torch.int64, device=x_t.device))
        x0 = x0.to(x_t.dtype)  # (B, ...)
        yield x0
        if t_next is None:
            return
        a = alpha_bar[t]
        a_next = alpha_bar[t_next]
        D = x0  # as Lu et al. name it
        if order == 2:
            lambda_t = _half_log_snr(a)
            if previous is not None:  # line 7 of their algorithm 2; r is h_{i-1} / h_i there
                h_ratio = (_half_log_snr(a_next) - lambda_t) / (lambda_t - previous[0])
                D = x0 + h_ratio / 2 * (x0 - previous[1])
            previous = lambda_t, x0
        # Song et al., eq. 12: x_next = sqrt(a_next) x0 + sqrt(1 - a_next - sigma^2) eps + noise,
        # with eps = (x_t - sqrt(a) x0) / sqrt(1 - a) put in
        sigma2 = eta**2 * (1 - a_next) / (1 - a) * (1 - a / a_next)  # eq. 16
        eps_scale = math.sqrt(max(1 - a_next - sigma2, 0) / (1 - a))
        x_t = eps_scale * x_t + (math.sqrt(a_next) - eps_scale * math.sqrt(a)) * D
        if sigma2 > 0:
            x_t = x_t + math.sqrt(sigma2) * noise()


def _half_log_snr(alpha_bar: float) -> float:
    """``lambda = log(sqrt(alpha_bar) / sqrt(1 - alpha_bar))`` of Lu et al."""
    return 0.5 * math.log(alpha_bar / (1 - alpha_bar))
