"""Ablation of MoTDiff at an equal small budget: the paper's rows (f2, f4, loss, STPD) and, beside them, physics maps.

    python benchmarks/ablation.py PHOTOS [--runs FOLDER] [--samples 3200]
    python benchmarks/ablation.py PREPARED PREPARED_VALIDATION --physics [--samples 12800]

The first form trains the paper's network (PVT v2 b0 on the photo alone, 60-px Boracchi-Foi paths). The second trains
the network for two CPU cores on samples written by ``python -m motdiff prepare``. Every row has the same samples, order
and updates; all but one thing is the same. An interrupted bench goes on where it stopped.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from motdiff.training.config import DataConfig, TrainingConfig, read_config
from motdiff.training.run import Pace, make_sources, train, validation_mnc

_CONFIGS = Path(__file__).parents[1] / "motdiff" / "configs"
_BATCH = 16
_VALIDATION = 96


def rows(base: TrainingConfig) -> dict[str, TrainingConfig]:
    """Name every row of the table, each one change away from ``base``."""
    loss = {
        "complete": base,
        "plain denoising loss": replace(base, loss=replace(base.loss, kind="denoising")),
        "without STPD": replace(base, loss=replace(base.loss, stpd=0.0)),
    }
    if base.network.backbone == "none":
        return loss
    scales = {f"{name} only": replace(base, network=replace(base.network, features=name)) for name in ("f2", "f4")}
    return {**loss, **scales}


def paper(photos: str) -> TrainingConfig:
    """Take the paper's network and protocol."""
    config = read_config(_CONFIGS / "paper.toml")
    return replace(config, data=DataConfig(photos=photos, motions=1000, validation=_VALIDATION))


def physics(prepared: str, validation: str) -> TrainingConfig:
    """Take the network that two cores can train, on prepared samples."""
    config = read_config(_CONFIGS / "cpu.toml")
    data = replace(config.data, prepared=prepared, prepared_validation=validation, validation=_VALIDATION)
    return replace(config, data=data)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("data", nargs="*", help="folder of sharp photos; or, with --physics, both folders of samples")
    parser.add_argument("--physics", action="store_true")
    parser.add_argument("--runs", type=Path, default=Path("ablation"))
    parser.add_argument("--samples", type=int, default=3200)
    options = parser.parse_args()
    if not options.data:
        print("skipped: it needs a folder of sharp photos, see --help")
        return
    if len(options.data) != (2 if options.physics else 1):
        parser.error("give one folder of photos, or with --physics the two folders of prepared samples")
    base = physics(*options.data) if options.physics else paper(*options.data)
    steps = max(1, options.samples // _BATCH)
    base = replace(
        base,
        optimiser=replace(
            base.optimiser, steps=steps, batch=_BATCH, rate=1e-3, warm_up=steps // 20, ema=0.99, precision="fp32"
        ),
    )
    print(f"| row ({steps * _BATCH} samples each) | validation MNC, whole-pixel, mean of {_VALIDATION} |\n|---|---|")
    for name, config in rows(base).items():
        folder = options.runs / ("physics" if options.physics else "paper") / name.replace(" ", "-")
        trainer = train(config, folder, pace=Pace(validate_steps=steps))
        print(f"| {name} | {validation_mnc(trainer, make_sources(config).validation):.3f} |", flush=True)


if __name__ == "__main__":
    main()
