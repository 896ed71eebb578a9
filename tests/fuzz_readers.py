"""Mutated files through every reader that a command uses: each must be accepted, or refused in one
clear line.

    python tests/fuzz_readers.py --count 2000 --seed 1

Case K of a seed is always the same file. Readers run in worker processes, so that a crash, a hang
and memory are seen: a case may take 20 s, and 1.5 GiB of address space beyond what the worker had
before it. Prints a table of outcomes, and one line for each case that is neither accepted nor
refused well. Exit code 1 where there is any.
"""

import argparse
import json
import os
import random
import re
import select
import struct
import subprocess
import sys
import tempfile
import time
import warnings
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import cv2
import numpy as np

ACCEPTED = "accepted"
REFUSED = "refused"
GOOD = (ACCEPTED, REFUSED)
BAD = ("unclear", "noisy", "exception", "memory", "hang", "crash")
LONGEST_LINE = 400
LIMIT_S = 20.0
MOST_GROWTH = 1536 * 2**20


# -- readers and good files -----------------------------------------------------------------------


@dataclass(frozen=True)
class Reader:
    """A reader and good files for it: ``mend`` restores checksums and lengths, so that mutations
    reach further in."""

    suffix: str
    seeds: Callable[[], list[bytes]]
    read: Callable[[Path], object]
    text: bool = False
    mend: Callable[[bytes], bytes] | None = None


def _trajectory(path):
    from motdiff.files.trajectories import read_motion

    return read_motion(path)


def _trajectory_seeds():
    path = {"t": [0.0, 0.25, 0.7, 1.0], "x": [-5.0, 0.0, 2.5, 5.0], "y": [0.0, 1.5, -3.0, 0.25]}
    document = {
        "schema": "cep.trajectory/1",
        "units": "px",
        "direction": "unknown",
        **path,
        "weight": 0.7,
        "alternatives": [{"weight": 0.3, **path}],
        "source": {"method": "test", "image": "a.png", "seed": 3},
    }
    return [json.dumps(document, indent=1).encode()]


def _code(path):
    from cep.files.code_files import read_code

    return read_code(path)


def _code_seeds():
    document = {
        "schema": "cep.code/1",
        "bits": "1011001110001111",
        "chip_ns": 250_000,
        "metrics": {"min_mtf": 0.12},
        "problem": {"seed": 3, "open": [4, 9]},
        "certificate": {"lower": 0.11},
    }
    return [json.dumps(document, indent=1).encode()]


def _camera(path):
    from cep.optics.camera import Camera

    return Camera.from_file(path)


def _camera_json_seeds():
    figures = {
        "photons_full_scale": 9000.0,
        "read_noise_e": 3,
        "bits": 12,
        "response": "linear",
        "black_level": 0.01,
    }
    return [json.dumps({"schema": "cep.camera/1", **figures}, indent=1).encode()]


def _camera_toml_seeds():
    profile = _file("cep", "optics", "cameras", "sony-imx250.toml")()
    return [
        *profile,
        (
            b'schema = "cep.camera/1"\nphotons_full_scale = 9000.0\nread_noise_e = 3\nbits ='
            b' 12\nresponse = "srgb"\n'
        ),
    ]


def _studio(path):
    from cep.studio.documents import stored_state

    return stored_state(path)


def _studio_seeds():
    state = {
        "motion": {
            "kind": "path",
            "direction": "known",
            "t": [0, 0.25, 1],
            "x": [-5.0, 0.5, 5.0],
            "y": [0, 1.5, 0.25],
        },
        "bits": "1011001110001111",
        "exposure": "1/30",
        "camera": "video-8bit",
        "photons": 2000,
        "read_noise": None,
        "device": "flc",
        "path_error": 0.25,
        "open": [4, 9],
        "min_open": 2,
        "view": "restored",
        "left": "snapshot",
        "pins": [{"name": "code 1", "bits": "1010"}],
        "photo": "",
        "search": {"steps": 500, "seed": 2},
    }
    parts = {
        "trajectory": {"t": [0, 1], "x": [0, 1], "y": [0, 1]},
        "code": {"bits": "101", "chip_ns": 5},
    }
    return [
        json.dumps(
            {"schema": "cep.studio/1", "state": state, **parts, "commands": ["cep"]}, indent=1
        ).encode()
    ]


