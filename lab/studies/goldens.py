"""Goldens: run every command with small fixed inputs, and compare what checkouts print and write.

A refactoring that should change nothing is held against a record of the checkout before it::

    python -m lab.studies.goldens record --root BEFORE -o before
    python -m lab.studies.goldens record --root AFTER -o after --inputs before/inputs
    python -m lab.studies.goldens compare before after

Each case runs in a fresh folder with copies of the inputs. ``DIR/NAME`` then holds ``stdout``,
``stderr``, ``exit``, ``files.json`` (the files written, with their SHA-256) and in ``files``
copies of the small ones. What differs from run to run, as paths, times and rates, is replaced by
placeholders first: see ``RULES`` and ``COSTS``. The inputs are drawn here and by the commands of
``PREPARATION``; with ``--inputs`` those of an earlier record are taken instead, so that a
difference in one of these commands does not show in all other cases.
"""

from __future__ import annotations

import argparse
import csv
import difflib
import hashlib
import io
import json
import math
import os
import re
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

COPIED_BYTES = 200_000
"""Files up to this size are copied into the record."""

LIMIT_S = 240.0
"""A case that runs longer is ended, and recorded as such."""

RELATIVE = 1e-6
"""Numbers that differ by less, relatively, count as equal."""


MOVED = {
    "cep bench": "python -m lab bench",
    "cep pareto": "python -m lab pareto",
    "cep refine": "cep calibrate",
    "cep camera show": "cep camera list",
    "cep hw list": "cep hw info",
    "cep hw load": "cep upload",
    "cep hw arm": "cep upload code.json --arm",
}
"""Beginnings of command lines of 0.2, with those of checkouts that have a folder ``lab``."""


@dataclass(frozen=True)
class Case:
    """A command line, and how it is run.

    Attributes
    ----------
    name : str
        Command and form; the name of its folder in a record.
    argv : str
        Command line as typed in a shell; it begins with ``cep`` or ``python -m PACKAGE``.
    emulator : bool
        Whether an emulated controller runs beside it, at the port ``uno``.
    first : str
        Command line that is run before, in the same folder, and not recorded.
    """

    name: str
    argv: str
    emulator: bool = False
    first: str = ""

    def words(self, root: Path) -> list[str]:
        """Return the command line for a checkout."""
        return shlex.split(moved(self.argv, root))


def moved(line: str, root: Path) -> str:
    """Return a command line as a checkout has it."""
    if not (root / "lab").is_dir():
        return line
    if line.startswith("cep optimize") and "--frames" in line:
        return line.replace("cep optimize", "python -m lab frames")
    if line.startswith("cep optimize") and "--class" in line:
        return line.replace("cep optimize", "python -m lab design-class")
    for before, after in MOVED.items():
        if line.startswith(before):
            return line.replace(before, after, 1)
    return line


PREPARATION = [
    Case(
        "input-coded",
        "cep simulate sharp.png --trajectory path.json --code 110100101111 --photons 5000 -o"
        " coded.png",
    ),
    Case(
        "input-open",
        "cep simulate sharp.png --trajectory path.json --photons 20000 -o open.png",
    ),
    Case(
        "input-second",
        "cep simulate sharp.png --trajectory path.json --code 101111010011 --photons 5000 -o"
        " second.png",
    ),
    Case(
        "input-colour",
        "cep simulate colour.png --linear 12 --code 110100101111 --photons 5000 -o"
        " colour_coded.png",
    ),
    Case(
        "input-light",
        "cep simulate light.png --trajectory path.json --code 110100101111 --photons 9000 -o"
        " light_coded.png",
    ),
    Case("input-shots-a", "cep simulate sharp.png --linear 9 --photons 20000 -o shot_a.png"),
    Case(
        "input-shots-b",
        "cep simulate sharp.png --trajectory path.json --photons 20000 --seed 3 -o shot_b.png",
    ),
    Case("input-code", "cep optimize --linear 12 --chips 12 --open 6:9 --steps 2000 -o code.json"),
    Case(
        "input-proof",
        "cep optimize --linear 14 --chips 14 --method exact --workers 1 --cache proof -o"
        " proved.json",
    ),
    Case("input-program", "cep export 110100101111 --format vcd --chip-ns 1000000 -o capture.vcd"),
    Case(
        "input-motions-a",
        "cep refine coded.png second.png --code 110100101111 --code 101111010011 --trajectory"
        " path.json --uncertainty 1 -o motions/a/trajectory.json",
    ),
]
"""Commands that make inputs, one after the other in one folder."""

FOLDER_PHOTOS = {"shot_a.png": "shots/a.png", "shot_b.png": "shots/b.png"}
"""Inputs that are copied into a folder of photos, without the PSFs beside them."""

SEARCH = "--steps 2000 --seed 1"
PATH_12 = "--trajectory path.json --chips 12"

