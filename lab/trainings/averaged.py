"""What the trainings' networks share: random weights by a seed, and their running average."""

from __future__ import annotations

import copy
from collections.abc import Callable
from contextlib import nullcontext
from typing import Generic, TypeVar

import torch
from torch import nn

from motdiff.training.trainer import follow

_Network = TypeVar("_Network", bound=nn.Module)


class AveragedNetwork(Generic[_Network]):
    """A network in training, and the running average of its weights, which is exported.

    Parameters
    ----------
    build : callable
        Builds the network with random weights.
    seed : int
        Of these weights.
    device : str or torch.device
    old_share : float
        Share of the old weights in the average, once there are enough of them.

    Attributes
    ----------
    average : network
        In eval mode.
    step : int
        Updates done.
    """

    def __init__(
        self,
        build: Callable[[], _Network],
        *,
        seed: int,
        device: str | torch.device,
        old_share: float,
    ) -> None:
        self.device = torch.device(device)
        # the caller's global generator stays as it is
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(seed)
            self.network = build().to(self.device)
        self.average = copy.deepcopy(self.network).eval().requires_grad_(False)
        self.step = 0
        self._old_share = old_share

    def advance(self) -> None:
        """Take the weights of an update into the average."""
        follow(self.average, self.network, old_share=self._old_share, step=self.step)
        self.step += 1

    def single_or_bf16(self) -> torch.autocast | nullcontext[None]:
        """Context of a forward pass: in bfloat16 on a GPU, else in single precision."""
        if self.device.type == "cuda":
            return torch.autocast("cuda", dtype=torch.bfloat16)
        return nullcontext()


def set_rate(adam: torch.optim.Optimizer, rate: float) -> None:
    """Set the step size of all parameters."""
    for group in adam.param_groups:
        group["lr"] = rate