def _file(*parts):
    root = Path(__file__).resolve().parent.parent
    return lambda: [root.joinpath(*parts).read_bytes()]


def _coded_protocol(path):
    from lab.bench.coded.protocol import coded_protocol

    return coded_protocol(str(path))


def _blind_protocol(path):
    from lab.bench.blind.protocol import Protocol

    return Protocol.load(path)


def _training_config(path):
    from motdiff.training.config import read_config

    return read_config(path)


def _gyro(path):
    from motdiff.files.gyro_tables import read_gyro

    return read_gyro(path)


def _gyro_seeds():
    rows = [f"{k * 5_000_000},{0.01 * k:.4f},{0.3 - 0.02 * k:.4f},-0.05" for k in range(40)]
    plain = [row.replace(",", " ") for row in rows]
    return ["\n".join(["t_ns,wx,wy,wz", *rows]).encode(), "\n".join(["# phone", *plain]).encode()]


def _capture(path):
    from hw.recordings.recording_file import read_recording

    return read_recording(path)


def _vcd_seeds():
    changes = "".join(f"#{1000 * k}\n{k % 2}!\nb10{k % 2} #\n" for k in range(1, 40))
    head = (
        "$date today $end\n$timescale 1 ns $end\n$scope module hw $end\n$var wire 1 ! shutter"
        " $end\n$var wire 3 # bus $end\n$upscope $end\n$enddefinitions"
        " $end\n#0\n$dumpvars\n0!\nb000 #\n$end\n"
    )
    return [(head + changes).encode()]


def _saleae_seeds():
    rows = [(-0.000_4, 0), *((k * 0.000_2, k % 2) for k in range(1, 40))]
    seconds = "".join(f"{at:.9f},{level}\n" for at, level in rows)
    iso = "".join(f"2026-03-01T12:00:00.{k:03d}200000+00:00,{k % 2}\n" for k in range(40))
    return [f"Time [s],Channel 0\n{seconds}".encode(), f"Time,Channel 0\n{iso}".encode()]


def _device(path):
    from hw.device import load_profile

    return load_profile(path)


def _photo(path):
    from cep.files.images import read_photo

    return read_photo(path)


def _scene(channels=3, dtype=np.uint8):
    rng = np.random.default_rng(5)
    image = np.kron(rng.random((6, 7, channels)), np.ones((8, 8, 1)))[:, :, : max(channels, 1)]
    return (image * np.iinfo(dtype).max).astype(dtype)


def _encoded(suffix, image, *options):
    done, data = cv2.imencode(suffix, image, [int(option) for option in options])
    assert done
    return data.tobytes()


def _png_seeds():
    return [
        _encoded(".png", image) for image in (_scene(), _scene(1), _scene(4), _scene(3, np.uint16))
    ]


def _png_mended(data):
    """Give every chunk the checksum of what it now holds."""
    out = data[:8]
    at = 8
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        if at + 12 + length > len(data):
            break
        body = data[at + 4 : at + 8 + length]
        out += data[at : at + 4] + body + struct.pack(">I", zlib.crc32(body))
        at += 12 + length
    return out + data[at:]


