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
# # A controller that plays the code, and the PSF as achieved
#
# **Question.** The code was computed. Did the shutter play it? **Answer.** Record the shutter's
# signal with a logic analyser and compare. The recording gives the chips as played, the error of
# the controller's clock and the jitter, and from them the PSF with which the photo should be
# restored.
#
# No board is needed here: the shipped firmware runs on an emulated Arduino Uno whose clock is 4 %
# slow, like that of a board without a crystal. The emulator needs gcc, libsimavr-dev and
# libelf-dev.

# %% [markdown]
# ## Upload and play
#
# The code is played twice: as it is, and with chips that the controller shortens by the known
# error of its clock.

# %%
import tempfile
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt
from skimage import data

import cep
from hw.emulation.uno import EmulatedUno, EmulationError
from hw.export import EXPORTERS
from hw.program import Program

SLOW_PPM = -40_000
code = cep.ShutterCode("1011000111010011", chip_ns=2_000_000)


def emulated_plays(file):
    """Play the code on an emulated Uno without and with a correction of its clock; record its
    pins."""
    with EmulatedUno(clock_ppm=SLOW_PPM, noise_seed=1) as uno:
        with cep.open_shutter(uno.port) as shutter:
            for clock_ppm in (0, SLOW_PPM):
                report = shutter.upload(code, play=True, clock_ppm=clock_ppm)
        uno.write_vcd(file)
    return report


with tempfile.TemporaryDirectory() as folder:
    recording = Path(folder, "played.vcd")
    try:
        report, emulated = emulated_plays(recording), True
        print(
            f"{report.program.chips} chips of {report.program.chip_ns} ns read back by {report.firmware}:"
            f" {report.read_back}"
        )
    except EmulationError as missing:
        recording.write_text(EXPORTERS["vcd"].export(Program(code.bits, chip_ns=code.chip_ns)))
        emulated = False
        print(f"{missing}. The recording of an ideal shutter is read instead.")
    played = cep.read_playback(recording, code, signal="shutter")

# %% [markdown]
# ## The recording
#
# A logic analyser sees edges. `cep.read_playback` finds the plays in a VCD or Saleae file, and
# fits a clock to each: the first play lasts 1 / (1 - 0.04) times as long as commanded.

# %%
for number, play in enumerate(played.plays, start=1):
    print(f"play {number}: {play.verdict}")
    assert play.achieved == code.bits
    assert play.jitter_ns < 200
first = played.plays[0]
if emulated:
    raw, corrected = played.plays
    assert abs(raw.scale_ppm - 1e6 * (1 / 0.96 - 1)) < 50
    assert abs(corrected.scale_ppm) < 50

time_ms = np.arange(code.chips + 1) * code.chip_ns * 1e-6
figure, axes = plt.subplots(figsize=(10, 2.8), layout="constrained")
axes.stairs(code.array, time_ms, fill=True, color="0.7")
labels = ["commanded"]
for row, play in enumerate(played.plays, start=1):
    edges = time_ms * (1 + play.scale_ppm * 1e-6)
    axes.stairs(1.3 * row + code.array, edges, baseline=1.3 * row, fill=True)
    labels.append(f"play {row}")
axes.set(xlabel="time since the first chip, ms", ylabel="shutter, high: open", title="as recorded")
_ = axes.set_yticks([1.3 * row + 0.5 for row in range(len(labels))], labels)

# %% [markdown]
# ## The PSF as achieved
#
# Over a straight motion of 48 px in the commanded 32 ms. The slow shutter spreads the same chips
# over 2 px more of the path, and it lets in more light.

# %%
motion = cep.Trajectory.straight(48.0)
size = 81
commanded, achieved = cep.coded_psf(motion, code, size=size), played.psf(motion, size=size)
print(f"light: {commanded.sum():.4f} commanded, {achieved.sum():.4f} achieved")
assert abs(commanded.sum() - code.duty) < 1e-9
assert abs(achieved.sum() - code.duty * (1 + first.scale_ppm * 1e-6)) < 1e-3
figure, axes = plt.subplots(figsize=(10, 3), layout="constrained")
x_px = np.arange(size) - size // 2
axes.step(x_px, commanded.sum(axis=0), where="mid", color="0.5", label="commanded")
axes.step(x_px, achieved.sum(axis=0), where="mid", label="achieved, play 1")
axes.set(
    xlabel="x, px", ylabel="light, share of the exposure per px", xlim=(-30, 30), ylim=(0, 0.028)
)
_ = axes.legend(loc="upper center", ncols=2)

# %% [markdown]
# ## What it is worth
#
# The photo was taken by the shutter as it was. Restored with the PSF as commanded it has ghosts
# beside each edge.

# %%
scene = data.camera()[60:380, 80:440] / 255
camera = cep.Camera(photons_full_scale=30_000, read_noise_e=5)
photo = cep.capture(scene, achieved, camera=camera, rng=np.random.default_rng(0))
edge = size // 2
truth = scene[edge:-edge, edge:-edge]
inner = (slice(None), slice(40, -40))
figure, axes = plt.subplots(1, 3, figsize=(12, 4.6), layout="constrained")
axes[0].imshow(photo[inner], cmap="gray")
axes[0].set(title="coded photo", xticks=[], yticks=[])
quality_db = {}
for view, (name, psf) in zip(
    axes[1:], {"as commanded": commanded, "as achieved": achieved}.items(), strict=True
):
    sharp = cep.restore(photo, psf, camera=camera).image
    quality_db[name] = -10 * np.log10(np.mean((sharp[inner] - truth[inner]) ** 2))
    view.imshow(sharp[inner], cmap="gray", vmin=0, vmax=1)
    view.set(
        title=f"restored with the PSF {name}: {quality_db[name]:.1f} dB", xticks=[], yticks=[]
    )
if emulated:
    assert quality_db["as achieved"] > quality_db["as commanded"] + 1.5

# %% [markdown]
# In the shell: `cep hw emulate uno --link uno --vcd played.vcd` in one window, `cep upload
# code.json --port uno
# --play` in another, then `cep hw verify code.json --capture played.vcd --linear 48 -o played.json`, whose PSF `cep
# deblur --psf` takes.
