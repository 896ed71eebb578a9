"""Files of the demo, all of them or none."""

from __future__ import annotations

import os
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from urllib.parse import quote

from cep.calibration.calibrate import CALIBRATION_FILES, Calibration
from cep.files.code_files import StoredCode, write_code
from cep.files.images import write_image
from cep.report.demo_chain import Chain
from cep.report.page import PICTURE_FILES, html, pictures
from hw.export import EXPORTERS, export_program
from hw.program import Program
from motdiff.files.json_files import json_text
from motdiff.files.outputs import new_folder, write_text

DEMO_SCHEMA = "cep.demo/1"
_PHOTOS = {"blurred.png": "open", "coded.png": "coded"}
_SET = ("calibration_2.png", "calibration_3.png", "calibration_4.png")
_RESTORED = {
    "restored_open.png": "open",
    "restored_snapshot.png": "snapshot",
    "restored_coded.png": "coded",
}
_PROGRAMS = {
    f"shutter_code{exporter.suffix}": file_format for file_format, exporter in EXPORTERS.items()
}
_OF_A_CODE = ("code.json", "coded.png", "restored_coded.png", "code_strip.png", *_PROGRAMS)
# the code, its programs and pictures are written only where a code is advised, the further photos
# of the calibration only where they were taken
DEMO_FILES = (
    "report.html",
    "demo.json",
    "code.json",
    *(f"{name}.png" for name in PICTURE_FILES),
    *_PHOTOS,
    *_SET,
    *_RESTORED,
    *_PROGRAMS,
    *CALIBRATION_FILES,
)


def write_demo(
    folder: Path | str, chain: Chain, *, options: str = "", force: bool = False
) -> Mapping[str, object]:
    """Write the page and the files that it names.

    Parameters
    ----------
    folder : path of a folder, made when missing
    chain : Chain
    options : str
        How camera and device are named on a command line, for the commands in the report.
    force : bool
        Whether existing files may be replaced.

    Returns
    -------
    mapping : the figures, as in ``demo.json``

    Raises
    ------
    ValueError
        If a file exists and ``force`` is not given, or the folder cannot be written to.
    """
    target = Path(folder)
    figures = {"schema": DEMO_SCHEMA, "report": str(target / "report.html"), **_figures(chain)}
    with new_folder(target, DEMO_FILES, force=force) as temporary:
        source = {"image": chain.scene.name, "seed": chain.seed}
        Calibration.of(chain.estimate, chain.scene.photo).save(temporary, source=source)
        # no rounding on top of the camera's
        write_image(temporary / "blurred.png", chain.scene.photo, bits=16)
        # the first photo is blurred.png; a user's own has no others
        for name, photo in zip(_SET, chain.motion.photos[1:], strict=False):
            write_image(temporary / name, photo, bits=16)
        # where no code is advised its files would show what is advised against
        restored = {shot.kind: shot.restored for shot in chain.shots}
        for name, kind in _RESTORED.items():
            if kind in restored and (chain.coded or name not in _OF_A_CODE):
                write_image(temporary / name, restored[kind])
        if chain.code is not None:
            metrics = chain.problem.measure(chain.code).to_dict()
            certificate = chain.certificate.to_dict()
            described = {
                "objective": "mse",
                "chips": chain.code.chips,
                "device": chain.device and chain.device.to_dict(),
            }
            write_code(
                temporary / "code.json", StoredCode(chain.code, metrics, described, certificate)
            )
            program = Program.from_bits(chain.code.bits, chip_ns=chain.code.chip_ns)
            for name, file_format in _PROGRAMS.items():
                with suppress(ValueError):  # the sketch plays chips of 50 us to 32 ms only
                    write_text(
                        temporary / name,
                        export_program(program, file_format, device=chain.device),
                    )
            write_image(temporary / "coded.png", chain.advised_shot.photo, bits=16)
        png = pictures(chain)
        for name in PICTURE_FILES:
            if name in png:
                (temporary / f"{name}.png").write_bytes(png[name])
        page = html(chain, png, options=options, guide=_guide(target))
        write_text(temporary / "report.html", page)
        write_text(temporary / "demo.json", json_text(figures))
    return figures


def _guide(folder: Path) -> str:
    """Address of docs/hardware.md from a folder; empty in a wheel, which has no documents."""
    guide = Path(__file__).resolve().parents[2] / "docs" / "hardware.md"
    try:
        address = Path(os.path.relpath(guide, folder.resolve())).as_posix()
    except ValueError:  # on another drive
        return ""
    return quote(address) if guide.is_file() else ""


def _figures(chain: Chain) -> dict[str, object]:
    verdict = chain.advice.here
    psnr_db = {shot.kind: shot.psnr_db for shot in chain.shots}
    camera = chain.problem.camera
    return {
        "sharpened": chain.sharpened and chain.sharpened.summary,
        "verdict": chain.verdict,
        "choice": chain.choice,
        "gains_db": verdict.gains_db,
        "psnr_db": {kind: psnr_db.get(kind) for kind in ("open", "snapshot", "coded")},
        "simulated_gains_db": chain.gains_db(),
        "crossover": chain.advice.crossover,
        "photo": chain.scene.name,
        "method": chain.estimate.method,
        "length_px": chain.estimate.best.length_px,
        "confidence": chain.estimate.confidence,
        "path_uncertainty_px": chain.estimate.path_error_px,
        "calibration_codes": [code.bits for code in chain.motion.codes],
        "open_photo_alone": _from_open_photo(chain),
        "bits": chain.code and chain.code.bits,
        "chips": chain.problem.chips,
        "chip_ns": chain.problem.chip_ns,
        "camera": camera.to_dict(),
        "device": chain.device and chain.device.name,
        "seed": chain.seed,
        "warnings": [*chain.scene.warnings, *chain.estimate.warnings],
    }


def _from_open_photo(chain: Chain) -> dict[str, object] | None:
    """Return the figures that the photo with an open shutter would have led to by itself."""
    if chain.shot_from_open is None or chain.motion.from_open is None:
        return None
    return {
        "length_px": chain.motion.from_open.best.length_px,
        "confidence": chain.motion.from_open.confidence,
        "bits": chain.shot_from_open.exposure.code.bits,
        "psnr_db": chain.shot_from_open.psnr_db,
    }
