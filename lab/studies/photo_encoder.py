"""What a photo encoder and a global view of the map add to the shipped weights, at an equal number
of updates.

    python -m lab.studies.photo_encoder CONFIG [--runs FOLDER] [--updates 128]

CONFIG is a run's TOML file with prepared samples, as motdiff/configs/cpu.toml. Every row goes on
from the shipped weights with the same samples in the same order: told of the physics maps, of the
photo too, or of the photo alone (all maps blanked); and with a denoiser that sees the whole map.
The figures are by kind of motion. An interrupted bench goes on where it stopped.
"""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from lab.studies.inputs import refusals, study_parser
from motdiff.metrics import mnc
from motdiff.network.denoiser import MotDiffNetwork
from motdiff.network.sampling import psfs_of_maps, sample_paths
from motdiff.training.batches import Batch, PreparedSource
from motdiff.training.config import TrainingConfig, read_config
from motdiff.training.motion_bank import drawn_kinds
from motdiff.training.prepared import read_shards
from motdiff.training.run_piece import Pace, train
from motdiff.training.samples import Samples
from motdiff.training.trainer import Trainer, loss_of
from motdiff.weights import DEFAULT_WEIGHTS

_BLANKED = 1 - 1e-9
_BATCH = 32
_STEPS = (1, 10)


def rows(base: TrainingConfig) -> dict[str, TrainingConfig]:
    """Name every row of the table."""
    encoder = replace(base, network=replace(base.network, backbone="b0", photo_pool=2))
    without_maps = replace(encoder, data=replace(base.data, physics_dropout=_BLANKED))
    wide = replace(base, network=replace(base.network, denoiser_view=1))
    return {
        "physics maps": base,
        "photo and physics maps": encoder,
        "global view": wide,
        "photo": without_maps,
    }


def held_out(config: TrainingConfig) -> dict[str, list[Batch]]:
    """Sort the prepared validation samples (shards 0, 1, 2, ...) by their kind of motion."""
    samples = read_shards(config.data.prepared_validation)
    kinds = np.array(
        drawn_kinds(config.motions, count=len(samples), seed=config.optimiser.seed + 1)
    )
    batches = {}
    for kind in sorted(set(kinds)):
        at = torch.from_numpy(np.flatnonzero(kinds == kind))
        held_samples = Samples(
            *(getattr(samples, name)[at] for name in ("photos", "kernels", "x0", "dwell"))
        )
        source = PreparedSource(held_samples, photo=True, physics=True, seed=0, symmetries=False)
        batches[kind] = source.batch(0, len(at)).split(_BATCH)
    return batches


@torch.no_grad()
def measured(trainer: Trainer, batches: list[Batch]) -> tuple[float, np.ndarray]:
    """Loss of the averaged weights, and each photo's whole-pixel MNC in one DDIM step and in ten,
    (2, N).
    """
    network = trainer.average
    assert isinstance(network, MotDiffNetwork)
    sampler = deepcopy(network)
    # as when exported
    bias = sampler.denoiser.get_parameter("output.1.bias")
    bias[0] -= math.log(trainer.config.loss.path_weight + 1)
    blank = trainer.config.data.physics_dropout == _BLANKED
    losses: list[float] = []
    scores: list[list[list[float]]] = [[] for _ in _STEPS]
    for number, batch in enumerate(batches):
        photo = None if network.photo is None else batch.photo
        physics = (
            torch.zeros_like(batch.physics)
            if blank and batch.physics is not None
            else batch.physics
        )
        conditions = Batch(photo, physics, batch.x0, batch.dwell)
        generator = torch.Generator().manual_seed(number)
        loss = [
            loss_of(
                network,
                conditions,
                trainer.config.loss,
                schedule=trainer.schedule,
                generator=generator,
            )
            for _ in range(4)
        ]
        losses += len(conditions) * [float(torch.stack([path for path, _ in loss]).mean())]
        truth = psfs_of_maps(conditions.dwell[:, 0]).double().numpy()
        for score, steps in zip(scores, _STEPS, strict=True):
            generator = torch.Generator().manual_seed(number)
            draws = sample_paths(
                sampler,
                sampler.condition(photo, physics),
                count=1,
                schedule=trainer.schedule,
                steps=steps,
                generator=generator,
            )
            psfs = draws.psfs()[:, 0]
            score.append([mnc(a, b) for a, b in zip(psfs.double().numpy(), truth, strict=True)])
    return float(np.mean(losses)), np.array([np.concatenate(score) for score in scores])


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("config", help="TOML file of a run with prepared samples")
    parser.add_argument("--runs", type=Path, default=Path("photo_encoder"))
    parser.add_argument("--updates", type=int, default=128)
    options = parser.parse_args()
    with refusals(parser):
        base = read_config(options.config)
    optimiser = replace(
        base.optimiser,
        steps=options.updates,
        warm_up=options.updates // 8,
        rate=4e-4,
        ema=0.98,
        start=str(DEFAULT_WEIGHTS),
        window=64,
        precision="bf16",
    )
    base = replace(base, optimiser=optimiser)
    batches = held_out(base)
    reference: dict[str, np.ndarray] = {}
    print("| row | motions | photos | loss | MNC, one step | ten steps | more than the start |")
    print("|---|---|---|---|---|---|---|")
    for name, config in {"start": None, **rows(base)}.items():
        folder = options.runs / name.replace(" ", "-")
        trainer = (
            Trainer(base)
            if config is None
            else train(config, folder, pace=Pace(validate_steps=options.updates))
        )
        for kind, kind_batches in batches.items():
            loss, scores = measured(trainer, kind_batches)
            gain = scores - reference.setdefault(kind, scores)
            error = gain.std(axis=1) / math.sqrt(gain.shape[1])
            means = " | ".join(f"{mean:.3f}" for mean in scores.mean(axis=1))
            gains = ", ".join(
                f"{g:+.3f} ({e:.3f})" for g, e in zip(gain.mean(axis=1), error, strict=True)
            )
            print(
                f"| {name} | {kind} | {scores.shape[1]} | {loss:.4f} | {means} | {gains} |",
                flush=True,
            )


if __name__ == "__main__":
    main()
