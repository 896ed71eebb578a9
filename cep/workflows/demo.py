"""The files that the demo leaves, all of them or none."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from cep.io.files import StoredCode, json_text, write_code
from cep.io.images import write_image
from cep.io.outputs import new_folder, write_text
from cep.report.demo_page import DEMO_PICTURES, demo_report
from cep.report.result_page import write_report
from cep.workflows.calibrate import CALIBRATION_FILES, write_calibration
from cep.workflows.demo_chain import Chain
from hw.export import EXPORTERS, export_program
from hw.program import Program

__all__ = ["DEMO_FILES", "write_demo"]

_PHOTOS = {"blurred.png": "scene", "coded.png": "coded", "restored_open.png": "open", "restored_coded.png": "restored"}
_PROGRAMS = {f"shutter_code{exporter.suffix}": file_format for file_format, exporter in EXPORTERS.items()}
DEMO_FILES = (
    "report.html", "demo.json", "code.json", *(f"{name}.png" for name in DEMO_PICTURES), *_PHOTOS, *_PROGRAMS,
    *CALIBRATION_FILES,
)  # fmt: skip
"""What :func:`write_demo` writes."""


def write_demo(folder: Path | str, chain: Chain, *, force: bool = False) -> Mapping[str, object]:
    """Write the report and everything it speaks of.

    Parameters
    ----------
    folder : path of a folder, made when missing
    chain : Chain
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
    program = Program.from_bits(chain.code.bits, chip_ns=chain.code.chip_ns)
    open_shot, coded_shot = chain.shots[:2]
    figures = {
        "report": str(target / "report.html"),
        "photo": chain.scene.name,
        "method": chain.estimate.method,
        "length_px": chain.motion.length_px,
        "confidence": chain.estimate.confidence,
        "bits": chain.code.bits,
        "metrics": chain.metrics.to_dict(),
        "psnr_db": {shot.name: shot.psnr_db for shot in chain.shots},
        "gain_db": coded_shot.psnr_db - open_shot.psnr_db,
        "expected_psnr_db": dict(chain.expected_db),
        "direction": chain.direction.direction,
        "direction_confidence": chain.direction.confidence,
        "camera": chain.camera.to_dict(),
        "seed": chain.seed,
        "warnings": [*chain.scene.warnings, *chain.estimate.warnings],
    }
    with new_folder(target, DEMO_FILES, force=force) as made:
        source = {"image": chain.scene.name, "seed": chain.seed}
        write_calibration(made, chain.estimate, chain.scene.photo, source=source)
        stored = StoredCode(chain.code, chain.metrics.to_dict(), {"objective": "mse", "chips": chain.code.chips})
        write_code(made / "code.json", stored)
        for name, file_format in _PROGRAMS.items():
            write_text(made / name, export_program(program, file_format))
        write_image(made / "blurred.png", chain.scene.photo, bits=16)
        write_image(made / "coded.png", coded_shot.photo, bits=16)
        write_image(made / "restored_open.png", open_shot.restored)
        write_image(made / "restored_coded.png", coded_shot.restored)
        report = demo_report(chain)
        for shown in (shown for section in report.sections for shown in section.pictures if shown.name):
            (made / f"{shown.name}.png").write_bytes(shown.png)
        write_report(made / "report.html", report)
        write_text(made / "demo.json", json_text(figures))
    return figures
