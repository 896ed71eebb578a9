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
# # Quickstart: a shutter code for your camera's motion
#
# **Question.** How does one blurred photo lead to a shutter code, and what is the code worth?
# **Answer.** In four calls: `estimate_motion`, `optimize`, `capture` and `restore`. Here the code
# gains 0.4 dB over the open shutter on twelve photographs, and 0.2 dB in the photo at hand.
#
# A moving camera blurs a photo along its path. If the shutter opens and closes in a well-chosen
# pattern while the camera moves, the blur keeps more of the detail and can be undone better. Which
# pattern is best depends on the path. `cep demo` goes through the same chain from the shell.

# %% [markdown]
# ## A blurred photo
#
# With a photo of your own: `blurred = cep.read_image("blurred.jpg")`. Here the scene is a
# public-domain picture that scikit-image carries, its values taken as linear light, and the camera
# shakes along a bent path.

# %%
import numpy as np
from IPython.display import display
from skimage import data, metrics

import cep

rng = np.random.default_rng(2)
scene = data.astronaut()[60:380, 60:380] / 255
camera = cep.Camera(photons_full_scale=20_000, read_noise_e=100)
truth = cep.Trajectory.from_samples([[0, 0], [8, 2], [12, 9], [13, 16]])
blurred = cep.capture(scene, truth, camera=camera, rng=rng)

# %% [markdown]
# ## Its motion
#
# With a sharp photo of the same scene at hand, the method `reference` is the most exact. Without
# one, leave both arguments out: the blind method estimates the motion from the blurred photo
# alone.

# %%
estimate = cep.estimate_motion(blurred, method="reference", sharp=scene)
estimate

# %% [markdown]
# ## A code for it
#
# One photo with an open shutter cannot tell which way the camera ran along its path, so the code
# must serve both directions; the search takes care of that. `duty` is the open part of the
# exposure. `mse` asks for the smallest expected error of the restored photo.

# %%
problem = cep.SearchProblem.along(
    estimate, chips=20, duty=(0.35, 0.7), objective="mse", camera=camera, exposure_s=0.02
)
result = cep.optimize(problem, steps=100_000, seed=0)
print(result)
result

# %% [markdown]
# The first line says whether to code at all. The table compares the code with what would be used
# instead of it, by the expected error in its last column: lower is better. The smallest MTF is 0
# in all rows, as it is along most bent paths. What counts is how few frequencies are that weak.
#
# The error is that of the worse direction, so the gain holds whichever way the camera ran.

# %%
assert result.verdict.choice == "code"
assert abs(result.verdict.gains_db["code"] - 0.3) < 0.25
assert problem.both_directions(estimate.best)

# %% [markdown]
# ## What it gains
#
# The same camera, the same motion, the same exposure time: once with the shutter open, once with
# the code. The coded photo has less light, which is why the gain depends on the noise. Both are
# restored along the estimated path, and compared with the scene. The gain stated is the mean over
# twelve photographs; scenes differ.

# %%
psnr_db = {}
for name, code in {"open shutter": cep.ShutterCode("1"), "coded": result.code}.items():
    photo = cep.capture(scene, truth, code, camera, rng=rng)
    sharp = cep.restore(photo, trajectory=estimate.best, code=code, camera=camera)
    edge = (scene.shape[0] - sharp.image.shape[0]) // 2
    wanted = scene[edge:-edge, edge:-edge]
    psnr_db[name] = metrics.peak_signal_noise_ratio(wanted, sharp.image.clip(0, 1), data_range=1)
    print(f"{name:12} {code.duty:4.0%} of the light, restored to {psnr_db[name]:.1f} dB")
    display(sharp)
gain_db = psnr_db["coded"] - psnr_db["open shutter"]
assert abs(gain_db - result.verdict.gains_db["code"]) < 0.5

# %% [markdown]
# Save what you need: `estimate.save("motion")`, `result.save("code.json")`,
# `sharp.save("sharp.png")`. The commands read these files: `cep upload code.json --port
# /dev/ttyACM0 --arm` puts the code on a shutter controller, as `cep.open_shutter` does in Python.
#
# Codes that others published can be named. Here the one of 2006 on a straight motion of 52 px: its
# spectrum |P| stays above 1.3 chips, so no frequency is lost.

# %%
classic = cep.audit(cep.load_code("raskar-52"), cep.Trajectory.straight(52.0), flips=1)
print(f"smallest |P|: {classic.metrics.min_chip:.4f} chips")
assert not classic.null
assert abs(classic.metrics.min_chip - 1.3237) < 1e-3
