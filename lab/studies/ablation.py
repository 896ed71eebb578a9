"""Ablation of MoTDiff at an equal small budget: the paper's rows (f2, f4, loss, STPD) and, beside
them, physics maps.

    python -m lab.studies.ablation PHOTOS [--runs FOLDER] [--samples 1600] [--seeds 1]
    python -m lab.studies.ablation PREPARED PREPARED_VALIDATION --physics [--samples 1600]

The first form trains the paper's network (PVT v2 b0 on the photo alone, 60-px Boracchi-Foi paths).
The second trains the network for two CPU cores on samples written by ``python -m motdiff
prepare``. Every row of a seed has the same samples, order and updates; all but one thing is the
same. One thread; a row is appended to ``FOLDER/paper.jsonl`` or ``FOLDER/physics.jsonl`` as soon
as it is done, and an interrupted bench goes on where it stopped. At the end stands the table of
Markdown.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from lab.bench.statistics import mean_interval
from lab.studies.inputs import add_row, finished_rows, study_parser
from motdiff.training.batches import make_sources
from motdiff.training.config import DataConfig, TrainingConfig, read_config
from motdiff.training.run_piece import Pace, train, validation_scores

_CONFIGS = Path(__file__).parents[2] / "motdiff" / "configs"
_BATCH = 16
_VALIDATION = 192
_COMPLETE = "complete"

Scores = dict[tuple[int, str], np.ndarray]
"""Whole-pixel MNC of each held-out photo, by seed and row."""


def rows(base: TrainingConfig) -> dict[str, TrainingConfig]:
    """Name every row of the table, each one change away from ``base``."""
    settings = {
        _COMPLETE: base,
        "plain denoising loss": replace(base, loss=replace(base.loss, kind="denoising")),
        "without STPD": replace(base, loss=replace(base.loss, stpd=0.0)),
    }
    if base.network.backbone == "none":
        return settings
    scales = {
        f"{name} only": replace(base, network=replace(base.network, features=name))
        for name in ("f2", "f4")
    }
    return {**settings, **scales}


def paper(photos: str) -> TrainingConfig:
    """Take the paper's network and protocol."""
    config = read_config(_CONFIGS / "paper.toml")
    return replace(config, data=DataConfig(photos=photos, motions=config.data.motions))


def physics(prepared: str, validation: str) -> TrainingConfig:
    """Take the network that two cores can train, on prepared samples."""
    config = read_config(_CONFIGS / "cpu.toml")
    return replace(
        config, data=replace(config.data, prepared=prepared, prepared_validation=validation)
    )


def budgeted(base: TrainingConfig, *, samples: int, seed: int) -> TrainingConfig:
    """Shorten a run to so many samples; the rate falls along its cosine within them."""
    steps = max(1, samples // _BATCH)
    optimiser = replace(
        base.optimiser,
        steps=steps,
        batch=_BATCH,
        rate=1e-3,
        warm_up=steps // 20,
        ema=0.99,
        precision="bf16",
        seed=seed,
    )
    return replace(base, optimiser=optimiser)


def measured(config: TrainingConfig, folder: Path) -> np.ndarray:
    """Train a row, and score it on held-out photos with motions of their own."""
    short = replace(config, data=replace(config.data, validation=1))  # scored below, not twice
    trainer = train(short, folder, pace=Pace(validate_steps=config.optimiser.steps))
    if trainer.step < config.optimiser.steps:
        raise SystemExit(
            f"stopped at step {trainer.step} of {config.optimiser.steps}; the same command goes on"
        )
    scored = replace(config, data=replace(config.data, validation=_VALIDATION))
    return validation_scores(trainer, make_sources(scored).validation)


def read_rows(file: Path, *, samples: int) -> Scores:
    """Read the finished rows of a budget."""
    rows = [row for row in finished_rows(file) if row["samples"] == samples]
    return {(row["seed"], row["row"]): np.array(row["mnc"]) for row in rows}


def table(scores: Scores) -> Iterator[str]:
    """Lines of the table: each row's mean, and its paired difference from the complete network
    with its interval.
    """
    count = max(len(row) for row in scores.values())
    yield (
        f"| seed | row | MNC, mean of {count} | less complete, 95 % over photos"
        " |\n|---:|---|---:|---:|"
    )
    for (seed, name), row in scores.items():
        difference = ""
        if name != _COMPLETE and (seed, _COMPLETE) in scores:
            interval = mean_interval(row - scores[seed, _COMPLETE], rng=np.random.default_rng(0))
            difference = f"{interval.mean:+.3f} [{interval.low:+.3f}, {interval.high:+.3f}]"
        yield f"| {seed} | {name} | {row.mean():.3f} | {difference} |"


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument(
        "data",
        nargs="+",
        help="folder of sharp photos; or, with --physics, both folders of samples",
    )
    parser.add_argument("--physics", action="store_true")
    parser.add_argument("--runs", type=Path, default=Path("ablation"))
    parser.add_argument("--samples", type=int, default=1600)
    parser.add_argument("--seeds", type=int, default=1)
    options = parser.parse_args()
    if len(options.data) != (2 if options.physics else 1):
        parser.error(
            "give one folder of photos, or with --physics the two folders of prepared samples"
        )
    torch.set_num_threads(1)
    kind = "physics" if options.physics else "paper"
    base = physics(*options.data) if options.physics else paper(*options.data)
    file = options.runs / f"{kind}.jsonl"
    measurements = read_rows(file, samples=options.samples)
    for seed in range(options.seeds):
        for name, config in rows(budgeted(base, samples=options.samples, seed=seed)).items():
            if (seed, name) in measurements:
                continue
            folder = options.runs / kind / f"{options.samples}-{seed}-{name.replace(' ', '-')}"
            scores = measurements[seed, name] = measured(config, folder)
            line = {
                "seed": seed,
                "row": name,
                "samples": options.samples,
                "mnc": scores.round(5).tolist(),
            }
            add_row(file, line)
    print("\n".join(table(measurements)))


if __name__ == "__main__":
    main()
