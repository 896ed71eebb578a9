"""Small inputs of the recorded commands, drawn by the standard library alone."""

from __future__ import annotations

import csv
import io
import json
import math
import struct
import zlib
from collections.abc import Sequence

USER_MODULE = """\
import numpy as np


class Estimator:
    def estimate(self, photo):
        psf = np.zeros((17, 17))
        psf[8, 2:15] = 1 / 13
        return psf


def restore(photo, psf):
    return np.clip(photo / psf.sum(), 0, 1)


def figure(trajectory, code):
    return sum(code.bits.count(bit) for bit in "1") / len(code.bits)


def code():
    return "1101001011"
"""

BLIND_PROTOCOL = """\
photos = 1
motions = 1
crop_px = 128
psf_px = 32
seed = 0

[motion]
boracchi_foi = 1.0
max_length_px = 20.0
"""

CODED_PROTOCOL = """\
name = "small"
photos = 1
motions = 1
crop_px = 96
borders = "symmetric"
shakes = "mixed"
chips = 12
open_range = [3, 9]
objective = "mse"
photons = [3000.0]
calibration_photons = 10000.0
bits = 8
read_noise_e = 10.0
restoration = "wiener"
border_rounds = 2
restored_by = "psf"
steps = 500
seed = 0
quick_photos = 1
quick_motions = 1
quick_steps = 200
quick_photons = [3000.0]
"""

TRAINING = """\
[data]
photos = "photos"
motions = 2
held_out = 2
validation = 2

[motions]
boracchi_foi = 1.0
max_length_px = 12

[network]
backbone = "none"
physics_channels = 8
physics_width = 8
physics_depth = 1
physics_patch = 2
denoiser_width = 8
dropout = 0.0
dwell = true

[optimiser]
steps = 2
batch = 2
warm_up = 1
seed = 3
"""


class Dice:
    """Random numbers that are the same in every version of Python."""

    def __init__(self, seed: int) -> None:
        self._state = seed

    def uniform(self) -> float:
        """Return a number within 0..1."""
        self._state = (self._state * 6364136223846793005 + 1442695040888963407) % 2**64
        return (self._state >> 11) / 2**53

    def normal(self) -> float:
        """Return a number that is nearly normally distributed."""
        return sum(self.uniform() for _ in range(12)) - 6.0


def png_bytes(rows: Sequence[Sequence[int]], *, channels: int = 1) -> bytes:
    """Encode a photo of 8 bits.

    Parameters
    ----------
    rows : sequence of rows
        Values of a row, those of a pixel's channels side by side.
    channels : {1, 3}
        Grey or RGB.

    Returns
    -------
    bytes
        A PNG file.
    """
    size = struct.pack(
        ">IIBBBBB", len(rows[0]) // channels, len(rows), 8, 2 if channels == 3 else 0, 0, 0, 0
    )
    pixels = zlib.compress(b"".join(b"\0" + bytes(row) for row in rows))
    chunks = ((b"IHDR", size), (b"IDAT", pixels), (b"IEND", b""))
    coded = (
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )
    return b"\x89PNG\r\n\x1a\n" + b"".join(coded)