CASES = [
    Case("version", "cep --version"),
    # advise
    Case(
        "advise-linear",
        "cep advise --linear 12 --chips 12 --exposure 1/30 --photons 3000 --read-noise 10",
    ),
    Case(
        "advise-linear-json",
        "cep advise --linear 12 --chips 12 --exposure 1/30 --photons 3000 --read-noise 10 --json",
    ),
    Case(
        "advise-path",
        "cep advise --trajectory path.json --chips 12 --camera aptina-mt9m031-8bit --exposure"
        " 20ms",
    ),
    Case(
        "advise-codes",
        "cep advise --linear 12 --chips 12 --code code.json --code 101111010011 --path-error"
        " 0.5 --json",
    ),
    Case(
        "advise-device",
        "cep advise --linear 12 --chips 12 --device sony-pregius --exposure 0.004 -o"
        " advice.png --table advice.csv",
    ),
    Case(
        "advise-chips-omitted",
        "cep advise --linear 10 --exposure 1/30 --camera video-8bit --json",
    ),
    # optimize
    Case("optimize-mse", f"cep optimize --linear 12 --chips 12 {SEARCH} -o code_new.json"),
    Case(
        "optimize-mse-json",
        f"cep optimize --linear 12 --chips 12 {SEARCH} -o code_new.json --json",
    ),
    Case(
        "optimize-path",
        f"cep optimize {PATH_12} {SEARCH} --exposure 1/30 -o code_new.json --json",
    ),
    Case(
        "optimize-path-forward",
        f"cep optimize {PATH_12} {SEARCH} --direction forward -o code_new.json --json",
    ),
    Case(
        "optimize-chips-omitted",
        f"cep optimize --linear 10 {SEARCH} --exposure 20ms -o code_new.json",
    ),
    Case(
        "optimize-min-mtf",
        f"cep optimize {PATH_12} {SEARCH} --objective min-mtf -o code_new.json --json",
    ),
    Case(
        "optimize-flatness",
        f"cep optimize {PATH_12} {SEARCH} --objective flatness -o code_new.json --json",
    ),
    Case(
        "optimize-noise",
        f"cep optimize {PATH_12} {SEARCH} --objective noise -o code_new.json --json",
    ),
    Case(
        "optimize-mix",
        f"cep optimize --linear 12 --chips 12 --open 6 {SEARCH} --objective"
        " min-mtf:0.15,noise:1 -o code_new.json --json",
    ),
    Case(
        "optimize-duty",
        f"cep optimize {PATH_12} --duty 0.4:0.6 {SEARCH} -o code_new.json --table search.md",
    ),
    Case(
        "optimize-open-range",
        f"cep optimize {PATH_12} --open 4:7 {SEARCH} --camera video-8bit -o code_new.json --json",
    ),
    Case(
        "optimize-limits",
        f"cep optimize --linear 16 --chips 16 {SEARCH} --min-open 2 --max-open 5 --min-closed"
        " 2 --min-period 4 --max-pulses 4 --first-open --last-open -o code_new.json --json",
    ),
    Case(
        "optimize-fixed",
        f"cep optimize --linear 12 --chips 12 {SEARCH} --fixed '1???0?1?????' -o code_new.json"
        " --json",
    ),
    Case(
        "optimize-device",
        f"cep optimize {PATH_12} --device flc --chip-ns 100000 {SEARCH} -o code_new.json --json",
    ),
    Case(
        "optimize-uncertain",
        f"cep optimize {PATH_12} {SEARCH} --speed 0.9:1.1 --jitter 0.05 --drift 0.01 -o"
        " code_new.json --json",
    ),
    Case(
        "optimize-alternatives",
        f"cep optimize {PATH_12} {SEARCH} --alternatives --rule mean -o code_new.json --json",
    ),
    Case("optimize-exact", "cep optimize --linear 14 --chips 14 --method exact -o code_new.json"),
    Case(
        "optimize-exact-json",
        "cep optimize --linear 14 --chips 14 --open 7 --method exact -o code_new.json --json",
    ),
    Case(
        "optimize-exact-blocks",
        "cep optimize --linear 14 --chips 14 --method exact --workers 1 --cache blocks -o"
        " code_new.json --json",
    ),
    Case(
        "optimize-frames",
        f"cep optimize --linear 16 --frames 2 --chips 16 --open 8 {SEARCH} -o pair.json",
    ),
    Case(
        "optimize-frames-json",
        f"cep optimize {PATH_12} --frames 2 --open 6 {SEARCH} -o pair.json --json",
    ),
    Case("optimize-each", f"cep optimize --each motions --chips 12 {SEARCH} --workers 1"),
    Case(
        "optimize-each-json",
        f"cep optimize --each motions --chips 12 {SEARCH} --workers 1 -o codes --json",
    ),
    Case(
        "optimize-all",
        f"cep optimize --all motions --chips 12 {SEARCH} -o code_new.json --json",
    ),
    Case(
        "optimize-class",
        f"cep optimize --class walks --length 20 --motions 4 --chips 12 --open 6 {SEARCH} -o"
        " code_new.json",
    ),
    Case(
        "optimize-class-gyro",
        "cep optimize --class gyro.csv --length 20 --motions 4 --chips 12 --exposure 0.1"
        f" {SEARCH} -o code_new.json --json",
    ),
    Case(
        "optimize-figure",
        f"cep optimize {PATH_12} {SEARCH} --figure own:figure -o code_new.json --json",
    ),
    # pareto
    Case(
        "pareto-no-motion",
        f"cep pareto --chips 12 --open 4:8 {SEARCH} -o front.json --plot front.png",
    ),
    Case(
        "pareto-no-motion-json",
        f"cep pareto --chips 12 --open 4:8 {SEARCH} -o front.json --json",
    ),
    Case(
        "pareto-linear",
        f"cep pareto --linear 12 --chips 12 --open 4:8 {SEARCH} -o front.json --table front.tex",
    ),
    Case(
        "pareto-path-json",
        f"cep pareto {PATH_12} --duty 0.3:0.7 {SEARCH} --camera video-8bit -o front.json"
        " --plot front.svg --json",
    ),
    # audit
    Case("audit-bits", "cep audit 1010000111000001010000110011110111010111001001100111 --flips 1"),
    Case("audit-published", "cep audit merl-31-t62 --flips 2"),
    Case("audit-published-json", "cep audit merl-31-t62 --flips 1 --json"),
    Case(
        "audit-code-path",
        "cep audit code.json --trajectory path.json -o audit.json --table audit.csv",
    ),
    Case(
        "audit-code-path-json",
        "cep audit code.json --trajectory path.json --camera video-8bit --json",
    ),
    Case("audit-certificate-json", "cep audit code.json --linear 12 --json"),
    Case(
        "audit-figure",
        "cep audit 110100101111 --linear 12 --figure own:figure --chip-ns 2000000",
    ),
    Case("audit-own-code", "cep audit own:code --flips 1 --json"),
    Case("audit-proof", "cep audit proof/proof.jsonl --blocks 2"),
    Case("audit-proof-json", "cep audit proof/proof.jsonl --blocks 2 --seed 4 --json"),
    # mtf
    Case(
        "mtf-path",
        "cep mtf --trajectory path.json --code code.json --code barker-13 -o mtf.png --table"
        " mtf.csv",
    ),
    Case(
        "mtf-linear-json",
        "cep mtf --linear 12 --code 110100101111 --figure own:figure -o mtf.svg --json",
    ),
    Case("mtf-pdf", "cep mtf --linear 12 --code bdinr-8 -o mtf.pdf"),
    # simulate
    Case("simulate-linear", "cep simulate sharp.png --linear 12"),
    Case(
        "simulate-linear-json",
        "cep simulate sharp.png --linear 12 --camera sony-imx250 --seed 5 -o new.tif --json",
    ),
    Case(
        "simulate-linear-gamma",
        "cep simulate colour.png --linear 12 --code bdinr-8 --gamma 2.2 -o new.png",
    ),
    Case(
        "simulate-path-json",
        "cep simulate colour.png --trajectory path.json --code code.json --read-noise 20 -o"
        " new.png --json",
    ),
    # deblur
    Case(
        "deblur-auto",
        "cep deblur coded.png --trajectory path.json --code 110100101111 -o sharp_new.png",
    ),
    Case(
        "deblur-auto-json",
        "cep deblur coded.png --trajectory path.json --code 110100101111 -o sharp_new.png --json",
    ),
    *[
        Case(
            f"deblur-{method}",
            f"cep deblur colour_coded.png --linear 12 --code 110100101111 --method {method}"
            f"{' --photons 5000' if method in ('wiener', 'pnp') else ''} -o sharp_new.png --json",
        )
        for method in ("wiener", "inverse", "tv", "l0", "tv-ring", "pnp")
    ],
    Case(
        "deblur-own",
        "cep deblur coded.png --linear 12 --code 110100101111 --method own:restore -o"
        " sharp_new.png",
    ),
    Case("deblur-psf", "cep deblur coded.png --psf coded_psf.npy -o sharp_new.png --json"),
    Case("deblur-open-path", "cep deblur open.png --trajectory path.json"),
    Case("deblur-blind-coded", "cep deblur coded.png --code 110100101111 -o sharp_new.png --json"),
    Case("deblur-blind-open", "cep deblur open.png"),
    Case("deblur-blind-sharp", "cep deblur sharp.png --json"),
    # calibrate
    Case("calibrate-pmp", "cep calibrate open.png --method pmp -o motion"),
    Case(
        "calibrate-pmp-json",
        "cep calibrate open.png --method pmp --gamma linear -o motion --json",
    ),
    Case("calibrate-pmp-several", "cep calibrate shot_b.png open.png --method pmp -o motion"),
    Case(
        "calibrate-pmp-folder",
        "cep calibrate shots --method pmp -o motions_new --workers 1 --table motions.md",
    ),
    Case(
        "calibrate-pmp-folder-json",
        "cep calibrate shots --method pmp -o motions_new --workers 1 --json",
    ),
    Case("calibrate-motdiff-json", "cep calibrate open.png --samples 1 -o motion --json"),
    Case(
        "calibrate-reference",
        "cep calibrate open.png --method reference --sharp sharp.png -o motion",
    ),
    Case(
        "calibrate-reference-json",
        "cep calibrate open.png --method reference --sharp sharp.png -o motion --json",
    ),
    Case(
        "calibrate-point",
        "cep calibrate light_coded.png --method point --code 110100101111 -o motion --json",
    ),
    Case(
        "calibrate-gyro",
        "cep calibrate open.png --method gyro --gyro gyro.csv --focal 800 --start 0.5"
        " --exposure 1/20 -o motion",
    ),
    Case(
        "calibrate-gyro-json",
        "cep calibrate open.png --method gyro --gyro gyro.csv --focal 800 --start 0.5"
        " --exposure 50ms --gyro-axes right,up,back --gyro-unit rad -o motion --json",
    ),
    Case(
        "calibrate-coded",
        "cep calibrate open.png coded.png --code open --code 110100101111 -o motion",
    ),
    Case("calibrate-own", "cep calibrate open.png --method own:Estimator -o motion --json"),
    # calibration-set
    Case(
        "calibration-set-two",
        "cep calibration-set --photos 2 --chips 16 -o set --table set.csv",
    ),
    Case(
        "calibration-set-one-json",
        "cep calibration-set --photos 1 --chips 16 --device flc --format c -o set --json",
    ),
    # refine
    Case("refine-one", "cep refine coded.png --code 110100101111 --trajectory path.json"),
    Case(
        "refine-two-json",
        "cep refine coded.png second.png --code 110100101111 --code 101111010011 --trajectory"
        " path.json --uncertainty 1 -o better.json --json",
    ),
    # export
    *[
        Case(f"export-{form}", f"cep export code.json --format {form}")
        for form in (
            "csv",
            "json",
            "vcd",
            "c",
            "arduino",
            "rp2",
            "pulsepal",
            "scpi",
            "camera",
            "dmd",
        )
    ],
    Case(
        "export-device-json",
        "cep export 110100101111 --format arduino --chip-ns 1000001 --device cxp-avr -o"
        " new.ino --json",
    ),
    # cite
    Case("cite-all", "cep cite"),
    Case("cite-names", "cep cite pmp raskar-52 dnf -o works.bib"),
    Case("cite-json", "cep cite pmp dce raskar2006 --json"),
    # camera
    Case("camera-list", "cep camera list --table cameras.md"),
    Case("camera-list-json", "cep camera list --json"),
    Case("camera-show", "cep camera show sony-imx250"),
    Case("camera-show-json", "cep camera show video-8bit --json"),
    Case(
        "camera-estimate",
        "cep camera estimate flat1a.png flat1b.png flat2a.png flat2b.png flat3a.png"
        " flat3b.png --dark dark1.png dark2.png -o camera.toml --table levels.csv",
    ),
    Case(
        "camera-estimate-json",
        "cep camera estimate flat1a.png flat1b.png flat2a.png flat2b.png flat3a.png"
        " flat3b.png --black 8 --bits 8 -o camera.json --plot curve.svg --json",
    ),
    # studio
    Case("studio-extract", "cep studio studio.json --extract design"),
    Case("studio-extract-json", "cep studio studio.json --extract design --json"),
    # demo
    Case(
        "demo-photo-json",
        "cep demo --photo open.png --chips 12 --camera video-8bit -o demo --json",
    ),
    # hardware
    Case("hw-list-json", "cep hw list --json"),
    Case(
        "hw-verify-vcd",
        "cep hw verify 110100101111 --capture capture.vcd --chip-ns 1000000 --linear 12 -o"
        " played.json",
    ),
    Case(
        "hw-verify-vcd-json",
        "cep hw verify 110100101111 --vcd capture.vcd --trajectory path.json -o played.json"
        " --json",
    ),
    Case("hw-verify-csv", "cep hw verify 110100101111 --capture capture.csv --table plays.csv"),
    Case("hw-verify-differs", "cep hw verify 110100101110 --capture capture.vcd --json"),
    Case("hw-emulate", "cep hw emulate uno --link board --seconds 0.5"),
    Case("hw-info", "cep hw info --port uno", emulator=True),
    Case("hw-info-json", "cep hw info --port uno --json", emulator=True),
    Case("hw-load", "cep hw load code.json --port uno", emulator=True),
    Case("hw-load-json", "cep hw load code.json --port uno --clock-ppm 20 --json", emulator=True),
    Case("hw-arm-empty", "cep hw arm --port uno", emulator=True),
    Case("hw-trigger-empty", "cep hw trigger --port uno --json", emulator=True),
    Case(
        "hw-arm",
        "cep hw arm --port uno --lease-ms 5000",
        emulator=True,
        first="cep hw load code.json --port uno",
    ),
    Case(
        "hw-trigger",
        "cep hw trigger --port uno",
        emulator=True,
        first="cep upload code.json --port uno --arm",
    ),
    Case(
        "hw-verify-port",
        "cep hw verify code.json --port uno",
        emulator=True,
        first="cep hw load code.json --port uno",
    ),
    Case("hw-calibrate", "cep hw calibrate --port uno --seconds 1", emulator=True),
    Case("hw-abort", "cep hw abort --port uno", emulator=True),
    Case("hw-monitor", "cep hw monitor --port uno --seconds 0.3", emulator=True),
    Case("hw-verify-port-empty", "cep hw verify code.json --port uno --json", emulator=True),
    Case("upload", "cep upload code.json --port uno", emulator=True),
    Case(
        "upload-arm-json",
        "cep upload code.json --port uno --arm --lease-ms 5000 -o upload.json --json",
        emulator=True,
    ),
    Case("upload-play-json", "cep upload code.json --port uno --play --json", emulator=True),
    # bench
    Case(
        "bench-blind",
        "cep bench blind --data photos --protocol blind.toml --methods pmp --workers 1 -o blind",
    ),
    Case(
        "bench-blind-json",
        "cep bench blind --data photos --protocol blind.toml --methods"
        " parametric,own:Estimator --workers 1 -o blind --json",
    ),
    Case(
        "bench-speed",
        "cep bench speed --data photos --protocol blind.toml --methods own:Estimator -o speed",
    ),
    Case(
        "bench-cep",
        "cep bench cep --data photos --protocol coded.toml --designs open,random,both-ways"
        " --workers 1 -o coded",
    ),
    Case(
        "bench-cep-json",
        "cep bench cep --data photos --protocol coded.toml --designs dnf,oracle --code"
        " mine=own:code --set 'restoration=\"own:restore\"' --workers 1 -o coded --json",
    ),
    Case(
        "bench-codes",
        "cep bench codes bdinr-8 --code mine=1101001 --time 1 --workers 1 -o codes",
    ),
    # python -m motdiff
    Case("motdiff-sample", "python -m motdiff sample open.png -o drawn.png --count 1 --steps 2"),
    Case("motdiff-pack", "python -m motdiff pack photos photos.zip --side 64"),
    Case("motdiff-prepare", "python -m motdiff prepare run.toml -o samples --shards 0:1"),
    Case(
        "motdiff-train",
        "python -m motdiff train run.toml -o run --device cpu --validate-every 2",
    ),
    # bad input
    Case("bad-no-command", "cep nonsense"),
    Case("bad-option", "cep mtf --nonsense 3"),
    Case("bad-missing-photo", "cep deblur missing.png --linear 12"),
    Case("bad-missing-photo-json", "cep deblur missing.png --linear 12 --json"),
    Case("bad-missing-code", "cep audit missing.json"),
    Case("bad-damaged-json", "cep audit damaged.json"),
    Case("bad-damaged-trajectory", "cep optimize --trajectory damaged.json --steps 10"),
    Case("bad-trajectory-order", "cep mtf --trajectory backwards.json --code bdinr-8"),
    Case("bad-schema", "cep audit path.json"),
    Case("bad-damaged-png", "cep deblur damaged.png --linear 12"),
    Case("bad-bits", "cep audit 10102"),
    Case("bad-bits-closed", "cep audit 0000"),
    Case("bad-bits-hostile", "cep export '$(touch ran)' --format c"),
    Case("bad-bits-long", "cep audit " + "10" * 3000),
    Case("bad-name", "cep audit raskar-53"),
    Case("bad-module", "cep audit nowhere:code"),
    Case("bad-motion-missing", "cep optimize --chips 12 --steps 10"),
    Case("bad-motion-twice", "cep optimize --linear 12 --trajectory path.json --steps 10"),
    Case("bad-open-and-duty", "cep optimize --linear 12 --chips 12 --open 6 --duty 0.4:0.6"),
    Case("bad-open-range", "cep optimize --linear 12 --chips 12 --open 9:40 --steps 10"),
    Case(
        "bad-objective",
        "cep optimize --linear 12 --chips 12 --objective nicest --steps 10 -o code_new.json",
    ),
    Case(
        "bad-exact-objective",
        "cep optimize --linear 12 --chips 12 --method exact --objective noise -o code_new.json",
    ),
    Case("bad-limits", "cep optimize --linear 12 --chips 12 --fixed 1??0 --steps 10"),
    Case("bad-camera", "cep advise --linear 12 --camera kodak-brownie"),
    Case("bad-device", "cep export code.json --format csv --device guillotine"),
    Case("bad-format", "cep export code.json --format exe"),
    Case(
        "bad-device-too-fast",
        "cep export 110100101111 --format csv --chip-ns 1000 --device mechanical",
    ),
    Case("bad-method", "cep deblur coded.png --linear 12 --method magic"),
    Case("bad-psf-and-linear", "cep deblur coded.png --linear 12 --psf coded_psf.npy"),
    Case("bad-output-exists", "cep mtf --linear 12 --code bdinr-8 -o mtf_old.png"),
    Case("bad-output-suffix", "cep mtf --linear 12 --code bdinr-8 -o mtf.xyz"),
    Case("bad-output-folder", "cep mtf --linear 12 --code bdinr-8 -o nowhere/mtf.png"),
    Case("bad-calibrate-method", "cep calibrate open.png --method magic"),
    Case("bad-calibrate-reference", "cep calibrate open.png --method reference"),
    Case("bad-calibrate-codes", "cep calibrate open.png coded.png --code open"),
    Case(
        "bad-gyro",
        "cep calibrate open.png --method gyro --gyro own.py --focal 800 --start 0.5"
        " --exposure 1/20",
    ),
    Case("bad-refine-open", "cep refine open.png --code open --trajectory path.json"),
    Case("bad-camera-estimate", "cep camera estimate flat1a.png --dark dark1.png dark2.png"),
    Case("bad-cite", "cep cite newton"),
    Case("bad-studio", "cep studio path.json --extract design"),
    Case("bad-port", "cep upload code.json --port no_port"),
    Case(
        "bad-bench-method",
        "cep bench blind --data photos --protocol blind.toml --methods magic",
    ),
    Case("bad-bench-data", "cep bench --quick --data missing"),
    Case("bad-bench-protocol", "cep bench cep --data photos --protocol nobody --designs open"),
    Case("bad-proof", "cep audit damaged.jsonl"),
    Case("bad-motdiff-config", "python -m motdiff train blind.toml -o run"),
    Case("bad-motdiff-command", "python -m motdiff eval"),
]
"""The cases, in the order of a record."""


