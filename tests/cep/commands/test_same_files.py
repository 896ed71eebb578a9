"""The same seed, the same files: on another day, and on a machine with another number of cores."""

import os
import time
from pathlib import Path

import pytest

COMMANDS = {
    "optimize straight": "optimize --linear 16 --chips 16 --steps 30000 -o OUT/code.json",
    "optimize along a path": (
        "optimize --trajectory trajectory.json --chips 12 --steps 20000 -o OUT/code.json"
    ),
    "optimize a mix": (
        "optimize --linear 16 --chips 16 --objective min-mtf:0.2,noise:1 --steps 20000 -o"
        " OUT/code.json"
    ),
    "a proof": "optimize --linear 27 --chips 27 --method exact -o OUT/code.json",
    "audit": "audit code.json --trajectory trajectory.json -o OUT/audit.json",
    "mtf as svg": "mtf --linear 8 --code code.json -o OUT/mtf.svg",
    "mtf as pdf": "mtf --linear 8 --code code.json -o OUT/mtf.pdf",
    "simulate": (
        "simulate sharp.png --trajectory trajectory.json --code code.json --seed 3 -o"
        " OUT/coded.png"
    ),
    "deblur": "deblur blurred.png --trajectory trajectory.json -o OUT/sharp.png",
    "calibrate": "calibrate blurred.png --method reference --sharp sharp.png -o OUT/motion",
}


@pytest.mark.parametrize("name", COMMANDS)
def test_the_same_bytes(cep, workplace, monkeypatch, name):
    """With ``--steps`` no clock ends a search; what ``--time`` ends depends on the machine, and
    the help says so."""
    for day, cores in (("Mon Jan  1 00:00:00 2024", 1), ("Fri Feb 28 23:59:59 2025", 3)):
        monkeypatch.setattr(time, "asctime", lambda *_, day=day: day)
        monkeypatch.setattr(os, "cpu_count", lambda cores=cores: cores)
        monkeypatch.setattr("cep.search.exhaustive.exact.cpu_count", lambda cores=cores: cores)
        Path(str(cores)).mkdir()
        arguments = COMMANDS[name].replace("OUT", str(cores)).split()
        cep.succeeds(*arguments)
    first, second = (
        {
            item.relative_to(cores): item.read_bytes()
            for item in Path(cores).rglob("*")
            if item.is_file()
        }
        for cores in ("1", "3")
    )
    assert first.keys() == second.keys() != set()
    assert [str(path) for path, data in first.items() if data != second[path]] == []