def _tiff_seeds():
    none = (cv2.IMWRITE_TIFF_COMPRESSION, 1)
    lzw = (cv2.IMWRITE_TIFF_COMPRESSION, 5)
    return [
        _encoded(".tif", _scene(), *lzw),
        _encoded(".tif", _scene(1, np.uint16), *none),
        _encoded(".tif", _scene().astype(np.float32) / 255, *none),
        _tiff(_scene(), compression="adobe_deflate", predictor=True, tile=(16, 16), bigtiff=True),
        _tiff(
            _scene(3, np.uint16).transpose(2, 0, 1),
            photometric="rgb",
            planarconfig="separate",
            byteorder=">",
        ),
    ]


def _tiff(image, **options):
    import tifffile

    stream = BytesIO()
    tifffile.imwrite(stream, image, **options)
    return stream.getvalue()


def _jpeg_seeds():
    return [
        _encoded(".jpg", _scene()),
        _encoded(".jpg", _scene(1), cv2.IMWRITE_JPEG_PROGRESSIVE, 1),
    ]


def _webp_seeds():
    return [
        _encoded(".webp", _scene(), cv2.IMWRITE_WEBP_QUALITY, quality) for quality in (80, 101)
    ]


def dng(cfa, *, filters=(0, 1, 1, 2)):
    """Encode a mosaic (H, W) uint16, RGGB unless given, as a DNG whose camera sees sRGB's
    primaries."""
    import tifffile

    to_camera = (
        3.2404542,
        -1.5371385,
        -0.4985314,
        -0.9692660,
        1.8760108,
        0.0415560,
        0.0556434,
        -0.2040259,
        1.0572252,
    )
    matrix = [part for value in to_camera for part in (round(value * 10**7), 10**7)]
    tags = [
        (33421, "H", 2, (2, 2), True),  # CFARepeatPatternDim
        (33422, "B", 4, filters, True),  # CFAPattern
        (50706, "B", 4, (1, 4, 0, 0), True),  # DNGVersion
        (50708, "s", 0, "test", True),  # UniqueCameraModel
        (50714, "H", 1, 0, True),  # BlackLevel
        (50717, "H", 1, 65535, True),  # WhiteLevel
        (50721, "2i", 9, matrix, True),  # ColorMatrix1: from XYZ to the camera
        (50728, "2I", 3, (1, 1, 1, 1, 1, 1), True),  # AsShotNeutral
        (50778, "H", 1, 21, True),  # CalibrationIlluminant1: D65
    ]
    stream = BytesIO()
    tifffile.imwrite(
        stream, cfa, photometric=32803, extratags=tags, metadata=None, software="test"
    )
    return stream.getvalue()


def _dng_seeds():
    return [
        dng(
            np.kron(
                np.random.default_rng(3).integers(2000, 60000, (6, 7)), np.ones((8, 8))
            ).astype(np.uint16)
        )
    ]


def _psf(path):
    from cep.files.psf_files import load_psf

    return load_psf(path)[0]


def _npy_seeds():
    kernel = np.outer([0.0, 1.0, 2.0, 1.0], [1.0, 3.0, 1.0, 0.5]) / 22
    seeds = []
    for stored in (kernel, kernel.astype(np.float32), np.asfortranarray(kernel)):
        stream = BytesIO()
        np.save(stream, stored)
        seeds.append(stream.getvalue())
    return seeds


def _mat(variables, **options):
    from scipy.io import savemat

    stream = BytesIO()
    savemat(stream, variables, **options)
    data = stream.getvalue()
    return (
        data if options.get("format") == "4" else b"MATLAB 5.0 MAT-file".ljust(116) + data[116:]
    )  # has the time


def _mat_seeds():
    kernel = np.outer([0.0, 1.0, 2.0, 1.0], [1.0, 3.0, 1.0, 0.5]) / 22
    extra = {
        "psf": kernel,
        "note": "a text",
        "parts": {"a": 1.0, "b": [1, 2]},
        "cells": np.array([1, "x"], object),
    }
    return [
        _mat({"psf": kernel}),
        _mat(extra),
        _mat(extra, do_compression=True),
        _mat({"psf": kernel}, format="4"),
    ]


