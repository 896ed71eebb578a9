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

# %%
import numpy as np
from IPython.display import Image, display

from cep import plots
from cep.optics.camera import Camera, capture
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf
from cep.proofs.measure import measure
from cep.restoration import restore
from cep.search.annealing.anneal import anneal
from cep.search.problem import SearchProblem
from motdiff.estimators.reference import ReferenceEstimator
from motdiff.metrics import mnc_subpixel, psnr_up_to_shift
from motdiff.motions import quadratic
from motdiff.simulate import to_linear, visible

rng = np.random.default_rng(2)


def show(figure):
    display(Image(plots.png_bytes(figure, dpi=80)))


# %% [markdown]
# ## A blurred photo
#
# The scene is a public-domain picture that scikit-image carries, in linear light. A hand shake draws a bent path; the
# camera adds photon and read noise.

# %%
from skimage import data

scene = to_linear(data.astronaut()[60:380, 60:380] / 255)
truth = quadratic(rng, min_length_px=20, max_length_px=24)
camera = Camera(photons_full_scale=20_000, read_noise_e=3)
frame = 33
blurred = capture(scene, truth.psf(frame), camera, rng=rng)

# %% [markdown]
# ## Its motion
#
# With a sharp photo of the same scene at hand, the `reference` method is the most exact. Without one use the blind
# estimator: `motdiff.estimators.pmp.PmpEstimator().estimate(blurred)`.

# %%
estimate = ReferenceEstimator(scene).estimate(blurred)
motion = estimate.trajectories[0]
print(f"{motion.length_px:.1f} px long, confidence {estimate.confidence:.2f}")
print(f"PSF against the true one: MNC {mnc_subpixel(estimate.psf, truth.psf(64)):.3f}")
assert mnc_subpixel(estimate.psf, truth.psf(64)) > 0.9
show(plots.trajectory_figure(blurred, motion))

# %% [markdown]
# ## A code for it
#
# One photo cannot tell which way the camera ran along its path, so the code must serve both directions; the search
# takes care of that.

# %%
problem = SearchProblem.along(motion, chips=20, objective="mse", camera=camera, open_range=(7, 14))
found = anneal(problem, rng=rng, steps=20_000)
open_shutter = ShutterCode("1" * 20)
for name, code in {"found": found.code, "open": open_shutter}.items():
    metrics = problem.measure(code)
    print(f"{name:6} {code.bits}  noise gain {metrics.noise_gain_db:5.1f} dB, expected PSNR {-metrics.mse_db:.1f} dB")
show(plots.code_strips({"found": found.code}))
show(plots.mtf_figure(motion, {"open shutter": None, "found": found.code}))

# %% [markdown]
# ## What it gains
#
# The same camera, the same motion, the same exposure time: once with the shutter open, once with the code. The coded
# photo has less light, which is why the gain depends on the noise.

# %%
sharp = visible(scene, frame)
for name, code in {"open shutter": open_shutter, "coded": found.code}.items():
    psf = coded_psf(truth, code, frame)
    photo = capture(scene, psf, camera, rng=rng)
    result = restore(photo, psf, method="wiener", camera=camera)
    psnr_db = psnr_up_to_shift(result.image.mean(axis=2), sharp.mean(axis=2), max_shift_px=1)
    print(f"{name:12} {code.duty:4.0%} of the light, restored to {psnr_db:.2f} dB")
    show(plots.before_after({name: photo / code.duty, "restored": result.image}))

# %% [markdown]
# `measure` judges any code along any path; here is the classic code of 2006 on a straight motion of 52 px.

# %%
from cep.codes.published import published
from motdiff.trajectory import Trajectory

classic = measure(Trajectory.straight(52.0), published("raskar-52").code)
print(f"smallest |P|: {classic.min_chip:.4f} chips")
assert abs(classic.min_chip - 1.3237) < 1e-3
