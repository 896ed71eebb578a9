"""``cep calibration-set``: codes for photos of one motion that show its order in time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.code_options import CODE, Device, chips_option, in_bits
from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import (
    CommonOptions,
    TableFile,
    command,
    option,
    output_option,
    table_files,
)
from cep.search.chip_count import STANDARD_CHIPS

if TYPE_CHECKING:
    from cep.calibration.calibration_set import CalibrationSet


@dataclass(frozen=True, kw_only=True)
class CalibrationSetOptions(CommonOptions):
    """Options of ``cep calibration-set``."""

    photos: int = option("--photos", "N", "Photos to be taken of the motion.", 4, min=2, max=8)
    chips: int = chips_option("Number of chips.", STANDARD_CHIPS, fewest=4)
    chip_ns: int = option("--chip-ns", "NS", "Chip time, ns.", 1_000_000, panel=CODE, min=1)
    device: Device = None
    file_format: str = option(
        "--format", "NAME", "Of the timed programs, as of cep export.", "csv", short="-f"
    )
    output: Path = output_option(
        "Folder to write into.", Path("calibration_set"), metavar="FOLDER"
    )
    tables: TableFile = None


@command(CalibrationSetOptions)
def calibration_set(options: CalibrationSetOptions) -> None:
    """Design codes for photos of one motion that show its order in time.

    One photo with an open shutter cannot show it. Writes set.json, which says in which order to
    take the photos and how to find the motion from them, and for each photo code_N.json and its
    timed program. The first photo has the shutter open, as far as the device allows it.

    Each code tells apart best, after those before it, the orders of simulated walks that an open
    shutter cannot tell. cep calibrate --next chooses the codes for one motion instead.

    Fields of --json that need a word, all of simulated walks other than those of the design:

    - contrast.walks_told: walks of which the photos rule out each other order, six at most.
    - contrast.median, contrast.worst_tenth: chi-square between a walk's photos and those of its
      other orders, over all of these.

    Example: cep calibration-set --photos 4 --chips 52 --device flc -o set
    """
    import numpy as np

    from cep.calibration.calibration_set import calibration_set as design
    from cep.calibration.calibration_set import set_files
    from motdiff.files.outputs import claim, claim_folder

    output = options.output
    names = set_files(options.photos, options.file_format)
    claim_folder(output, names, force=options.force)
    outputs = claim(table_files(options.tables), force=options.force)
    with progress("designing codes") as tick:
        calibration = design(
            options.photos,
            chips=options.chips,
            chip_ns=options.chip_ns,
            device=options.device,
            rng=np.random.default_rng(options.seed),
            progress=tick,
        )
    result = {
        "folder": output,
        "files": [output / name for name in names],
        **calibration.to_dict(output),
        "seed": options.seed,
    }
    finish(
        result,
        _page(calibration, output),
        as_json=options.as_json,
        outputs=outputs,
        save=lambda _staged: calibration.save(
            output, file_format=options.file_format, force=options.force
        ),
        tables=options.tables,
        summary=in_bits(calibration.codes),
    )


def _page(calibration: CalibrationSet, folder: Path) -> Page:
    yield calibration.summary
    rows = [
        (f"P{i}", name, code.open_chips, code.pulses, code.bits)
        for i, (name, code) in enumerate(
            zip(calibration.sources, calibration.codes, strict=True), 1
        )
    ]
    yield Table(str(folder), ("photo", "code", "open", "openings", "bits"), rows)
    yield f"then: {calibration.command(folder)}"