def _levin(path):
    from lab.evaluation.sets import levin_photo

    return levin_photo(path)


def _levin_seeds():
    photo = _scene(1)[:, :, 0] / 255
    kernel = np.outer([0.0, 1.0, 2.0], [1.0, 3.0, 1.0]) / 15
    return [
        _mat({"x": photo, "y": photo, "f": kernel}, do_compression=packed)
        for packed in (False, True)
    ]


def _denoiser(path):
    from cep.restoration.denoiser.network import load_denoiser

    return load_denoiser(path)


def _correction(path):
    from motdiff.weights import load_correction

    return load_correction(path)


def _network(path):
    from motdiff.weights import load_network

    return load_network(path)


def _learned_code(path):
    from lab.trainings.dce.weights import load_network

    return load_network(path)


def _safetensors_mended(data):
    """Let the length in front end where the header's JSON does."""
    end = data.rfind(b"}", 8, 1000 + int.from_bytes(data[:8], "little"))
    return struct.pack("<Q", end + 1 - 8) + data[8:] if end > 8 else data


READERS = {
    "trajectory": Reader(".json", _trajectory_seeds, _trajectory, text=True),
    "code": Reader(".json", _code_seeds, _code, text=True),
    "studio": Reader(".json", _studio_seeds, _studio, text=True),
    "camera.json": Reader(".json", _camera_json_seeds, _camera, text=True),
    "camera.toml": Reader(".toml", _camera_toml_seeds, _camera, text=True),
    "coded protocol": Reader(
        ".toml", _file("lab", "bench", "coded", "paper.toml"), _coded_protocol, text=True
    ),
    "blind protocol": Reader(
        ".toml", _file("lab", "bench", "blind", "ours.toml"), _blind_protocol, text=True
    ),
    "training config": Reader(
        ".toml", _file("motdiff", "configs", "gpu.toml"), _training_config, text=True
    ),
    "gyro": Reader(".txt", _gyro_seeds, _gyro, text=True),
    "vcd": Reader(".vcd", _vcd_seeds, _capture, text=True),
    "saleae": Reader(".csv", _saleae_seeds, _capture, text=True),
    "device": Reader(".toml", _file("hw", "profiles", "pulse-pal.toml"), _device, text=True),
    "png": Reader(".png", _png_seeds, _photo, mend=_png_mended),
    "tiff": Reader(".tif", _tiff_seeds, _photo),
    "jpeg": Reader(".jpg", _jpeg_seeds, _photo),
    "webp": Reader(".webp", _webp_seeds, _photo),
    "dng": Reader(".dng", _dng_seeds, _photo),
    "npy": Reader(".npy", _npy_seeds, _psf),
    "mat": Reader(".mat", _mat_seeds, _psf),
    "mat photo": Reader(".mat", _levin_seeds, _photo),
    "levin": Reader(".mat", _levin_seeds, _levin),
    "denoiser": Reader(
        ".safetensors",
        _file("cep", "restoration", "denoiser", "denoiser.safetensors"),
        _denoiser,
        mend=_safetensors_mended,
    ),
    "network": Reader(
        ".safetensors",
        _file("motdiff", "weights", "motdiff.safetensors"),
        _network,
        mend=_safetensors_mended,
    ),
    "correction": Reader(
        ".safetensors",
        _file("motdiff", "weights", "correction.safetensors"),
        _correction,
        mend=_safetensors_mended,
    ),
    "learned code": Reader(
        ".safetensors",
        _file("lab", "trainings", "dce", "dce.safetensors"),
        _learned_code,
        mend=_safetensors_mended,
    ),
}


# -- mutations ------------------------------------------------------------------------------------