# Inputs that no command makes

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
    second = {
        "schema": "cep.trajectory/1",
        "direction": "known",
        "t": [0, 0.5, 1],
        "x": [0, 6, 8],
        "y": [0, -2, 5],
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
        "motions/b/trajectory.json": json.dumps(second).encode(),
        "studio.json": json.dumps({"schema": "cep.studio/1", "state": state}).encode(),
        "damaged.json": b'{"schema": "cep.code/1", "bits": "1011", "chip_ns": ',
        "damaged.jsonl": b'{"schema": "cep.proof/1", "version": 1}\n{}\n',
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


# Normalisation

RULES: list[tuple[str, re.Pattern[str], str]] = [
    (r".*", re.compile(r'("(?:seconds|cpu_s)"): [\d.eE+-]+'), r'\1: "<seconds>"'),
    (
        r"stdout|stderr",
        re.compile(r"(?<=[;,] )[\d.,eE+-]+ s(?=[,.;]|$)", re.MULTILINE),
        "<seconds> s",
    ),
    (r"stdout", re.compile(r'"(cpu_s|wall_s|memory_mib)": \{[^{}]*\}'), r'"\1": "<cost>"'),
    (r"stdout", re.compile(r'("uptime_s": )[\d.]+'), r"\1<seconds>"),
    (r"stdout|.*\.md", re.compile(r"[\d.,]+ CPU-s"), "<cost> CPU-s"),
    (r".*\.html", re.compile(r"Seconds: [^<]*"), "Seconds: <seconds>"),
    (r"stdout", re.compile(r"^ +[\d.]+ s  idle", re.MULTILINE), "<seconds> s  idle"),
    (r"stdout", re.compile(r"\d+ looks"), "<several> looks"),
    (r"stdout", re.compile(r"clock is .*"), "clock is <measured>"),
    (r"stderr", re.compile(r"cep: warning: a crystal is within .*\n"), ""),
    (r"stdout", re.compile(r" +$", re.MULTILINE), ""),
    (r"stdout", re.compile(r"─{3,}"), "───"),
]
"""Pattern of names of files (``stdout``, ``stderr``: the streams), what is replaced, by what."""

COSTS = frozenset({"s", "seconds", "CPU-s", "MiB", "cpu_s", "wall_s", "memory_mib", "uptime s"})
"""Heads of the columns of tables, and names of their rows, whose values are replaced."""

EMBEDDED = re.compile(r"(?<=base64,)[A-Za-z0-9+/=\s]{200,}")
"""Pictures in a page; their SHA-256 takes their place."""

PASSED_OVER = re.compile(r"(?:.*/)?cells/[0-9a-f]{64}\.json")
"""Finished cells of folders and tables: their names and versions follow the sources, and their
figures are in the tables."""


def normalised(text: str, name: str, places: Mapping[str, str]) -> str:
    """Replace what differs from run to run.

    Parameters
    ----------
    text : str
        Of a stream or a file.
    name : str
        Path of the file, or ``stdout`` or ``stderr``.
    places : mapping
        Placeholders by the absolute path that they stand for.

    Returns
    -------
    str
        The text with placeholders.
    """
    for place in sorted(places, key=len, reverse=True):
        text = text.replace(place, places[place])
    if name == "stdout":
        text = drawn_tables_without_costs(text)
    for names, pattern, placeholder in RULES:
        if re.fullmatch(names, name):
            text = pattern.sub(placeholder, text)
    if name.endswith(".html"):
        return EMBEDDED.sub(lambda match: hashlib.sha256(match[0].encode()).hexdigest(), text)
    if name.endswith(".csv"):
        return csv_without_costs(text)
    if name.endswith(".json"):
        return bench_without_costs(text)
    if name.endswith(".tex"):
        return tex_without_costs(text)
    return marked_tables_without_costs(text)


def csv_without_costs(text: str) -> str:
    """Replace the columns of costs of a table in CSV, and the rows whose figure is a cost."""
    rows = list(csv.reader(io.StringIO(text)))
    if not rows or not (COSTS | {"figure"}) & set(rows[0]):
        return text
    figure = rows[0].index("figure") if "figure" in rows[0] else None
    fresh = [rows[0]]
    for row in rows[1:]:
        if figure is not None and len(row) > figure and row[figure] in COSTS:
            fresh.append([*row[: figure + 1], "<cost>"])
        else:
            fresh.append(without_costs(rows[0], row))
    written = io.StringIO()
    csv.writer(written, lineterminator="\n").writerows(fresh)
    return written.getvalue()


def bench_without_costs(text: str) -> str:
    """Replace the costs and the machines in the JSON file of a benchmark."""
    try:
        document = json.loads(text)
    except ValueError:
        return text
    if not isinstance(document, dict) or not str(document.get("schema", "")).startswith(
        "cep.bench/"
    ):
        return text
    document["machines"] = "<machines>"
    for table in document.get("tables", ()):
        costs = [
            number for number, column in enumerate(table["columns"]) if column["figure"] in COSTS
        ]
        for row in table["rows"]:
            for number in costs:
                row["entries"][number] = "<cost>"
    return json.dumps(document, indent=1) + "\n"


def marked_tables_without_costs(text: str) -> str:
    """Replace the entries of the columns of costs of tables in Markdown."""
    lines = []
    heads: list[str] = []
    for line in text.split("\n"):
        cells = (
            [cell.strip() for cell in line.strip().strip("|").split("|")]
            if line.startswith("|")
            else []
        )
        if not cells:
            heads = []
        elif not heads:
            heads = cells
        elif COSTS & set(heads) and not line.startswith("| ---"):
            line = f"| {' | '.join(without_costs(heads, cells))} |"
        lines.append(line)
    return "\n".join(lines)


def tex_without_costs(text: str) -> str:
    """Replace the entries of the columns of costs of tables in LaTeX."""
    lines = []
    heads: list[str] = []
    for line in text.split("\n"):
        cells = [cell.strip() for cell in line.strip().removesuffix(r"\\").split("&")]
        if r"\toprule" in line:
            heads = []
        elif len(cells) > 1 and not heads:
            heads = cells
        elif len(cells) > 1 and COSTS & set(heads):
            line = " & ".join(without_costs(heads, cells))
        lines.append(line)
    return "\n".join(lines)


def drawn_tables_without_costs(text: str) -> str:
    """Replace the columns of costs of tables drawn for people: a line of heads above a rule."""
    lines = text.split("\n")
    for number, line in enumerate(lines):
        if number == 0 or not re.fullmatch(r" ?─+ ?", line):
            continue
        last = next(
            (below for below in range(number, len(lines)) if not lines[below].strip()), len(lines)
        )
        rows = [lines[number - 1], *lines[number + 1 : last]]
        cells = in_columns(rows)
        if COSTS & {*cells[0], *(row[0] for row in cells)}:
            fresh = [cells[0], *(without_costs(cells[0], row) for row in cells[1:])]
            lines[number - 2 : last + 1] = ["", *(" | ".join(row) for row in fresh), ""]
            return "\n".join(
                [*lines[:number], drawn_tables_without_costs("\n".join(lines[number:]))]
            )
    return text


def in_columns(rows: Sequence[str]) -> list[list[str]]:
    """Cut lines into cells where all of them have three spaces or more."""
    width = max(len(row) for row in rows)
    blank = "".join(
        "x" if any(row[i : i + 1].strip() for row in rows) else " " for i in range(width)
    )
    spans = [match.span() for match in re.finditer(r"x(?: {0,2}x)*", blank)]
    return [[row[first:last].strip() for first, last in spans] for row in rows]


def without_costs(heads: Sequence[str], cells: Sequence[str]) -> list[str]:
    """Return the cells of a row with a placeholder in each column of costs."""
    if cells[0] in COSTS:
        return [cells[0], *("<cost>" for _ in cells[1:])]
    return [
        "<cost>" if number < len(heads) and heads[number] in COSTS and cell else cell
        for number, cell in enumerate(cells)
    ]


def as_text(data: bytes) -> str | None:
    """Decode a file that is text; None for any other."""
    if b"\0" in data:
        return None
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError:
        return None


def normalised_file(path: Path, name: str, places: Mapping[str, str]) -> bytes:
    """Return the content of a file, with placeholders where it is text.

    An archive is listed, with the checksums of its files: it states the time of its making.
    """
    if path.suffix == ".zip" and zipfile.is_zipfile(path):
        with zipfile.ZipFile(path) as archive:
            entries = [f"{entry.filename} {entry.CRC:08x}\n" for entry in archive.infolist()]
        return "".join(entries).encode()
    data = path.read_bytes()
    text = as_text(data)
    return data if text is None else normalised(text, name, places).encode()


# Recording


@dataclass(frozen=True)
class Outcome:
    """What a command left behind.

    Attributes
    ----------
    stdout, stderr : str
        Normalised.
    exit_status : str
        Exit code, or ``ended after N s``.
    """

    stdout: str
    stderr: str
    exit_status: str


class Recorder:
    """Runs cases of a checkout and stores what they leave behind.

    Parameters
    ----------
    root : Path
        The checkout, with its ``.venv``.
    target : Path
        Folder of the record.
    scratch : Path
        Temporary folder for the home and the working folders.
    """

    def __init__(self, root: Path, target: Path, scratch: Path) -> None:
        self._root = root
        self._target = target
        self._scratch = scratch
        self._home = scratch / "home"
        self._temporary = scratch / "tmp"
        for folder in (self._home, self._temporary):
            folder.mkdir()
        self.seconds: dict[str, float] = {}

    def prepare(self, folder: Path) -> None:
        """Make the inputs in a folder, and record the commands that do."""
        for name, data in drawn_inputs().items():
            write_file(folder / name, data)
        (folder / "motions/a").mkdir()
        for case in PREPARATION:
            self._record(case, folder)
        for source, copy in FOLDER_PHOTOS.items():
            write_file(folder / copy, (folder / source).read_bytes())

    def record(self, case: Case, inputs: Path) -> None:
        """Run a case in a fresh folder."""
        folder = self._scratch / "work"
        shutil.copytree(inputs, folder)
        try:
            self._record(case, folder)
        finally:
            shutil.rmtree(folder)

    def _record(self, case: Case, folder: Path) -> None:
        before = digests(folder)
        started = time.monotonic()
        if case.emulator:
            with self._emulator(folder):
                outcome = self._run(case, folder)
        else:
            outcome = self._run(case, folder)
        self.seconds[case.name] = round(time.monotonic() - started, 1)
        self._store(case, folder, outcome, before)

    def _run(self, case: Case, folder: Path) -> Outcome:
        if case.first:
            self._start(shlex.split(moved(case.first, self._root)), folder).communicate(
                timeout=LIMIT_S
            )
        process = self._start(case.words(self._root), folder)
        try:
            stdout, stderr = process.communicate(timeout=LIMIT_S)
            status = str(process.returncode)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            stdout, stderr = process.communicate()
            status = f"ended after {LIMIT_S:g} s"
        places = self._places(folder)
        texts = (data.decode("utf-8", "backslashreplace") for data in (stdout, stderr))
        names = ("stdout", "stderr")
        normal_out, normal_err = (
            normalised(text, name, places) for text, name in zip(texts, names, strict=True)
        )
        return Outcome(normal_out, normal_err, status)

    def _start(self, words: Sequence[str], folder: Path) -> subprocess.Popen[bytes]:
        programs = self._root / ".venv" / "bin"
        return subprocess.Popen(
            [str(programs / words[0]), *words[1:]],
            cwd=folder,
            env=self._environment(),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,
        )

    @contextmanager
    def _emulator(self, folder: Path) -> Iterator[None]:
        """Run an emulated controller at the port ``uno`` of a folder."""
        process = self._start(["cep", "hw", "emulate", "uno", "--link", "uno"], folder)
        patience = time.monotonic() + 60.0
        while (
            not (folder / "uno").exists()
            and process.poll() is None
            and time.monotonic() < patience
        ):
            time.sleep(0.05)
        try:
            yield
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGINT)
            process.communicate(timeout=30)

    def _environment(self) -> dict[str, str]:
        return {
            "PATH": os.environ.get("PATH", os.defpath),
            "PYTHONPATH": str(self._root),
            "HOME": str(self._home),
            "XDG_CACHE_HOME": str(self._home / "cache"),
            "XDG_CONFIG_HOME": str(self._home / "config"),
            "TMPDIR": str(self._temporary),
            "COLUMNS": "100",
            "NO_COLOR": "1",
            "TERM": "dumb",
            "TZ": "UTC",
            "LC_ALL": "C.UTF-8",
            "PYTHONHASHSEED": "0",
            "OMP_NUM_THREADS": "1",
            "SOURCE_DATE_EPOCH": "0",
        }

    def _places(self, folder: Path) -> dict[str, str]:
        return {
            str(folder): "<work>",
            str(self._root): "<root>",
            str(self._scratch): "<temporary>",
        }

    def _store(
        self, case: Case, folder: Path, outcome: Outcome, before: Mapping[str, str]
    ) -> None:
        target = self._target / case.name
        target.mkdir()
        for name in ("stdout", "stderr"):
            (target / name).write_text(getattr(outcome, name), encoding="utf-8")
        (target / "exit").write_text(outcome.exit_status + "\n", encoding="utf-8")
        places = self._places(folder)
        written = {}
        after = digests(folder)
        for name in sorted(name for name in after if after[name] != before.get(name)):
            data = normalised_file(folder / name, name, places)
            written[name] = hashlib.sha256(data).hexdigest()
            if len(data) < COPIED_BYTES:
                write_file(target / "files" / name, data)
        written.update(dict.fromkeys(sorted(before.keys() - after.keys()), "removed"))
        (target / "files.json").write_text(json.dumps(written, indent=1) + "\n", encoding="utf-8")


