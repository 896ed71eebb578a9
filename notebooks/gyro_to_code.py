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
# # From a gyroscope log to a shutter code
#
# **Question.** The camera carries a gyroscope. Does that replace the calibration photo?
# **Answer.** Yes, and it tells more: the path comes with its order and direction in time, which
# one open photo cannot show. It needs the focal length in pixels and the moment the shutter opened
# on the gyroscope's clock.

# %% [markdown]
# ## A log
#
# Any table with a time and three rates will do; units are read from the header. Not in the file
# are the directions of its axes. Here they are those of the camera: x right, y down, z forward. A
# phone held upright has x right, y up, z back. This log is made here: 500 rows a second of a drone
# whose motors shake the camera while it yaws to the right. A camera with a focal length of 1600 px
# turns an angle of 1 mrad into 1.6 px.

# %%
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from skimage import data

import cep

focal_px, start_s, exposure_s = 1600.0, 0.20, 0.040
t = np.arange(0, 0.5, 0.002)
yaw_rad_s, shake_rad_s = 0.35, 0.30
turn = 2 * np.pi * 30 * (t - start_s)  # the motors shake it at 30 Hz
rates = np.stack([shake_rad_s * np.cos(turn), yaw_rad_s + 0 * t, 0 * t], axis=1)
with tempfile.TemporaryDirectory() as folder:
    log = Path(folder, "gyro.csv")
    np.savetxt(
        log,
        np.column_stack([t, rates]),
        delimiter=",",
        header="t_s,wx_rad_s,wy_rad_s,wz_rad_s",
        comments="",
    )
    print(*log.read_text().splitlines()[:3], sep="\n")
    trace = cep.read_gyro(log)
print(trace.columns)
print(f"{trace.sample_rate_hz:.0f} rows a second, {trace.duration_s:.2f} s")

# %% [markdown]
# ## The photo, and the path that the log gives it
#
# The estimator integrates the rates over the exposure. The true path is known here in closed form:
# a steady yaw of
# $f\,\omega\,T$ = 22.4 px to the left, and a sine of $f\,a/(2\pi\nu)$ = 2.5 px.

# %%
share = np.linspace(0, 1, 400)
time_s = exposure_s * share
amplitude_px = focal_px * shake_rad_s / (2 * np.pi * 30)
xy = np.stack(
    [-focal_px * yaw_rad_s * time_s, amplitude_px * np.sin(2 * np.pi * 30 * time_s)], axis=1
)
truth = cep.Trajectory.from_samples(xy, t=share, direction="known")

rng = np.random.default_rng(3)
scene = data.camera()[60:380, 60:380] / 255
camera = cep.Camera(photons_full_scale=20_000, read_noise_e=80)
blurred = cep.capture(scene, truth, camera=camera, rng=rng)
known = {
    "gyro": trace,
    "focal_px": focal_px,
    "exposure_s": exposure_s,
    "axes": "right,down,forward",
}
estimate = cep.estimate_motion(blurred, method="gyro", start_s=start_s, **known)
found = estimate.best
error_px = np.sqrt(np.mean(np.sum((found.at(share) - truth.at(share)) ** 2, axis=1)))
print(
    f"{found.length_px:.2f} px long, direction {found.direction}, {error_px:.3f} px rms from the"
    " closed form"
)
assert found.direction == "known"
assert abs(np.ptp(found.xy[:, 0]) - focal_px * yaw_rad_s * exposure_s) < 1e-6
assert error_px < 0.05

figure, (rate_axes, path_axes) = plt.subplots(1, 2, figsize=(11, 3.6), layout="constrained")
rate_axes.plot(
    trace.t_s, trace.rate_rad_s, label=["about x (tilt)", "about y (yaw)", "about z (roll)"]
)
rate_axes.axvspan(start_s, start_s + exposure_s, color="0.85", label="shutter open")
rate_axes.set(xlim=(0.1, 0.35), xlabel="time, s", ylabel="rate, rad/s", title="the log")
rate_axes.legend(fontsize=8)
drawn = path_axes.scatter(*found.at(share).T, c=1e3 * time_s, s=8)
path_axes.plot(*truth.xy.T, color="C3", lw=0.8, label="closed form")
path_axes.set(
    xlabel="x, px",
    ylabel="y, px (down)",
    title="the path of the image",
    aspect="equal",
    ylim=(8, -8),
)
path_axes.legend(fontsize=8)
_ = figure.colorbar(drawn, ax=path_axes, label="time since opening, ms")

