"""The estimators that can be measured, by name."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lab.weights import PATH_WEIGHTS, PSF_WEIGHTS
from motdiff.estimators.base import Estimator, MotionEstimate, load_estimator
from motdiff.estimators.registry import blind_methods, make_method
from motdiff.files.plugins import is_reference
from motdiff.psf_frame import in_frame


class NetworkAlone:
    """The network's output: no scoring, no refinement, no fall-back; unchanged, or corrected by
    the second network.

    The paper measures draws of many steps; one step, as MoTDiff takes here, gives the mean guess
    and a higher MNC.

    Parameters
    ----------
    weights : path, optional
        The shipped ones when omitted.
    sampler : str
        See :func:`motdiff.network.diffusion.samples`.
    steps : int
    seed : int
    count : int
        Number of draws. The first is the estimate, which has them all where there are several.
    corrected : bool
        Whether each draw is corrected (:mod:`motdiff.network.correction`), told of the kernels of
        quick searches.
    """

    def __init__(
        self,
        weights: Path | None = None,
        *,
        sampler: str = "ddim",
        steps: int = 1,
        seed: int = 0,
        count: int = 1,
        corrected: bool = False,
    ) -> None:
        import torch

        from motdiff.network.diffusion import cosine_schedule, samples
        from motdiff.weights import load_correction, load_network

        # refuses an unknown sampler or number of steps now, not at every photo
        samples(
            lambda x, _t: x,
            (1,),
            schedule=cosine_schedule(),
            steps=steps,
            generator=torch.Generator(),
            method=sampler,
        )
        self._network = load_network() if weights is None else load_network(weights)
        if count < 1:
            raise ValueError(f"count: must be at least 1, got {count}")
        self._sampler = sampler
        self._steps = steps
        self._seed = seed
        self._count = count
        self._correction = load_correction() if corrected else None

    def estimate(self, photo: NDArray[np.float64]) -> MotionEstimate:
        """Draw motions from ``photo``, (H, W) or (H, W, 3)."""
        import torch

        from motdiff.estimators.motdiff.drawing import draw_psfs, quick_search
        from motdiff.network.correction import corrected_kernel
        from motdiff.photo_noise import noise_sigma
        from motdiff.photo_values import luminance
        from motdiff.tracing.quadratic import simplest_trajectory

        grey = luminance(photo)
        method = "network"
        sigma = noise_sigma(grey)
        classical = np.zeros((0, 64, 64))
        if self._network.physics is not None or self._correction is not None:
            classical = quick_search(grey[None], sigma=sigma)
        generator = torch.Generator().manual_seed(self._seed)
        psfs = draw_psfs(
            self._network,
            grey[None],
            classical,
            count=self._count,
            steps=self._steps,
            generator=generator,
            method=self._sampler,
        )
        if self._correction is not None:
            conditions = list(classical[:2])
            method = "networks"
            better = [
                corrected_kernel(self._correction, grey[None], psf, conditions, sigma=sigma)
                for psf in psfs
            ]
            psfs = in_frame(np.stack(better))
        psf = psfs[0]
        draws = tuple(psfs) if len(psfs) > 1 else ()
        return MotionEstimate(
            method, (simplest_trajectory(psf),), (1.0,), psf, confidence=0.0, draws=draws
        )


def split_weights(method: str) -> tuple[str, Path | None]:
    """Split ``network@FILE`` into the method and its file of weights, None
    where there is none.
    """
    name, at, file = method.partition("@")
    return (name, Path(file)) if at and name.split(":")[0] in _WITH_WEIGHTS else (method, None)


def named_estimators(methods: Sequence[str]) -> dict[str, Estimator]:
    """Make estimators by name.

    Parameters
    ----------
    methods : sequence of names in :data:`METHODS`, or of ``module:name``, see
        :func:`motdiff.estimators.base.load_estimator`

    Returns
    -------
    dict from the name to the estimator, in the order asked for

    Raises
    ------
    ValueError
        If a method is unknown.
    FileNotFoundError
        If a file of weights is missing.
    """
    return {method: _named(method) for method in methods}


def _named(method: str) -> Estimator:
    name, weights = split_weights(method)
    kind = name.split(":")[0]
    if kind not in METHODS:
        if not is_reference(method):
            raise ValueError(
                f"method: must be one of {', '.join(METHODS)}, or module:name, got {method!r}"
            )
        return load_estimator(method)
    if weights is not None and not weights.is_file():
        raise FileNotFoundError(f"{weights}: no such file of weights")
    if name in blind_methods():
        return make_method(name, {}).make()
    # of a method of the product with additions, which has none, it says which have
    return RIVALS.get(kind, RIVALS["network"]).make(name, weights)


def _parametric(_method: str, _weights: Path | None) -> Estimator:
    from lab.rivals.parametric import ParametricEstimator

    return ParametricEstimator()


def _blinddps(method: str, _weights: Path | None) -> Estimator:
    from lab.rivals.blinddps import BlindDpsEstimator, load_priors

    folder = method.partition(":")[2]
    return BlindDpsEstimator(load_priors(folder) if folder else None)


def _psf_diffusion(method: str, _weights: Path | None) -> Estimator:
    from lab.rivals.psf_diffusion import PsfDiffusionEstimator

    steps = method.partition(":")[2]
    if steps and not steps.isdigit():
        raise ValueError(f"method: must be psf-diffusion or psf-diffusion:STEPS, got {method!r}")
    return PsfDiffusionEstimator(steps=int(steps)) if steps else PsfDiffusionEstimator()


def _selfdeblur(method: str, _weights: Path | None) -> Estimator:
    from lab.rivals.selfdeblur import SelfDeblurConfig, SelfDeblurEstimator

    iterations = method.partition(":")[2]
    if iterations and not iterations.isdigit():
        raise ValueError(f"method: must be selfdeblur or selfdeblur:ITERATIONS, got {method!r}")
    config = SelfDeblurConfig(iterations=int(iterations)) if iterations else SelfDeblurConfig()
    # an interrupted evaluation resumes in the middle of its photo
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return SelfDeblurEstimator(config=config, checkpoints=cache / "motdiff" / "selfdeblur")


def _of_network(method: str, weights: Path | None) -> Estimator:
    network = partial(NetworkAlone, weights, corrected=method.startswith("networks"))
    match method.split(":"):
        case ["network" | "networks"]:
            return network()
        case ["network" | "networks", sampler, steps] if steps.isdigit():
            return network(sampler=sampler, steps=int(steps))
        case ["network" | "networks", sampler, steps, count] if (
            steps.isdigit() and count.isdigit() and int(count) > 0
        ):
            return network(sampler=sampler, steps=int(steps), count=int(count))
    options = (
        "network, network:SAMPLER:STEPS or network:SAMPLER:STEPS:DRAWS, or networks with the same"
        " additions"
    )
    raise ValueError(f"method: must be {options}, got {method!r}")


@dataclass(frozen=True, kw_only=True)
class Rival:
    """An estimator of this laboratory, all that its tables know of it.

    Attributes
    ----------
    module : str
        Whose sources, with what they import, its cells count.
    make : callable
        Returns the estimator, of its name with additions and a file of weights.
    cites : tuple of str
        Keys of ``cep/files/works.bib``.
    in_every_table : bool
        Whether it is measured where none is named.
    reason : str
        Why it is measured only when named, where a table says so.
    weights : Path or None
        Shipped weights of its own.
    samples : int or None
        That these were trained on, after a start from MoTDiff's condition network.
    of_motdiff : bool
        Whether it reads MoTDiff's weights, and others of them as ``NAME@FILE``.
    is_corrected : bool
        Whether it reads those of the second network too.
    """

    module: str
    make: Callable[[str, Path | None], Estimator]
    cites: tuple[str, ...]
    in_every_table: bool = False
    reason: str = ""
    weights: Path | None = None
    samples: int | None = None
    of_motdiff: bool = False
    is_corrected: bool = False


_NETWORK = (
    "choi2025motdiff",
    "ho2020",
    "nichol2021",
    "song2021",
    "lin2024",
    "wang2022pvt",
    "wang2022ssformer",
    "wei2020",
)
RIVALS = {
    "network": Rival(
        module="motdiff.estimators.motdiff",
        make=_of_network,
        cites=_NETWORK,
        in_every_table=True,
        of_motdiff=True,
    ),
    "networks": Rival(
        module="motdiff.estimators.motdiff",
        make=_of_network,
        cites=_NETWORK,
        of_motdiff=True,
        is_corrected=True,
    ),
    "parametric": Rival(
        module="lab.rivals.parametric",
        make=_parametric,
        cites=("zhang2022etr",),
        in_every_table=True,
        weights=PATH_WEIGHTS,
        samples=16_016,
    ),
    "psf-diffusion": Rival(
        module="lab.rivals.psf_diffusion",
        make=_psf_diffusion,
        cites=("sanghvi2024", "ho2020"),
        in_every_table=True,
        weights=PSF_WEIGHTS,
        samples=12_816,
    ),
    "selfdeblur": Rival(
        module="lab.rivals.selfdeblur",
        make=_selfdeblur,
        cites=("ren2020", "ulyanov2018"),
        reason="takes hours a photo",
    ),
    "blinddps": Rival(
        module="lab.rivals.blinddps",
        make=_blinddps,
        cites=("chung2023", "ho2020"),
        reason="needs weights, named blinddps:FOLDER",
    ),
}
"""The estimators of this laboratory, by name. Additions to it: ``network:SAMPLER:STEPS``, such as
``network:ddpm:1000``, ``psf-diffusion:STEPS`` (both take one DDIM step where none are named),
``network:SAMPLER:STEPS:DRAWS``, which measures that many draws of each photo as well, ``networks``
with the same additions, whose draws are corrected by the second network,
``selfdeblur:ITERATIONS``, and ``blinddps:FOLDER`` of weights, without which blinddps tells only
what it needs."""

METHODS = (*blind_methods(), *RIVALS)
"""The blind estimators of the product, and those of this laboratory.
``network:SAMPLER:STEPS@FILE``, or ``networks``, take other weights of MoTDiff than the
package's."""
_WITH_WEIGHTS = tuple(name for name, rival in RIVALS.items() if rival.of_motdiff)
