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
# # Our PSF in scikit-image and deepinv, and their restorations in our table
#
# **Question.** Do the PSFs of this package work elsewhere, and other restorations here?
# **Answer.** Yes. A coded PSF is a plain array: the photo is its true convolution with the scene.
# It sums to the open share of the exposure, where other libraries expect 1. A restoration is any
# function of (photo, psf): named as `module:name` it takes the place of ours in the table of
# codes.

# %% [markdown]
# ## The convention
#
# Zero displacement lies at index `size // 2`, x to the right, y down. The PSF sums to the duty of
# the code: a coded photo is darker.

# %%
import sys
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from scipy.signal import fftconvolve
from skimage import data, restoration

import cep
from lab.bench.coded.protocol import coded_protocol
from lab.bench.coded.run import measure_coded
from lab.bench.datasets import bundled_photos, labels_of, pick
from lab.bench.statistics import crossed_interval
from lab.jobs.engine import Engine

path = cep.Trajectory.from_samples([[0, 0], [9, 3], [14, 12]])
code = cep.load_code("barker-13")
psf = cep.coded_psf(path, code, size=33)
scene = data.camera()[100:356, 90:346] / 255
ideal = cep.Camera(photons_full_scale=1e9, read_noise_e=0, bits=16)
photo = cep.capture(scene, psf, camera=ideal, rng=np.random.default_rng(0))
figure, axes = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
shown = axes[0].imshow(psf, cmap="gray", extent=(-16.5, 16.5, 16.5, -16.5))
axes[0].set(title=f"the PSF, sum {psf.sum():.3f}", xlabel="x, px", ylabel="y, px")
figure.colorbar(shown, ax=axes[0], label="share of the exposure")
axes[1].imshow(photo, cmap="gray", vmin=0, vmax=1)
axes[1].set(title="coded photo", xticks=[], yticks=[])
assert abs(psf.sum() - code.duty) < 1e-9
assert np.abs(photo - fftconvolve(scene, psf, mode="valid")).max() < 3e-4

# %% [markdown]
# ## scikit-image
#
# It restores with PSFs of sum 1: divide both the photo and the PSF by the duty. Its Wiener filter
# takes the photo as one period of a pattern, so the photo is mirrored at its borders first.

# %%
camera = cep.Camera(photons_full_scale=30_000, read_noise_e=5)
noisy = cep.capture(scene, psf, camera=camera, rng=np.random.default_rng(0))
truth, inner = scene[16:-16, 16:-16], slice(32, -32)
bright, unit = noisy / code.duty, psf / code.duty


def psnr_db(image):
    return -10 * np.log10(np.mean((image[inner, inner] - truth[inner, inner]) ** 2))


def mirrored_wiener(photo, psf):
    light = psf.sum()
    wide = np.pad(photo / light, 48, mode="reflect")
    return restoration.wiener(wide, psf / light, balance=0.3, clip=False)[48:-48, 48:-48]


views = {
    "coded photo": bright,
    "ours, Wiener": cep.restore(noisy, psf, method="wiener", camera=camera).image,
    "scikit-image, Wiener": mirrored_wiener(noisy, psf),
    "scikit-image, Richardson-Lucy": restoration.richardson_lucy(bright, unit, num_iter=30),
}
figure, axes = plt.subplots(1, 4, figsize=(13, 3.7), layout="constrained")
for view, (name, image) in zip(axes, views.items(), strict=True):
    view.imshow(image[inner, inner], cmap="gray", vmin=0, vmax=1)
    view.set(title=f"{name}\n{psnr_db(image):.1f} dB", xticks=[], yticks=[])
    assert image is bright or psnr_db(image) > psnr_db(bright) + 2

# %% [markdown]
# Richardson-Lucy takes the scene beyond the photo for dark, which does not matter in the middle of
# a photo and a lot at its borders. Any function of (photo, psf) is a restoration of ours:

# %%
own = cep.restore(noisy, psf, method=mirrored_wiener)
assert np.allclose(own.image, views["scikit-image, Wiener"])

