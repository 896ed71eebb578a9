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
# # Quickstart: a shutter code for your camera's motion
#
# A moving camera blurs a photo along its path. If the shutter opens and closes in a well-chosen pattern while the
# camera moves, the blur keeps all the detail and can be undone. Which pattern is best depends on the path. This
# notebook goes through the chain in Python; `cep demo` does the same from the shell.

# %% [markdown]
# ## A blurred photo
#
# With a photo of your own: `blurred = cep.read_image("blurred.jpg")`. Here the scene is a public-domain picture that
# scikit-image carries, its values taken as linear light, and the camera shakes along a bent path.

# %%
import numpy as np
from IPython.display import display
from skimage import data

import cep

rng = np.random.default_rng(2)
scene = data.astronaut()[60:380, 60:380] / 255
camera = cep.Camera(photons_full_scale=20_000, read_noise_e=50)
truth = cep.Trajectory.from_samples([[0, 0], [8, 2], [12, 9], [13, 16]])
blurred = cep.capture(scene, truth, camera=camera, rng=rng)

# %% [markdown]
# ## Its motion
#
# With a sharp photo of the same scene at hand, the method `reference` is the most exact. Without one, leave both
# arguments out: the blind method estimates the motion from the blurred photo alone.

# %%
estimate = cep.estimate_motion(blurred, method="reference", sharp=scene)
estimate

# %% [markdown]
# ## A code for it
#
# One photo with an open shutter cannot tell which way the camera ran along its path, so the code must serve both
# directions; the search takes care of that. `duty` is the open part of the exposure.

# %%
problem = cep.SearchProblem.along(estimate, chips=20, duty=(0.35, 0.7), objective="mse", camera=camera, exposure_s=0.02)
result = cep.optimize(problem, steps=20_000, seed=0)
print(result)
result

# %% [markdown]
# The table compares the code with what would be used instead of it. Look at its last column: where "best snapshot"
# stands above the code, a shorter exposure is the better choice, and no code is needed.
#
# The smallest MTF of the code is certified: a second program, which shares no code with the first, confirms it.

# %%
assert cep.verify(result.certificate)

# %% [markdown]
# ## What it gains
#
# The same camera, the same motion, the same exposure time: once with the shutter open, once with the code. The coded
# photo has less light, which is why the gain depends on the noise.

# %%
for name, code in {"open shutter": cep.ShutterCode("1"), "coded": result.code}.items():
    photo = cep.capture(scene, truth, code, camera, rng=rng)
    sharp = cep.restore(photo, trajectory=estimate.best, code=code, camera=camera)
    print(f"{name:12} {code.duty:4.0%} of the light, direction {sharp.direction}, residual {sharp.residual:.4f}")
    display(sharp)

# %% [markdown]
# Save what you need: `estimate.save("motion")`, `result.save("code.json")`, `sharp.save("sharp.png")`. The commands
# read these files: `cep upload code.json --port /dev/ttyACM0 --arm` puts the code on a shutter controller, as
# `cep.open_shutter` does in Python.
#
# Codes that others published can be named; here the classic one of 2006 on a straight motion of 52 px.

# %%
classic = cep.audit(cep.load_code("raskar-52"), cep.Trajectory.straight(52.0), flips=1)
print(f"smallest |P|: {classic.metrics.min_chip:.4f} chips; a zero: {classic.null}")
assert abs(classic.metrics.min_chip - 1.3237) < 1e-3
