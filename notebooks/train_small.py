# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#       format_version: '1.3'
#       jupytext_version: 1.19.6
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Train a small MoTDiff
#
# **Question.** How does a network learn to draw the path of a motion from one blurred photo?
# **Answer.** From simulated photos. A diffusion model learns to remove noise from a map of the
# path, given the photo's correlations, in which a blur leaves its trace. This one has 130,000
# weights and straight motions only, and learns for a quarter of a minute: enough to see the loss
# fall and a path drawn, too little for use.

# %% [markdown]
# ## Simulated photos
#
# Scenes of scikit-image, straight motions of 12 to 20 px. `x0` is what the network should draw:
# the path on a grid of 1/4 px.

# %%
import numpy as np
import torch
from matplotlib import pyplot as plt
from skimage import data

from motdiff.network.config import NetworkConfig
from motdiff.network.physics_maps import spectral_maps
from motdiff.network.sampling import sample_paths
from motdiff.training.batches import Batch
from motdiff.training.config import DataConfig, LossConfig, OptimiserConfig, TrainingConfig
from motdiff.training.motion_bank import MotionMix, build_bank
from motdiff.training.samples import simulate
from motdiff.training.simulation import Photography
from motdiff.training.trainer import Trainer

torch.set_num_threads(1)
torch.set_flush_denormal(True)
SEEN, UNSEEN, STEPS = 64, 8, 90
pictures = (data.astronaut(), data.coffee(), data.rocket())
scenes = [
    torch.from_numpy(np.ascontiguousarray(picture.transpose(2, 0, 1))) for picture in pictures
]
mix = MotionMix(boracchi_foi=0, straight=1.0, quadratic=0, min_length_px=12, max_length_px=20)
bank = build_bank(mix, count=SEEN + UNSEEN, seed=1)
photography = Photography(most_noise=0.01, wrong_gamma=0, jpeg=0)
samples = simulate(
    bank, scenes, torch.arange(len(bank)), photography=photography, physics=False, seed=1
)
assert samples.photos.shape[0] == SEEN + UNSEEN

# %% [markdown]
# ## What the network sees
#
# Not the photo itself but correlations of its gradients: along the motion a blurred photo
# resembles itself.

# %%
maps = torch.cat(
    [spectral_maps(part.mean(dim=1, keepdim=True)) for part in samples.photos.split(8)]
)
figure, axes = plt.subplots(1, 3, figsize=(10, 3.6), layout="constrained")
axes[0].imshow(samples.photos[0].permute(1, 2, 0).numpy().clip(0, 1) ** (1 / 2.2))
axes[0].set(title="a blurred photo", xticks=[], yticks=[])
axes[1].imshow(maps[0, 0], cmap="gray", extent=(-32, 32, 32, -32))
axes[1].set(title="its correlation map", xlabel="lag x, px", ylabel="lag y, px")
axes[2].imshow(samples.x0[0, 0], cmap="gray", extent=(-32, 32, 32, -32))
axes[2].set(title="the path to draw", xlabel="x, px", ylabel="y, px")
assert bool(((samples.x0 == 0) | (samples.x0 == 1)).all())

# %% [markdown]
# ## Training
#
# Each step noises the maps of eight samples to a random degree, and the network predicts the clean
# ones.

# %%
network = NetworkConfig(
    backbone="none", physics_channels=2, physics_width=16, physics_depth=1, physics_patch=2,
    denoiser_width=32, decoder_widths=(32, 16), dropout=0.0, time_width=128,
)  # fmt: skip
optimiser = OptimiserConfig(
    steps=STEPS, batch=8, rate=8e-3, last_rate=1e-5, warm_up=10, ema=0.97, window=32, seed=0
)
config = TrainingConfig(
    DataConfig(photos="scikit-image", physics_dropout=0),
    network=network,
    loss=LossConfig(path_weight=1),
    optimiser=optimiser,
)
trainer = Trainer(config)


class Drawn:
    """Random samples among those to learn from."""

    def batch(self, step, size, *, rank=0):  # noqa: ARG002
        index = torch.randperm(SEEN, generator=torch.Generator().manual_seed(step))[:size]
        return Batch(None, maps[index], samples.x0[index], samples.dwell[index])


losses = np.array([trainer.update(Drawn()).total for _ in range(STEPS)])
smooth = np.convolve(losses, np.ones(15) / 15, mode="valid")
figure, axes = plt.subplots(figsize=(7, 3.4), layout="constrained")
axes.plot(losses, color="0.8", label="each step")
axes.plot(np.arange(smooth.size) + 7, smooth, label="mean of 15")
axes.set(
    xlabel="step",
    ylabel="loss",
    title=f"{sum(p.numel() for p in trainer.network.parameters()):,} weights",
)
axes.legend()
assert losses[-15:].mean() < 0.75 * losses[:15].mean()

# %% [markdown]
# ## A draw
#
# From pure noise, in eight steps, for photos that it has not seen. The check is that the draw
# follows the photo: given the maps of another photo it draws another path.


# %%
def draw(condition_maps):
    with torch.no_grad():
        condition = trainer.average.condition(None, condition_maps)
    generator = torch.Generator().manual_seed(0)
    return sample_paths(
        trainer.average,
        condition,
        count=1,
        schedule=trainer.schedule,
        steps=8,
        generator=generator,
    ).path


def overlap(path, truth):
    """Common pixels of two paths, as a share of all their pixels; mean over the photos."""
    found, true = path > 0.5, truth > 0.5
    return float(((found & true).sum(dim=(1, 2, 3)) / (found | true).sum(dim=(1, 2, 3))).mean())


truth = samples.x0[SEEN:]
own, others = draw(maps[SEEN:]), draw(maps[SEEN:].roll(1, dims=0))
print(
    f"overlap with the true path {overlap(own, truth):.2f}; given another photo"
    f" {overlap(others, truth):.2f}"
)
assert overlap(own, truth) > 2 * overlap(others, truth)
figure, axes = plt.subplots(
    2, 4, figsize=(10, 5.2), layout="constrained", sharex=True, sharey=True
)
for column in range(4):
    for row, picture in enumerate((truth, own)):
        axes[row, column].imshow(
            picture[column, 0], cmap="gray", extent=(-32, 32, 32, -32), vmin=0, vmax=1
        )
axes[0, 0].set(ylabel="true path, y in px")
_ = axes[1, 0].set(ylabel="drawn path, y in px", xlabel="x, px")

# %% [markdown]
# The shipped network has the same parts and learned for hours from other motions: `python -m
# motdiff train motdiff/configs/cpu.toml -o run`. [Its card](../motdiff/weights/README.md) says
# what it can do and what it cannot.