def drawn_scene(size: int, *, seed: int) -> list[list[int]]:
    """Draw a grey scene of rectangles and discs with a fine texture.

    Parameters
    ----------
    size : int
        Side, px.
    seed : int
        Of all that is drawn.

    Returns
    -------
    list of rows
        Values 0..255.
    """
    dice = Dice(seed)
    levels = [[120.0] * size for _ in range(size)]
    for number in range(size // 4):
        centre_x, centre_y = (int(dice.uniform() * size) for _ in range(2))
        reach_x, reach_y = (3 + int(dice.uniform() * size / 8) for _ in range(2))
        level = 20.0 + 215.0 * dice.uniform()
        for y in range(max(0, centre_y - reach_y), min(size, centre_y + reach_y)):
            for x in range(max(0, centre_x - reach_x), min(size, centre_x + reach_x)):
                if number % 2 or (x - centre_x) ** 2 + (y - centre_y) ** 2 < reach_x * reach_y:
                    levels[y][x] = level
    return [
        [int(min(255.0, max(0.0, level + 6.0 * (dice.uniform() - 0.5)))) for level in row]
        for row in levels
    ]


def flat_frame(level: float, *, seed: int, size: int = 96) -> bytes:
    """Draw a frame of an evenly lit surface.

    It has 4 electrons per code value, 6 electrons of read noise, and the black level 8.

    Parameters
    ----------
    level : float
        Light, code values.
    seed : int
        Of the noise.
    size : int
        Side, px.

    Returns
    -------
    bytes
        A PNG file.
    """
    dice = Dice(seed)
    sigma = math.sqrt(level / 4.0 + 2.25)
    rows = [
        [int(min(255.0, max(0.0, 8.5 + level + sigma * dice.normal()))) for _ in range(size)]
        for _ in range(size)
    ]
    return png_bytes(rows)


def recorded_shake() -> str:
    """Return a recording of a gyroscope: two seconds at 200 Hz."""
    table = io.StringIO()
    writer = csv.writer(table, lineterminator="\n")
    writer.writerow(["t_s", "wx (rad/s)", "wy (rad/s)", "wz (rad/s)"])
    for number in range(401):
        seconds = number / 200
        rates = (
            0.2 * math.sin(9.0 * seconds),
            0.25 * math.cos(6.0 * seconds + 0.4),
            0.15 * math.sin(4.0 * seconds + 1.0),
        )
        writer.writerow([f"{value:.5f}" for value in (seconds, *rates)])
    return table.getvalue()


def recorded_play(bits: str, *, chip_s: float) -> str:
    """Return the play of a code as a table of Saleae Logic."""
    lines = ["Time [s],shutter", "0.000000000,0"]
    lines += [f"{0.01 + number * chip_s:.9f},{bit}" for number, bit in enumerate(bits)]
    lines += [f"{0.01 + len(bits) * chip_s:.9f},0"]
    return "\n".join(lines) + "\n"


def drawn_inputs() -> dict[str, bytes]:
    """Draw the inputs that no command makes.

    Returns
    -------
    dict
        Contents by the name of the file.
    """
    grey = drawn_scene(320, seed=11)
    small = [drawn_scene(160, seed=seed) for seed in (12, 13, 14)]
    colour = [
        [value for pixel in zip(*rows, strict=True) for value in pixel]
        for rows in zip(*small, strict=True)
    ]
    light = [
        [230 if (x - 96) ** 2 + (y - 96) ** 2 < 4 else 6 for x in range(192)] for y in range(192)
    ]
    times = [number / 12 for number in range(13)]
    path = {
        "schema": "cep.trajectory/1",
        "units": "px",
        "direction": "unknown",
        "t": times,
        "x": [round(9.0 * math.sin(2.2 * moment), 4) for moment in times],
        "y": [round(5.0 * moment * moment, 4) for moment in times],
        "alternatives": [{"t": [0, 0.5, 1], "x": [0, 7, 9], "y": [0, 1, 4], "weight": 0.3}],
    }
    backwards = {
        "schema": "cep.trajectory/1",
        "t": [0, 0.6, 0.4, 1],
        "x": [0, 1, 2, 3],
        "y": [0, 0, 0, 0],
    }
    state = {
        "motion": {
            "kind": "path",
            "direction": "known",
            "t": [0, 0.5, 1],
            "x": [-5.0, 0.5, 5.0],
            "y": [0, 1.5, 0.25],
        },
        "bits": "1011001110001111",
        "exposure": "1/30",
        "camera": "video-8bit",
        "photons": 2000,
        "read_noise": None,
        "open": [4, 9],
        "search": {"steps": 500, "seed": 2},
    }
    photo = png_bytes(grey)
    inputs = {
        "sharp.png": photo,
        "colour.png": png_bytes(colour, channels=3),
        "light.png": png_bytes(light),
        "damaged.png": photo[: len(photo) // 2],
        "mtf_old.png": photo[:100],
        "path.json": json.dumps(path, indent=1).encode(),
        "backwards.json": json.dumps(backwards).encode(),
        "studio.json": json.dumps({"schema": "cep.studio/1", "state": state}).encode(),
        "damaged.json": b'{"schema": "cep.code/1", "bits": "1011", "chip_ns": ',
        "gyro.csv": recorded_shake().encode(),
        "capture.csv": recorded_play("110100101111", chip_s=0.001).encode(),
        "own.py": USER_MODULE.encode(),
        "blind.toml": BLIND_PROTOCOL.encode(),
        "coded.toml": CODED_PROTOCOL.encode(),
        "run.toml": TRAINING.encode(),
        "dark1.png": flat_frame(0.0, seed=31),
        "dark2.png": flat_frame(0.0, seed=32),
    }
    for number, level in enumerate((30.0, 90.0, 170.0), start=1):
        inputs[f"flat{number}a.png"] = flat_frame(level, seed=40 + number)
        inputs[f"flat{number}b.png"] = flat_frame(level, seed=50 + number)
    for number in range(5):
        inputs[f"photos/{number}.png"] = png_bytes(drawn_scene(320, seed=60 + number))
    return inputs