_HEAD = 4096
_MOST_BYTES = 2**23  # memory in proportion to a long file is no fault
_NUMBER = re.compile(rb"-?[0-9][0-9.]*")
_NUMBERS = (
    b"0",
    b"-1",
    b"1e400",
    b"-1e400",
    b"1e-400",
    b"NaN",
    b"nan",
    b"inf",
    b"Infinity",
    b"9" * 5000,
    b"1" + b"0" * 400,
    b"9223372036854775808",
    b"18446744073709551616",
    b"0x10",
    b"1_0",
    b"2147483648",
    b"1e18",
    b"0.1",
    b"99999999",
)
_VALUES = (
    b"null",
    b"true",
    b'"text"',
    b"[]",
    b"{}",
    b"[1, 2]",
    b'{"a": 1}',
    b"",
    b'"' + b"x" * 2**20 + b'"',
    b"1979-05-27",
    b"0x" + b"f" * 5000,
    b"[[[1]]]",
    b'"\\u0000"',
    b'"\\ud800"',
    b"'\x1b[31m'",
    b'"line\\nline"',
    b"[" * 10**5,
    b'{"a":' * 10**5,
    b"[" * 10**5 + b"1" + b"]" * 10**5,
    b"[" * 400 + b"1" + b"]" * 400,
)
_WORDS = (
    0,
    1,
    2,
    5,
    9,
    14,
    15,
    0xFF,
    0x7FFF,
    0xFFFF,
    0x7530,
    0x7FFFFFFF,
    0x80000000,
    0xFFFFFFFF,
    0x40000000,
)


def mutated(reader: Reader, rng: random.Random) -> bytes:
    """Draw a file that is not quite one of the reader's good ones."""
    data = rng.choice(reader.seeds())
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        change = rng.choice(_OF_TEXT if reader.text and rng.random() < 0.7 else _OF_BYTES)
        data = change(data, rng)[:_MOST_BYTES]
    return reader.mend(data) if reader.mend is not None and rng.random() < 0.6 else data


def _place(data, rng):
    """Draw an offset; of large files mostly in their head, where all that is not payload
    stands."""
    end = min(len(data), _HEAD) if rng.random() < 0.8 else len(data)
    return rng.randrange(end) if end else 0