def digests(folder: Path) -> dict[str, str]:
    """Return the SHA-256 of the files of a folder, but for byte code and finished cells."""
    return {
        path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
        and "__pycache__" not in path.parts
        and not PASSED_OVER.fullmatch(path.relative_to(folder).as_posix())
    }


def write_file(path: Path, data: bytes) -> None:
    """Write a file, and its folder where there is none."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(data)


def record(root: Path, target: Path, *, inputs: Path | None, only: str) -> None:
    """Record all cases of a checkout.

    Parameters
    ----------
    root : Path
        The checkout.
    target : Path
        Folder of the record; it must not exist.
    inputs : Path or None
        Inputs of an earlier record, to be used for the cases.
    only : str
        Pattern of the names of cases to run; all when empty.
    """
    target.mkdir(parents=True)
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="goldens-") as temporary:
        recorder = Recorder(root.resolve(), target, Path(temporary).resolve())
        if inputs is None or not only:
            prepared = Path(temporary).resolve() / "inputs"
            prepared.mkdir()
            recorder.prepare(prepared)
            inputs = prepared if inputs is None else inputs
        shutil.copytree(inputs, target / "inputs")
        for case in CASES:
            if re.search(only, case.name):
                recorder.record(case, target / "inputs")
                print(f"{recorder.seconds[case.name]:6.1f} s  {case.name}", flush=True)
    (target / "seconds.json").write_text(
        json.dumps(recorder.seconds, indent=1) + "\n", encoding="utf-8"
    )
    print(f"{len(recorder.seconds)} cases in {time.monotonic() - started:.0f} s: {target}")


# Comparison

NUMBER = re.compile(r"[-+]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][-+]?\d+)?")


def near_numbers(before: str, after: str) -> int | None:
    """Count the numbers that differ, where texts differ in nothing but nearly equal numbers.

    Returns
    -------
    int or None
        None where the texts differ in anything else.
    """
    if before == after:
        return 0
    if NUMBER.split(before) != NUMBER.split(after):
        return None
    pairs = list(zip(NUMBER.findall(before), NUMBER.findall(after), strict=True))
    differing = [(float(first), float(second)) for first, second in pairs if first != second]
    if all(math.isclose(first, second, rel_tol=RELATIVE) for first, second in differing):
        return len(differing)
    return None


class Comparison:
    """Differences of two records.

    Attributes
    ----------
    near : int
        Numbers that count as equal and are not the same.
    """

    def __init__(self, before: Path, after: Path) -> None:
        self._before = before
        self._after = after
        self.near = 0

    def case(self, name: str) -> list[str]:
        """Return the lines that say what differs in a case."""
        folders = (self._before / name, self._after / name)
        for folder, record_folder in zip(folders, (self._before, self._after), strict=True):
            if not folder.is_dir():
                return [f"is not in {record_folder}"]
        lines = []
        for stream in ("exit", "stdout", "stderr"):
            lines += self._text(
                stream, *((folder / stream).read_text(encoding="utf-8") for folder in folders)
            )
        written_before, written_after = (
            json.loads((folder / "files.json").read_text()) for folder in folders
        )
        for file in sorted(written_before.keys() | written_after.keys()):
            digest_before, digest_after = written_before.get(file), written_after.get(file)
            if digest_before is None or digest_after is None:
                lines.append(f"{file}: {'only after' if digest_before is None else 'only before'}")
            elif digest_before != digest_after:
                lines += self._file(file, *(folder / "files" / file for folder in folders))
        return lines

    def _file(self, name: str, before: Path, after: Path) -> list[str]:
        texts = [
            as_text(path.read_bytes()) if path.is_file() else None for path in (before, after)
        ]
        if texts[0] is None or texts[1] is None:
            sizes = [
                f"{path.stat().st_size} bytes" if path.is_file() else "large"
                for path in (before, after)
            ]
            return [f"{name}: differs ({sizes[0]}, {sizes[1]})"]
        return self._text(name, texts[0], texts[1])

    def _text(self, name: str, before: str, after: str) -> list[str]:
        count = near_numbers(before, after)
        if count is not None:
            self.near += count
            return []
        pieces = (before.splitlines(), after.splitlines())
        return list(
            difflib.unified_diff(*pieces, f"before/{name}", f"after/{name}", lineterm="", n=1)
        )


def compare(before: Path, after: Path, *, most_lines: int) -> bool:
    """Print what differs between two records, case by case.

    Parameters
    ----------
    before, after : Path
        Folders of records.
    most_lines : int
        Lines to print of a case.

    Returns
    -------
    bool
        Whether nothing differs.
    """
    comparison = Comparison(before, after)
    names = case_names((before, after))
    differing = 0
    for name in names:
        lines = comparison.case(name)
        if not lines:
            continue
        differing += 1
        print(f"== {name}")
        for line in lines[:most_lines]:
            print(f"   {line[:400]}")
        if len(lines) > most_lines:
            print(f"   ... {len(lines) - most_lines} lines more")
    print(
        f"{len(names)} cases, {differing} differ; "
        f"{comparison.near} numbers differ by less than {RELATIVE:g}, relatively"
    )
    return not differing


def case_names(records: Iterable[Path]) -> list[str]:
    """Return the names of all cases of records, in the order of the table."""
    present = {path.parent.name for folder in records for path in folder.glob("*/files.json")}
    order = {case.name: number for number, case in enumerate([*PREPARATION, *CASES])}
    return sorted(present, key=lambda name: (order.get(name, len(order)), name))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Returns
    -------
    int
        Exit code: 0 done and nothing differs, 1 something differs, 2 bad input.
    """
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    verbs = parser.add_subparsers(required=True, dest="verb")
    recording = verbs.add_parser("record", help="run all cases of a checkout")
    recording.add_argument("--root", type=Path, required=True, help="the checkout, with its .venv")
    recording.add_argument(
        "-o", "--out", type=Path, required=True, help="folder of the record, a new one"
    )
    recording.add_argument("--inputs", type=Path, help="inputs of an earlier record, DIR/inputs")
    recording.add_argument(
        "--only", default="", metavar="PATTERN", help="only cases whose name matches"
    )
    comparing = verbs.add_parser("compare", help="compare two records")
    comparing.add_argument("before", type=Path)
    comparing.add_argument("after", type=Path)
    comparing.add_argument("--lines", type=int, default=40, help="lines to print of a case")
    options = parser.parse_args(arguments)
    if options.verb == "record":
        if options.out.exists():
            parser.error(f"{options.out}: exists")
        record(options.root, options.out, inputs=options.inputs, only=options.only)
        return 0
    return 0 if compare(options.before, options.after, most_lines=options.lines) else 1


if __name__ == "__main__":
    sys.exit(main())
