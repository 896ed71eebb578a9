# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # Our PSF in scikit-image and deepinv
#
# **Question.** Do the PSFs of this package work elsewhere, and other restorations here?
# **Answer.** Yes. A coded PSF is a plain array: the photo is its true convolution with the scene. It sums to the open
# share of the exposure, where other libraries expect 1.
#
# deepinv is no dependency of this package; its part is left out where it cannot be imported.

# %% [markdown]
# ## The convention
#
# Zero displacement lies at index `size // 2`, x to the right, y down. The PSF sums to the duty of the code: a coded
# photo is darker.

# %%
import numpy as np
from matplotlib import pyplot as plt
from scipy.signal import fftconvolve
from skimage import data, restoration

import cep

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
# It restores with PSFs of sum 1: divide both the photo and the PSF by the duty. Its Wiener filter takes the photo as
# one period of a pattern, so the photo is mirrored at its borders first.

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
    "ours, Wiener": cep.restore(noisy, psf, camera=camera).image,
    "scikit-image, Wiener": mirrored_wiener(noisy, psf),
    "scikit-image, Richardson-Lucy": restoration.richardson_lucy(bright, unit, num_iter=30),
}
figure, axes = plt.subplots(1, 4, figsize=(13, 3.7), layout="constrained")
for view, (name, image) in zip(axes, views.items(), strict=True):
    view.imshow(image[inner, inner], cmap="gray", vmin=0, vmax=1)
    view.set(title=f"{name}\n{psnr_db(image):.1f} dB", xticks=[], yticks=[])
    assert image is bright or psnr_db(image) > psnr_db(bright) + 2

# %% [markdown]
# scikit-image's function is a restoration of ours as well: anything that takes (photo, psf).

# %%
own = cep.restore(noisy, psf, method=mirrored_wiener)
assert np.allclose(own.image, views["scikit-image, Wiener"])

# %% [markdown]
# ## deepinv
#
# `deepinv.physics.Blur` convolves a batch with a filter whose centre is the middle of an odd frame, as ours is.

# %%
try:
    import deepinv
    import torch

    blur = deepinv.physics.Blur(filter=torch.tensor(psf)[None, None], padding="valid")
    theirs = blur.A(torch.tensor(scene)[None, None])[0, 0].numpy()
    apart = np.abs(theirs - fftconvolve(scene, psf, mode="valid")).max()
    print(f"deepinv {deepinv.__version__}: its blur and ours differ by {apart:.1e} at most")
    assert apart < 1e-6
except (ImportError, RuntimeError) as missing:  # a torchvision that does not fit torch raises RuntimeError
    deepinv = None
    print(f"deepinv is left out, for it cannot be imported here ({missing}); pip install deepinv")

# %% [markdown]
# An estimator of another library is a row of our table as well, as an object with `estimate(photo)` in a module of
# yours: `cep bench blind --methods pmp,mymodule:MyEstimator`.
