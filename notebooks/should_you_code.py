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
# # Should you code at all? Your camera in the map
#
# **Question.** Is a coded exposure better than a shorter one? **Answer.** Only where the noise
# that every exposure has, such as read noise, outweighs the noise of the light itself. With a
# current low-noise CMOS in good light, expose for less. With an 8-bit link or an older sensor a
# code can gain more than 1 dB.

# %% [markdown]
# ## One camera, one motion
#
# `cep.advise` compares the open shutter, the best single exposure, the best even pulses and the
# best code, by the expected error of the restored photo. Here the motion is straight, 24 px in
# 1/30 s, as on a conveyor.

# %%
import numpy as np
from matplotlib import pyplot as plt

import cep

motion = cep.Trajectory.straight(24.0)
LIGHT = (300.0, 1_000.0, 3_000.0, 10_000.0, 30_000.0, 100_000.0)


def advice(camera, **options):
    problem = cep.SearchProblem.along(motion, chips=24, camera=camera, exposure_s=1 / 30)
    return cep.advise(problem, levels=LIGHT, threads=1, **options)


known = {
    name: cep.Camera.load(name) for name in ("sony-imx174", "aptina-mt9m031-8bit", "video-8bit")
}
advised = {name: advice(camera) for name, camera in known.items()}
for name, one in advised.items():
    print(f"{name}: {one.sentence}\n")
assert [one.choice for one in advised.values()] == ["snapshot", "code", "code"]
assert all(one.here.code_gain_db > 0.7 for one in list(advised.values())[1:])

# %% [markdown]
# ## Why: two noises
#
# Photon noise has a variance in proportion to the light $N$, read noise has the same variance
# $\sigma^2$ after any exposure. So half the light divides the ratio of signal to noise by 1.4
# where photon noise rules, and by 2 where read noise rules. A code keeps more light than a short
# exposure does, and that pays where read noise rules.

# %%
photons = np.geomspace(100, 1e5, 200)
figure, axes = plt.subplots(figsize=(7, 3.6), layout="constrained")
axes.loglog(photons, np.sqrt(photons), label="photon noise at full scale")
for read_noise_e in (2, 20, 200):
    axes.axhline(read_noise_e, ls="--", lw=1, color="C1")
    axes.text(110, read_noise_e * 1.1, f"read noise {read_noise_e} e-", color="C1", fontsize=8)
axes.set(xlabel="photo-electrons at full scale", ylabel="noise, electrons")
axes.legend()
camera = cep.Camera(photons_full_scale=10_000, read_noise_e=20, bits=16)
variance_e2 = camera.noise_variance(np.array([0.25, 1.0])) * 10_000**2
assert np.allclose(variance_e2, np.array([2_500, 10_000]) + 20**2, rtol=1e-3)

# %% [markdown]
# ## The map
#
# Gain of the best code over the better of the open shutter and the best single exposure, over
# light and read noise, here by the model of photographs alone. The diamonds are the three cameras.
# An 8-bit camera stands higher than its read noise, for its code step of $q$ electrons adds a
# noise of $q/\sqrt{12}$.

# %%
READ_NOISE = (2.0, 10.0, 50.0, 200.0)
cameras = [cep.Camera(photons_full_scale=LIGHT[0], read_noise_e=e, bits=16) for e in READ_NOISE]
tables = [advice(camera, photographs=()) for camera in cameras]
gains = np.array([[level.code_gain_db for level in one.levels] for one in tables])
figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
shown = axes.imshow(
    np.maximum(gains, 0), cmap="Greens", vmin=0, vmax=5, origin="lower", aspect="auto"
)
for (i, j), gain in np.ndenumerate(gains):
    text = f"+{gain:.1f}" if gain >= 0.1 else "\u2013"
    axes.text(
        j, i, text, ha="center", va="center", fontsize=8, color="white" if gain > 3 else "black"
    )
column = np.interp(
    np.log10([c.photons_full_scale for c in known.values()]),
    np.log10(LIGHT),
    np.arange(len(LIGHT)),
)
steps_e = np.array([c.photons_full_scale / (2**c.bits - 1) for c in known.values()])
noise_e = np.hypot([c.read_noise_e for c in known.values()], steps_e / np.sqrt(12))
row = np.interp(np.log10(noise_e), np.log10(READ_NOISE), np.arange(len(READ_NOISE)))
axes.plot(column, row, "D", color="C3")
for x, y, name in zip(column, row, known, strict=True):
    axes.annotate(name, (x, y), xytext=(6, 7), textcoords="offset points", fontsize=8, color="C3")
axes.set_xticks(range(len(LIGHT)), [f"{level:,.0f}" for level in LIGHT])
axes.set_yticks(range(len(READ_NOISE)), [f"{e:g}" for e in READ_NOISE])
axes.set(
    xlabel="photo-electrons at full scale",
    ylabel="read noise, electrons",
    title="straight motion of 24 px",
)
figure.colorbar(shown, ax=axes, label="gain of a code, dB (\u2013: expose for less)")
assert (gains[0] < 0).all()
assert gains[2:, -2:].min() > 1
bright = gains[:, -1]
assert (np.diff(bright[:3]) > 0).all()

# %% [markdown]
# ## Your camera
#
# `cep.Camera.load("camera.toml")` reads a file that `cep camera estimate` makes from two flat and
# two dark frames. Three numbers do as well: electrons at full scale, read noise in electrons,
# bits.

# %%
mine = cep.Camera(photons_full_scale=8_000, read_noise_e=30, bits=8)
my_advice = advice(mine)
print(my_advice)
assert my_advice.here.code_gain_db > 0.3

# %% [markdown]
# The gain is the mean over twelve photographs, restored by default along a motion that is known in
# time. If the path is an estimate, give its error: `cep.advise(problem, path_error_px=0.25)`. It
# takes much of the gain away in bright light.
