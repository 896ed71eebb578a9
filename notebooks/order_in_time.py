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
# # Why one open photo cannot know the order, and the calibration that does
#
# **Question.** Why is one photo with an open shutter not enough to design a code?
# **Answer.** It shows where the camera went, but not when. A shutter code is played in time: along
# a path in the wrong order it is a code for another motion. Photos of the same motion through
# known codes show the order.

# %% [markdown]
# ## Two motions, one blur
#
# A camera runs into a loop and out of it. The second motion runs round the same loop the other
# way.

# %%
import numpy as np
from matplotlib import pyplot as plt

import cep

time = np.linspace(0, 1, 400)
round_ = 2 * np.pi * time
loop = np.stack([9 * np.sin(round_) - 3 * np.sin(2 * round_), 9 * (1 - np.cos(round_))], axis=1)
inward = np.stack([16 * (time - 1), 7 * (time - 1) ** 2], axis=1)
outward = np.stack([13 * time, -6 * time**2], axis=1)


def motion(around):
    """Into the loop for 30 % of the exposure, around it for 45 %, and out."""
    durations = (0.30, 0.45, 0.25)
    begins = np.cumsum((0, *durations))
    t = np.concatenate(
        [begin + span * time[:-1] for begin, span in zip(begins, durations, strict=False)]
    )
    points = np.concatenate([inward[:-1], around[:-1], outward])
    return cep.Trajectory.from_samples(points, t=np.append(t, 1.0), direction="known")


one, other = motion(loop), motion(loop[::-1])

# %% [markdown]
# Through an open shutter their PSFs agree to the last digits. Through a code they do not.

# %%
code = cep.ShutterCode("111000011011")
psfs = [
    [cep.coded_psf(path, through, 49) for through in (cep.ShutterCode("1"), code)]
    for path in (one, other)
]
assert np.abs(psfs[0][0] - psfs[1][0]).max() < 1e-12
assert np.abs(psfs[0][1] - psfs[1][1]).sum() > 0.5 * psfs[0][1].sum()

figure, axes = plt.subplots(2, 3, figsize=(9, 6.2), layout="constrained")
for row, (name, path) in enumerate({"one motion": one, "another": other}.items()):
    at = path.at(np.linspace(0, 1, 160))
    at -= 0.5 * (at.min(axis=0) + at.max(axis=0))
    drawn = axes[row, 0].scatter(*at.T, c=np.linspace(0, 1, 160), s=10, cmap="viridis")
    axes[row, 0].set(
        title=name, aspect="equal", xlim=(-24, 24), ylim=(24, -24), xlabel="x, px", ylabel="y, px"
    )
    for column, title in enumerate(("its blur, shutter open", f"its blur through {code.bits}")):
        axes[row, 1 + column].imshow(psfs[row][column], cmap="gray", vmin=0)
        axes[row, 1 + column].set(title=title, xticks=[], yticks=[])
_ = figure.colorbar(drawn, ax=axes[:, 0], location="left", label="time, share of the exposure")

# %% [markdown]
# ## What a mistake costs
#
# A code is searched along the one motion, and another along the other. Both are then judged where
# the camera moves the first way. `mse_db` is the expected error after restoration, lower is
# better. The code for the wrong order is no better than the best of 15 random ones.

# %%
camera = cep.Camera(photons_full_scale=20_000, read_noise_e=100)


def problem_along(path):
    return cep.SearchProblem.along(path, chips=24, duty=(0.5, 0.5), objective="mse", camera=camera)


def error_db(code):
    return problem_along(one).measure(code, budget=100).mse_db


def code_along(path):
    # the code alone: its verdict on photographs would take longer than the search
    return cep.optimize(problem_along(path), steps=20_000, seed=0, photographs=()).code


codes = {
    name: code_along(path)
    for name, path in {"along the true motion": one, "along the other one": other}.items()
}
rng = np.random.default_rng(0)
random_db = [error_db(cep.ShutterCode(rng.permutation(np.arange(24) % 2))) for _ in range(15)]
found_db = {name: error_db(code) for name, code in codes.items()}
for name, value in found_db.items():
    print(f"a code searched {name:22} {value:6.2f} dB")
assert found_db["along the true motion"] < found_db["along the other one"] - 0.3
assert found_db["along the other one"] > np.min(random_db)
print(f"random codes, mean and best     {np.mean(random_db):6.2f} dB, {np.min(random_db):.2f} dB")

# %% [markdown]
# ## The calibration that knows
#
# Four photos of the same motion: one with the shutter open, and three through the bit planes of a
# Gray code, which number eight bins of the exposure. `cep calibration-set` designs such sets for a
# shutter's limits. The photos are fitted by one path together.

# %%
from skimage import data

scene = data.camera()[70:270, 130:330] / 255
through = [cep.ShutterCode(bits) for bits in ("11111111", "00001111", "00111100", "01100110")]
photos = [cep.capture(scene, one, code, camera, rng=rng) for code in through]
found = cep.estimate_motion(photos, codes=through)
print(found)
print(f"order right with probability {found.details['order_confidence']:.2f}")
assert found.details["order_confidence"] > 0.8
found


# %%
def off_px(path, truth):
    """Rms distance at equal times, after the best shift."""
    t = np.linspace(0, 1, 200)
    apart = path.at(t) - truth.at(t)
    return np.sqrt(np.mean(np.sum((apart - apart.mean(axis=0)) ** 2, axis=1)))


print(
    f"{off_px(found.best, one):.2f} px from the true motion, {off_px(found.best, other):.2f} px"
    " from the other one"
)
assert off_px(found.best, one) < 0.6 < off_px(found.best, other)

# %% [markdown]
# From files: `cep calibrate open.png p2.png p3.png p4.png --code open --code 00001111 --code
# 00111100 --code 01100110
# 00111100 --code 01100110 -o motion`. One photo of a small light through a code will do as well
# (`--method point --code`). With a code in use, `cep calibrate --trajectory` improves the
# calibration by every photo taken.
