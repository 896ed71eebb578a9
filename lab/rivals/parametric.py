"""Parametric baseline, of Motion-ETR's class: a network predicts one quadratic path of a photo."""

from __future__ import annotations

import itertools
from pathlib import Path

import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from lab.rivals.conditioning import conditioning_maps
from lab.weights import PATH_WEIGHTS
from motdiff.estimators.base import MotionEstimate
from motdiff.network.condition import ConditionNetwork
from motdiff.network.config import NetworkConfig
from motdiff.psf_frame import PSF_PX
from motdiff.tracing.quadratic import QuadraticPath
from motdiff.weights import network_config
from motdiff.weights_io import filled

_SCALE_PX = 16.0  # of a coefficient where the output is 1
_HIDDEN = 128


class PathHead(nn.Module):
    """Coefficients (B, 2, 2) of a path, px, from a condition (B, C, 64, 64).

    A path and its reverse, ``a -> -a``, look the same. So the complex square ``a^2 / |a|`` is
    predicted, which they share: a network cannot jump from one sign to the other between photos
    that are nearly alike.

    Parameters
    ----------
    channels : int
        Channels of the condition, a multiple of 8.
    """

    def __init__(self, channels: int) -> None:
        super().__init__()
        widths = (channels, channels, 32, 32)
        layers: list[nn.Module] = []
        for inputs, outputs in itertools.pairwise(widths):
            layers += [nn.GroupNorm(8, inputs), nn.SiLU(), nn.Conv2d(inputs, outputs, 3, 2, 1)]
        self.narrow = nn.Sequential(*layers)  # (B, 32, 8, 8)
        self.hidden = nn.Linear(widths[-1] * (PSF_PX // 8) ** 2, _HIDDEN)
        self.output = nn.Linear(_HIDDEN, 4)
        nn.init.normal_(self.output.weight, std=0.02)
        # no gradient leads away from a = 0
        self.output.bias = nn.Parameter(torch.tensor([0.5, 0.0, 0.0, 0.0]))

    def forward(self, condition: Tensor) -> Tensor:
        """Coefficients (B, 2, 2), px: ``a`` and ``b`` of
        :class:`~motdiff.tracing.quadratic.QuadraticPath`, x before y.
        """
        hidden = nn.functional.silu(self.hidden(self.narrow(condition).flatten(1)))
        real, imaginary, *bend = (_SCALE_PX * self.output(hidden)).unbind(dim=1)
        length = torch.sqrt(real.square() + imaginary.square() + 1e-6)
        half_rad = torch.atan2(imaginary, real) / 2
        drift = torch.stack([length * half_rad.cos(), length * half_rad.sin()], dim=1)
        return torch.stack([drift, torch.stack(bend, dim=1)], dim=1)


class PathNetwork(ConditionNetwork):
    """Quadratic path from photo and physics maps, by the condition network of MoTDiff.

    Parameters
    ----------
    config : NetworkConfig
        Sizes; kept as `config`. Its target is "path".

    References
    ----------
    Zhang, Wang, Maybank, Tao, "Exposure trajectory recovery from motion blur", TPAMI 2022
    (Motion-ETR: per pixel, with a photo encoder of its own; here one path per photo).
    """

    def __init__(self, config: NetworkConfig) -> None:
        super().__init__(config)
        self.head = PathHead(self.condition_channels)

    def forward(self, photo: Tensor | None = None, physics: Tensor | None = None) -> Tensor:
        """Coefficients (B, 2, 2), px, of the path in each photo."""
        coefficients: Tensor = self.head(self.condition(photo, physics))
        return coefficients


def load_path_network(path: Path | str) -> PathNetwork:
    """Build a weights file's network of quadratic paths, in eval mode and float32.

    Raises
    ------
    ValueError
        If the file is not one of ours, or predicts something else.
    """
    return filled(PathNetwork(network_config(path, target="path")), path)


class ParametricEstimator:
    """Blind estimator of Motion-ETR's class: one quadratic path, predicted directly and not
    refined.

    It has the condition network of the shipped MoTDiff and started from its former weights. Its
    output and its training differ: the shipped one saw 16,016 samples drawn from 704 prepared
    ones, MoTDiff 209,600 from 13,376. The limit of the class is
    :func:`~lab.evaluation.quadratic_limits.most_alike_quadratic`.

    Parameters
    ----------
    weights : path, optional
        A file from ``python -m motdiff export`` of a run with target "path"; the shipped one when
        omitted.

    References
    ----------
    Zhang, Wang, Maybank, Tao, "Exposure trajectory recovery from motion blur", TPAMI 2022.
    """

    def __init__(self, *, weights: Path | str | None = None) -> None:
        self._network = load_path_network(PATH_WEIGHTS if weights is None else weights)

    def estimate(self, photo: ArrayLike) -> MotionEstimate:
        """Predict the path in ``photo``, (H, W) or (H, W, 3), linear light 0..1; see
        :func:`conditioning_maps`.

        The path is not scored: ``confidence`` is 0.
        """
        with torch.no_grad():
            drift, bend = self._network(None, conditioning_maps(photo))[0].double().numpy()
        path = QuadraticPath(drift, bend)
        trajectory = path.trajectory()
        return MotionEstimate(
            "parametric",
            (trajectory,),
            (1.0,),
            trajectory.psf(trajectory.frame_size(PSF_PX)),
            confidence=0.0,
            details={"a_px": path.a.tolist(), "b_px": path.b.tolist()},
        )