def _flip(data, rng):
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 2, 8, 32))):
        if changed:
            changed[_place(data, rng)] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _truncate(data, rng):
    return data[: rng.choice((0, 1, 8, _place(data, rng), len(data) - 1, len(data) // 2))]


def _insert(data, rng):
    at = _place(data, rng)
    piece = rng.choice(
        (
            rng.randbytes(rng.randrange(1, 64)),
            b"\0" * rng.randrange(1, 300),
            b"\xff" * 16,
            b"\n",
            b" ",
        )
    )
    return data[:at] + piece + data[at:]


def _duplicate(data, rng):
    at = _place(data, rng)
    length = rng.choice((1, 4, 16, 200, 5000))
    times = rng.choice((1, 1, 3, 50))
    return data[:at] + data[at : at + length] * times + data[at:]


def _delete(data, rng):
    at = _place(data, rng)
    return data[:at] + data[at + rng.choice((1, 2, 4, 16, 200)) :]


def _overwrite(data, rng):
    at = _place(data, rng)
    length = rng.choice((1, 2, 4, 8, 64))
    piece = rng.choice((b"\0", b"\xff", b"\x7f", rng.randbytes(1))) * length
    return data[:at] + piece[: max(0, len(data) - at)] + data[at + length :]


def _word(data, rng):
    """Put an extreme number in the place of two, four or eight aligned bytes, in either order."""
    size = rng.choice((2, 4, 8))
    at = _place(data, rng) // size * size
    number = rng.choice(_WORDS) & (256**size - 1)
    return data[:at] + number.to_bytes(size, rng.choice(("little", "big"))) + data[at + size :]


def _mark(data, rng):
    return (
        rng.choice(
            (b"\xef\xbb\xbf", b"\xff\xfe", b"\xfe\xff", b"\0", b"\x1f\x8b", b"PK\3\4", b"\n")
        )
        + data
    )


def _append(data, rng):
    return data + rng.choice((data, b"\0" * 1000, rng.randbytes(100), b"\x1a"))


def _recode(data, rng):
    try:
        return data.decode().encode(rng.choice(("utf-16", "utf-32", "utf-8-sig")))
    except UnicodeError:
        return data


def _number(data, rng):
    found = list(_NUMBER.finditer(data, 0, 1 << 16))
    if not found:
        return data
    spot = rng.choice(found)
    return data[: spot.start()] + rng.choice(_NUMBERS) + data[spot.end() :]


def _value(data, rng):
    found = list(re.finditer(rb'(?<=[:=] )[^\n,]+|(?<=[ ,\[])"[^"\n]*"', data)) or list(
        _NUMBER.finditer(data)
    )
    if not found:
        return data
    spot = rng.choice(found)
    return data[: spot.start()] + rng.choice(_VALUES) + data[spot.end() :]


def _line(data, rng):
    lines = data.split(b"\n")
    at = rng.randrange(len(lines))
    what = rng.randrange(5)
    if what == 0:
        del lines[at]
    elif what == 1:
        lines.insert(at, lines[rng.randrange(len(lines))])
    elif what == 2:
        rng.shuffle(lines)
    elif what == 3:
        lines[at] = lines[at][::-1]
    else:
        lines[at] = lines[at] * 300
    return b"\n".join(lines)


def _whole(data, rng):
    return rng.choice(
        (
            b"",
            b"\n",
            b"null",
            b"[]",
            b"{}",
            b"3",
            b'"a"',
            b"\0" * 64,
            b"[" * 10**6,
            rng.randbytes(300),
        )
    )


_OF_BYTES = (
    _flip,
    _flip,
    _truncate,
    _insert,
    _duplicate,
    _delete,
    _overwrite,
    _word,
    _word,
    _word,
    _mark,
    _append,
    _recode,
    _number,
    _whole,
)
_OF_TEXT = (_number, _number, _value, _value, _line, _truncate, _duplicate)


# -- one case -------------------------------------------------------------------------------------


def case(seed: int, number: int) -> tuple[str, bytes]:
    """Reader and content of case ``number``."""
    name = list(READERS)[number % len(READERS)]
    return name, mutated(READERS[name], random.Random(f"{seed}:{number}"))


def outcome(reader: Reader, path: Path) -> tuple[str, str]:
    """Read the file; class of what came out, and a line about it."""
    kept = os.dup(2)
    with tempfile.TemporaryFile() as stderr:
        os.dup2(stderr.fileno(), 2)
        try:
            kind, text = _outcome(reader, path)
        finally:
            os.dup2(kept, 2)
            os.close(kept)
        stderr.seek(0)
        noise = stderr.read().decode(errors="replace")
    return ("noisy", noise[:300]) if noise and kind in GOOD else (kind, text)


def _outcome(reader: Reader, path: Path) -> tuple[str, str]:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            reader.read(path)
    except MemoryError as error:
        return "memory", repr(error)[:300]
    except Warning as error:
        return "noisy", f"{type(error).__name__}: {error}"[:300]
    except (ValueError, OSError) as error:
        said = (
            f"{error.filename}: {error.strerror}"
            if isinstance(error, OSError) and error.filename
            else str(error)
        )
        clear = (
            path.name in said
            and said.isprintable()
            and len(said.replace(str(path), "")) <= LONGEST_LINE
        )
        return (
            REFUSED if clear else "unclear"
        ), f"{type(error).__name__}: {said[:300]!r} ({len(said)} characters)"
    except Exception as error:
        return "exception", f"{type(error).__name__}: {error}"[:300]
    return ACCEPTED, ""


# -- many cases -----------------------------------------------------------------------------------


def _work(seed: int, numbers: range) -> None:
    """Judge cases in this process; a line when each begins and ends. Ends after one that took too
    much memory."""
    import resource

    with tempfile.TemporaryDirectory() as folder:
        for (
            name,
            reader,
        ) in READERS.items():  # libraries are loaded, and threads started, before memory counts
            good = Path(folder) / f"good{reader.suffix}"
            good.write_bytes(reader.seeds()[0])
            if name != "webp":
                outcome(reader, good)
        base = _kilobytes("VmSize") * 1024
        resource.setrlimit(resource.RLIMIT_AS, (base + 3 * MOST_GROWTH, resource.RLIM_INFINITY))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        for number in numbers:
            name, data = case(seed, number)
            path = Path(folder) / f"case{READERS[name].suffix}"
            path.write_bytes(data)
            _say(begin=number, reader=name)
            base = _kilobytes("VmSize") * 1024
            kind, text = outcome(READERS[name], path)
            grown = _kilobytes("VmPeak") * 1024 - base
            excess = grown > MOST_GROWTH
            _say(
                end=number,
                reader=name,
                kind="memory" if excess else kind,
                text=text or f"{grown / 2**20:.0f} MiB",
            )
            if excess:  # the peak cannot be reset
                return


def _say(**fields):
    sys.stdout.write(json.dumps(fields) + "\n")
    sys.stdout.flush()


def _kilobytes(field):
    status = Path("/proc/self/status").read_text()
    return int(re.search(rf"{field}:\s*(\d+)", status)[1])


def _outcomes(seed: int, count: int) -> Iterator[tuple[int, str, str, str]]:
    """Number, reader, class and line of every case, from workers that are replaced when they
    die."""
    at = 0
    while at < count:
        command = [sys.executable, __file__, "--seed", str(seed), "--worker", str(at), str(count)]
        with subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
        ) as worker:
            begun = ""  # loading the libraries
            waited = time.monotonic() + 300
            buffer = b""
            while True:
                ready, _, _ = select.select(
                    [worker.stdout], [], [], max(0.0, waited - time.monotonic())
                )
                if not ready:
                    worker.kill()
                    yield at, begun, "hang", f"longer than {LIMIT_S:g} s"
                    at += 1
                    break
                piece = os.read(worker.stdout.fileno(), 1 << 16)
                if not piece:
                    if begun:
                        yield at, begun, "crash", f"exit status {worker.wait()}"
                        at += 1
                    break
                *lines, buffer = (buffer + piece).split(b"\n")
                for line in lines:
                    said = json.loads(line)
                    if "begin" in said:
                        begun = said["reader"]
                        waited = time.monotonic() + LIMIT_S
                    else:
                        yield said["end"], said["reader"], said["kind"], said["text"]
                        begun = ""
                        at = said["end"] + 1
                        waited = time.monotonic() + 60


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, help="folder to write the files of bad cases into")
    parser.add_argument("--worker", type=int, nargs=2, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker:
        _work(given.seed, range(*given.worker))
        return 0
    counts = Counter()
    for number, name, kind, text in _outcomes(given.seed, given.count):
        counts[name, kind] += 1
        if kind in BAD:
            print(f"case {number}, {name}: {kind}: {text}", flush=True)  # noqa: T201
            if given.keep:
                given.keep.mkdir(exist_ok=True)
                (given.keep / f"{number}{READERS[name].suffix}").write_bytes(
                    case(given.seed, number)[1]
                )
    kinds = (*GOOD, *BAD)
    rows = [("reader", *kinds)]
    rows += [(name, *(str(counts[name, kind]) for kind in kinds)) for name in READERS]
    rows += [("all", *(str(sum(counts[name, kind] for name in READERS)) for kind in kinds))]
    for row in rows:
        print(f"{row[0]:16s}", *(f"{cell:>10s}" for cell in row[1:]))  # noqa: T201
    return int(any(kind in BAD for _, kind in counts))


if __name__ == "__main__":
    sys.exit(main())
