"""Losses for thin paths: weighted cross-entropy and IoU, plain denoising loss, dwell loss."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.nn import functional

from motdiff.network.diffusion import to_signal


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
        If the shapes differ or a weight is negative.

    References
    ----------
    Choi et al., "MoTDiff", arXiv:2510.26173, eq. 6 and 7; Wei et al., "F3Net", AAAI 2020 (pixel
    position aware loss), for the two weighted terms.
    """
    for name, value in (("path_weight", path_weight), ("iou", iou)):
        if not value >= 0:
            raise ValueError(f"{name} must be at least 0, got {value}")
    logits, x0 = _full_precision(logits, x0)
    weight = path_weight * x0 + 1  # (B, 1, H, W)
    return (weighted_bce(logits, x0, weight) + iou * weighted_iou(logits, x0, weight)).mean()


def weighted_bce(logits: Tensor, x0: Tensor, weight: Tensor) -> Tensor:
    """``wBCE`` (B,) of `structure_loss`."""
    # F3Net's code passes `reduce='none'`, which PyTorch reads as reduce=True: it then returns the
    # batch's plain mean, the weights cancel and thin paths count for nothing. Many copies inherit
    # it. `reduction` is the right name.
    loss = functional.binary_cross_entropy_with_logits(logits, x0, reduction="none")
    return (weight * loss).flatten(1).sum(1) / weight.flatten(1).sum(1)


def weighted_iou(logits: Tensor, x0: Tensor, weight: Tensor) -> Tensor:
    """``wIoU`` (B,) of `structure_loss`: one minus the soft intersection over union."""
    p = torch.sigmoid(logits)
    intersection = (weight * p * x0).flatten(1).sum(1)  # (B,)
    total = (weight * (p + x0)).flatten(1).sum(1)  # (B,)
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