# %% [markdown]
# ## A wrong clock
#
# With a clock that is off by 5 ms, the log gives another piece of the motion: a wave of the same
# kind, which the camera did not follow during the exposure. Dots mark every tenth of the exposure.

# %%
late = cep.estimate_motion(blurred, method="gyro", start_s=start_s + 0.005, **known)
off_px = np.sqrt(np.mean(np.sum((late.best.at(share) - truth.at(share)) ** 2, axis=1)))
print(f"{off_px:.2f} px rms from the truth")
assert off_px > 10 * error_px
figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
for name, path in {"right clock": found, "clock off by 5 ms": late.best}.items():
    (line,) = axes.plot(*path.at(share).T, label=name)
    axes.plot(*path.at(np.linspace(0, 1, 11)).T, "o", ms=4, color=line.get_color())
axes.set(xlabel="x, px", ylabel="y, px (down)", aspect="equal", ylim=(6, -6))
_ = axes.legend(fontsize=8)

# %% [markdown]
# ## A code for it
#
# The direction is known, so the code serves one direction only. The first line says whether to use
# a code at all: this camera has a large fixed noise, so it pays.

# %%
problem = cep.SearchProblem.along(
    estimate, chips=32, objective="mse", camera=camera, exposure_s=exposure_s
)
result = cep.optimize(problem, steps=20_000, seed=0)
print(result)
assert result.verdict.choice == "code"
assert cep.verify(result.certificate)

# %% [markdown]
# ## What it gains
#
# The same light and camera, for two scenes: shutter open, the best single exposure, and the code.
# The verdict is the mean over twelve photographs, and scenes differ: of the first one the code
# gains 0.8 dB over the single exposure, of the second it loses 0.8 dB.


# %%
def restored(light, code):
    """Restore a simulated photo of one exposure; the inner part of it, and its PSNR."""
    photo = cep.capture(light, truth, code, camera, rng=np.random.default_rng(0))
    sharp = cep.restore(photo, trajectory=found, code=code, camera=camera).image
    edge, inner = (light.shape[0] - photo.shape[0]) // 2, slice(24, -24)
    wanted = light[edge : edge + photo.shape[0], edge : edge + photo.shape[1]]
    return sharp[inner, inner], -10 * np.log10(
        np.mean((sharp[inner, inner] - wanted[inner, inner]) ** 2)
    )


ways = {
    "open shutter": cep.ShutterCode("1"),
    "best single exposure": result.verdict.best("snapshot").code,
    "code": result.code,
}
scenes = {"camera man": scene, "astronaut": data.astronaut()[60:380, 60:380].mean(axis=2) / 255}
figure, axes = plt.subplots(2, 3, figsize=(10, 7), layout="constrained")
for row, light in zip(axes, scenes.values(), strict=True):
    psnr_db = {}
    for view, (name, code) in zip(row, ways.items(), strict=True):
        picture, psnr_db[name] = restored(light, code)
        view.imshow(picture, cmap="gray", vmin=0, vmax=1)
        view.set(title=f"{name}: {psnr_db[name]:.1f} dB", xticks=[], yticks=[])
    assert psnr_db["code"] > psnr_db["open shutter"] + 0.4
    assert psnr_db["code"] > psnr_db["best single exposure"] - 1.2

# %% [markdown]
# From files: `cep calibrate blurred.jpg --method gyro --gyro gyro.csv --focal 1600 --start 0.20
# --exposure 0.040
# --gyro-axes right,down,forward -o motion`.
