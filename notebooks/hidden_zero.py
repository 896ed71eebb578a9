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
# # The famous code of 2006, and a published one with a hidden zero
#
# **Question.** Can a published shutter code be trusted? **Answer.** Measure it between the points
# of the grid too. The code of 2006 keeps every frequency of a straight motion. Another published
# one was judged on a grid of frequencies, which stepped over a true zero. Three flipped chips
# repair it.

# %% [markdown]
# ## Two codes
#
# `raskar-52` is the code of [Raskar, Agrawal and
# Tumblin](https://doi.org/10.1145/1179352.1141957), 52 chips of which 26 are open. `merl-31-t62`
# has 31 chips, 21 of them open, and was published with a minimum of 0.088 times its value at
# frequency 0.

# %%
import numpy as np
from matplotlib import pyplot as plt
from skimage import data, metrics

import cep

names = ("raskar-52", "merl-31-t62")
codes = {name: cep.load_code(name) for name in names}
figure, axes = plt.subplots(2, 1, figsize=(9, 2.4), layout="constrained")
for row, (name, code) in zip(axes, codes.items(), strict=True):
    row.imshow(code.array[None], cmap="gray", aspect="auto", extent=(0, code.chips, 0, 1))
    row.set(title=f"{name}: {code.open_chips} of {code.chips} chips open", yticks=[])
_ = axes[-1].set_xlabel("time, chips (white: open)")

# %% [markdown]
# ## The audit
#
# |P| is the modulus of the code's spectrum on a straight motion, in chips. At frequency 0 it is the number of open
# chips. An audit bounds the smallest |P| over all frequencies, not over a grid.

# %%
audits = {name: cep.audit(code, flips=3) for name, code in codes.items()}
for name, found in audits.items():
    low, high = found.certificate.lower, found.certificate.upper
    print(f"{name:12} smallest |P| {low:.4f}..{high:.4f} chips, zero: {found.null}")
    for grid in found.grids:
        print(f"    {grid.points:4d}-point DFT shows {grid.minimum:.4f}: {grid.verdict}")
famous, hidden = (audits[name] for name in names)
assert abs(famous.metrics.min_chip - 1.3237) < 1e-4
assert hidden.null
assert hidden.grids[0].verdict == "hides the zero"
assert (
    abs(hidden.grids[0].minimum / 21 - 0.088) < 1e-3
)  # the published claim is that of the 31-point DFT
assert all(cep.verify(found.certificate) for found in audits.values())

# %% [markdown]
# The zero is proven in whole numbers: it is a root of unity, and the polynomial of the code is
# divisible by the polynomial of that root.

# %%
print(f"{hidden.certificate.at[0]:.6f} cycles per chip, by: {hidden.certificate.method}")
at = np.exp(-2j * np.pi * hidden.certificate.at[0] * np.arange(31))
assert abs(codes["merl-31-t62"].array @ at) < 1e-12

# %% [markdown]
# ## How a grid steps over it
#
# The DFT of the 31 bits has 31 frequencies. None of them is the zero's.

# %%
code = codes["merl-31-t62"]
cycles = np.linspace(0, 0.5, 4000)
figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
modulus = np.abs(np.exp(-2j * np.pi * np.outer(cycles, np.arange(31))) @ code.array)
axes.semilogy(cycles, modulus, lw=1, label="all frequencies")
grid = np.fft.rfftfreq(31), np.abs(np.fft.rfft(code.array))
axes.semilogy(*grid, "o", label="31-point DFT")
axes.axvline(hidden.certificate.at[0], color="C3", lw=1, ls=":", label="the zero")
axes.set(
    xlabel="frequency, cycles per chip", ylabel="|P|, chips", ylim=(1e-3, 40), title="merl-31-t62"
)
axes.legend()
assert grid[1].min() > 1.8

# %% [markdown]
# ## The repair
#
# The audit also looks at all codes that differ in up to three chips. One flip removes the zero,
# and three give the best minimum.

# %%
for neighbour in hidden.neighbours:
    print(f"flip chips {neighbour.flips}: smallest |P| {neighbour.minimum:.4f} chips")
repaired = hidden.neighbours[-1].code
proven = cep.certify(repaired)
assert cep.verify(proven)
assert proven.lower > 1.14

# %% [markdown]
# ## What it is worth in a photo
#
# A straight motion of 31 px, one pixel a chip, and a camera of little noise. Each photo is
# restored with its true PSF.

# %%
scene = data.camera()[60:380, 100:420] / 255
camera = cep.Camera(photons_full_scale=30_000, read_noise_e=5)
path = cep.Trajectory.straight(31.0)
figure, axes = plt.subplots(1, 3, figsize=(11, 4), layout="constrained")
quality = {}
shutters = {"open shutter": cep.ShutterCode("1"), "merl-31-t62": code, "repaired": repaired}
for view, (name, shutter) in zip(axes, shutters.items(), strict=True):
    photo = cep.capture(scene, path, shutter, camera, rng=np.random.default_rng(0))
    psf = cep.coded_psf(path, shutter, size=path.frame_size() | 1)
    sharp = cep.restore(photo, psf, method="wiener", camera=camera).image
    edge = (scene.shape[0] - photo.shape[0]) // 2
    truth = scene[edge : edge + photo.shape[0], edge : edge + photo.shape[1]]
    inner = slice(32, -32)
    found, wanted = sharp[inner, inner].clip(0, 1), truth[inner, inner]
    quality[name] = metrics.peak_signal_noise_ratio(wanted, found, data_range=1)
    view.imshow(found, cmap="gray", vmin=0, vmax=1)
    view.set(title=f"{name}: {quality[name]:.1f} dB", xticks=[], yticks=[])
assert quality["repaired"] > quality["merl-31-t62"] + 1.5
assert quality["merl-31-t62"] > quality["open shutter"] + 1.5

# %% [markdown]
# The rule that follows: never report a minimum from a grid. `cep audit CODE` prints the same from
# the shell, and
# the shell, and [the league table](../docs/league.md) has every published code that we know.
# Whether any code is better than a shorter exposure is another question: [should you code at
# all?](should_you_code.py)
