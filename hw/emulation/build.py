"""Compile the simavr board on the user's machine: linked with simavr (GPL) its binary is never
shipped.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from importlib.resources import files
from pathlib import Path

_WANTED = "install gcc, libsimavr-dev and libelf-dev (as they are called on Debian and Ubuntu)"
_MISSING = {
    "sim_avr.h": "libsimavr-dev",
    "-lsimavr": "libsimavr-dev",
    "-lelf": "libelf-dev",
    "libelf": "libelf-dev",
}


class EmulationError(RuntimeError):
    """An emulated device cannot be built, or has died."""


def build_board() -> Path:
    """Return the emulated Uno's program, compiled into the user's cache folder the first time.

    Raises
    ------
    EmulationError
        If a compiler or a library is missing.
    """
    if not sys.platform.startswith("linux"):
        raise EmulationError("emulated Uno runs on Linux only: on Windows use WSL")
    shipped = files("hw.emulation").joinpath("board")
    sources = {
        file.name: file.read_bytes()
        for file in shipped.iterdir()
        if file.name.endswith((".c", ".h"))
    }
    digest = hashlib.sha256(
        b"".join(name.encode() + text for name, text in sorted(sources.items()))
    ).hexdigest()
    board = _cache() / f"simavr_uno-{digest[:16]}"
    if board.exists():
        return board
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        raise EmulationError(f"emulated Uno needs a C compiler and simavr: {_WANTED}")
    board.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=board.parent) as folder:
        for name, text in sources.items():
            Path(folder, name).write_bytes(text)
        modules = sorted(name for name in sources if name.endswith(".c"))
        command = [
            compiler,
            "-O2",
            *_include_flags(),
            *modules,
            "-o",
            board.name,
            "-lsimavr",
            "-lelf",
            "-lutil",
        ]
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, errors="replace", check=False
        )
        if done.returncode:
            raise EmulationError(_reason(done.stderr))
        os.replace(
            Path(folder, board.name), board
        )  # two that compile at once end with the same whole file
    return board


def _cache() -> Path:
    home = os.environ.get("XDG_CACHE_HOME")
    return (Path(home) if home else Path.home() / ".cache") / "coded-exposure"


def _include_flags() -> list[str]:
    # simavr's headers include one another without their folder's name.
    if shutil.which("pkg-config"):
        asked = subprocess.run(
            ["pkg-config", "--cflags", "simavr"], capture_output=True, text=True, check=False
        )
        if asked.returncode == 0:
            return asked.stdout.split()
    return ["-I/usr/include/simavr", "-I/usr/local/include/simavr"]


def _reason(messages: str) -> str:
    for sign, package in _MISSING.items():
        if sign in messages:
            return f"emulated Uno cannot be compiled without {package}: {_WANTED}"
    first = next(
        (line for line in messages.splitlines() if "error" in line), "the compiler says nothing"
    )
    return f"emulated Uno cannot be compiled ({' '.join(first.split())[:160]}): {_WANTED}"