# %% [markdown]
# ## A row in our table
#
# [Table III](table_three.py) compares codes by restored photos. Its protocol names the
# restoration, which may be a function of another library. There photo and PSF already have the
# scale that scikit-image expects.
#
# scikit-image's Richardson-Lucy is named as it is. A second one mirrors the photo at its borders
# first: a module of four lines. In the shell: `python -m lab bench cep --set
# restoration=mymodule:mirrored_lucy`.

# %%
MODULE = """
import numpy as np
from skimage.restoration import richardson_lucy

def mirrored_lucy(photo, psf):
    return richardson_lucy(np.pad(photo, 64, mode="symmetric"), psf, num_iter=30)[64:-64, 64:-64]
"""

files = pick(bundled_photos(), 3, least_px=160)
photos = dict(zip(labels_of(files), files, strict=True))
psnr, keys = {}, [(photo, motion) for photo in photos for motion in range(3)]
with tempfile.TemporaryDirectory() as folder:
    Path(folder, "mymodule.py").write_text(MODULE)
    sys.path.append(folder)
    for method in ("wiener", "skimage.restoration:richardson_lucy", "mymodule:mirrored_lucy"):
        protocol = coded_protocol(
            "paper", ["photos=3", "motions=3", "crop_px=160", f"restoration={method}"]
        )
        table = measure_coded(
            protocol, photos, engine=Engine(Path(folder, "cells")), designs=["open", "raskar-52"]
        )
        assert not table.outcome.failures
        found = {
            (shot.design, shot.photo, shot.motion): shot.figures["psnr_db"] for shot in table.shots
        }
        psnr[method] = {
            name: np.array([found[name, *key] for key in keys]) for name in ("open", "raskar-52")
        }
    sys.path.remove(folder)

print(f"{'PSNR in dB, mean of 9 photos':38}  open  raskar-52")
for method, row in psnr.items():
    print(f"{method:38} {row['open'].mean():5.1f} {row['raskar-52'].mean():8.1f}")

# %% [markdown]
# Nine small photos are too few to compare codes, but enough for this: through the code of 2006,
# Richardson-Lucy is worse than our Wiener filter. That one knows the camera's noise and continues
# the photo beyond its borders. Nearly half of the loss comes from the borders, as the mirrored one
# shows.

# %%
coded = {method: row["raskar-52"] for method, row in psnr.items()}
lost = {}
for method in list(coded)[1:]:
    lost[method] = crossed_interval(coded["wiener"] - coded[method], *zip(*keys, strict=True))
    print(
        f"{method:38} {lost[method].mean:.1f} dB worse ({lost[method].low:.1f} to"
        f" {lost[method].high:.1f})"
    )
    assert lost[method].low > 0
plain, mirrored = (one.mean for one in lost.values())
assert 0.35 < 1 - mirrored / plain < 0.5

# %% [markdown]
# ## deepinv
#
# `deepinv.physics.Blur` convolves a batch with a filter whose centre is the middle of an odd
# frame, as ours is. So it takes the PSF unchanged.
#
# The tests of this package do not run this cell: deepinv needs a torchvision that fits the torch
# at hand, and none does there. It was run by hand, with deepinv 0.5.0 and a stand-in for two
# operators of torchvision that a blur does not use. The two blurs then differed by 6e-16 at most.

# %%
try:
    import deepinv
    import torch

    blur = deepinv.physics.Blur(filter=torch.tensor(psf)[None, None], padding="valid")
    theirs = blur.A(torch.tensor(scene)[None, None])[0, 0].numpy()
    apart = np.abs(theirs - fftconvolve(scene, psf, mode="valid")).max()
    print(f"deepinv {deepinv.__version__}: its blur and ours differ by {apart:.1e} at most")
    assert apart < 1e-6
except (
    ImportError,
    RuntimeError,
) as missing:  # a torchvision that does not fit torch raises RuntimeError
    print(f"not run, for deepinv cannot be imported here: {missing}")

# %% [markdown]
# An estimator of motion is a row of the other table, as an object with `estimate(photo)` in a
# module of yours: `python -m lab bench blind --methods pmp,mymodule:MyEstimator`. [Step by
# step](../docs/howto/own-method.md).
