"""The demo's HTML page: one self-contained file, pictures embedded, no network requests.

All prose is in ``templates/demo.html.j2``. The one script, whose hash the page's security policy
names, lays two photos over each other with a movable boundary; without it both still show.
"""

from __future__ import annotations

import base64
import hashlib
import platform
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

import cep
from cep.calibration.calibrate import CALIBRATION_FILES, Calibration
from cep.files.code_files import StoredCode, write_code
from cep.files.formatting import duration, number
from cep.files.images import encode_image, write_image
from cep.plots.advice import advice_figure
from cep.plots.canvas import png_bytes, thumbnail
from cep.plots.codes import code_strips, mtf_figure
from cep.plots.photos import before_after, psf_figure, trajectory_figure
from hw.device import load_profile, profile_names
from hw.export import EXPORTERS, export_program
from hw.program import Program
from motdiff.files.inputs import printable
from motdiff.files.json_files import json_text
from motdiff.files.outputs import new_folder, write_text
from motdiff.metrics import mnc_subpixel, path_distance_px, timed_distance_px
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from cep.report.chain import Chain, Shot
    from cep.search.advise import Advice

# pictures of the page that are files as well; the code strip where a code is advised
PICTURE_FILES = ("advice", "code_strip", "mtf", "photos", "scene_at_rest")
DEMO_SCHEMA = "cep.demo/1"
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
    "blurred.png",
    "coded.png",
    *_SET,
    *_RESTORED,
    *_PROGRAMS,
    *CALIBRATION_FILES,
)
_OWN_PX = 1600  # longest side of a user's photo on the page
_NAMES = {"open": "open shutter", "snapshot": "best single exposure", "coded": "best code"}


@dataclass(frozen=True)
class Table:
    """A table of the page.

    Attributes
    ----------
    columns : tuple of str
        Headings with units; the first column names the row, the others hold numbers or texts.
    highlight : int, optional
        Index of the row that is advised.
    """

    columns: tuple[str, ...]
    rows: tuple[tuple[object, ...], ...]
    highlight: int | None = None


def write_demo(
    folder: Path | str, chain: Chain, *, options: str = "", force: bool = False
) -> Mapping[str, object]:
    """Write the page and the files that it names.

    ``options`` name camera and device on a command line, for the commands in the report. Returned
    are the figures, as in ``demo.json``. ValueError if a file exists and ``force`` is not given,
    or the folder cannot be written to.
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
            described = {
                "objective": "mse",
                "chips": chain.code.chips,
                "device": chain.device and chain.device.to_dict(),
            }
            metrics = chain.problem.measure(chain.code).to_dict()
            stored = StoredCode(chain.code, metrics, described, chain.certificate.to_dict())
            write_code(temporary / "code.json", stored)
            program = Program(chain.code.bits, chip_ns=chain.code.chip_ns)
            for name, file_format in _PROGRAMS.items():
                with suppress(ValueError):  # the sketch plays chips of 50 us to 32 ms only
                    text = export_program(program, file_format, device=chain.device)
                    write_text(temporary / name, text)
            write_image(temporary / "coded.png", chain.advised_shot.photo, bits=16)
        png = pictures(chain)
        for name in PICTURE_FILES:
            if name in png:
                (temporary / f"{name}.png").write_bytes(png[name])
        write_text(temporary / "report.html", html(chain, png, options=options))
        write_text(temporary / "demo.json", json_text(figures))
    return figures


def _figures(chain: Chain) -> dict[str, object]:
    verdict = chain.advice.here
    psnr_db = {shot.kind: shot.psnr_db for shot in chain.shots}
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
        "bits": chain.code and chain.code.bits,
        "chips": chain.problem.chips,
        "chip_ns": chain.problem.chip_ns,
        "camera": chain.problem.camera.to_dict(),
        "device": chain.device and chain.device.name,
        "seed": chain.seed,
        "warnings": [*chain.scene.warnings, *chain.estimate.warnings],
    }


def pictures(chain: Chain) -> dict[str, bytes]:
    """Return the pictures of a chain's page as PNG files, by name."""
    path = chain.estimate.best
    shots = [shot for shot in chain.shots if shot.kind != "coded" or chain.coded]
    names = {**_NAMES, chain.advised_shot.kind: "as advised"}
    restored = {names[shot.kind]: shot.restored for shot in _shown(chain)}
    psfs = {
        "estimated": chain.estimate.psf,
        "estimated path": path.psf(path.frame_size(PSF_PX)),
    }
    if (truth := chain.scene.motion) is not None:
        psfs["true"] = truth.psf(truth.frame_size(PSF_PX))
    photos = {"blurred": chain.shots[0].photo, **restored, "at rest": chain.reference}
    figures = {
        "advice": advice_figure(chain.advice),
        "mtf": mtf_figure(path, {_NAMES[shot.kind]: shot.exposure.code for shot in shots}),
        # of the photo taken: in a restored one noise may be the busiest
        "photos": before_after(photos, detail_of=chain.shots[0].photo),
        "path": trajectory_figure(chain.scene.photo, path),
        "psfs": psf_figure(psfs),
    }
    if chain.coded:
        figures["code_strip"] = code_strips(
            {_NAMES[shot.kind]: shot.exposure.code for shot in shots if shot.kind != "open"}
        )
    images: dict[str, FloatArray] = {}
    if chain.sharpened is not None:
        images["own_photo"] = thumbnail(chain.scene.photo, _OWN_PX)
        if not chain.sharpened.kept:
            images["own_sharpened"] = thumbnail(chain.sharpened.image, _OWN_PX)
            pair = {"your photo": chain.scene.photo, "sharpened": chain.sharpened.image}
            figures["own_detail"] = before_after(pair, detail_of=chain.scene.photo)
    images |= {
        "blurred": chain.shots[0].photo,
        "scene_at_rest": chain.reference,
        **{f"restored_{shot.kind}": shot.restored for shot in _shown(chain)},
    }
    return {name: png_bytes(figure) for name, figure in figures.items()} | {
        name: encode_image(image, ".png") for name, image in images.items()
    }


def html(chain: Chain, png: Mapping[str, bytes] | None = None, *, options: str = "") -> str:
    """Render the page of a chain, by default with its :func:`pictures`; every text is escaped.

    ``options`` name camera and device on a command line.
    """
    from jinja2 import Environment, StrictUndefined
    from markupsafe import Markup  # the script is the package's

    # autoescape on: names of files, cameras and devices come from others
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,  # a misspelt name must not pass as a gap in the page
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=lambda value: printable(value) if type(value) is str else value,
    )
    environment.filters["cell"] = _cell
    environment.filters["duration"] = duration
    source, script = (
        (resources.files("cep.report") / "templates" / name).read_text(encoding="utf-8")
        for name in ("demo.html.j2", "compare.js")
    )
    versions = [f"coded-exposure {cep.__version__}", f"numpy {np.__version__}"]
    uris = {
        name: "data:image/png;base64," + base64.b64encode(data).decode("ascii")
        for name, data in (png or pictures(chain)).items()
    }
    return environment.from_string(source).render(
        chain=chain,
        sharpened=chain.sharpened,
        here=chain.advice.here,
        estimate=chain.estimate,
        advised=chain.advised_shot,
        shown=_shown(chain),
        pictures=uris,
        gains=_gains(chain.advice),
        photos=_photos(chain),
        devices=_devices(chain),
        truth=_truth(chain),
        options=options,
        versions=", ".join([*versions, f"Python {platform.python_version()}"]),
        script=Markup(script),
        # by its hash, the page's Content-Security-Policy lets this script run and no other
        allowed=base64.b64encode(hashlib.sha256(script.encode()).digest()).decode(),
    )


def _shown(chain: Chain) -> list[Shot]:
    """Restored photos of the gallery: a code that is not advised is not shown."""
    return [shot for shot in chain.shots if shot.kind == "snapshot" or shot is chain.advised_shot]


def _gains(advice: Advice) -> Table:
    verdict = advice.here
    best = [(verdict.best(kind), gain_db) for kind, gain_db in verdict.gains_db.items()]
    # the best code may be the same even pulses as the best strobe
    rows = [
        (exposure, gain_db)
        for i, (exposure, gain_db) in enumerate(best)
        if exposure is not None and exposure not in [earlier for earlier, _ in best[:i]]
    ]
    return Table(
        ("best of each kind", "open for", "openings", "expected gain, dB"),
        tuple(
            (exposure.label, _open_time(exposure.code), exposure.code.pulses, f"{gain_db:+.2f}")
            for exposure, gain_db in rows
        ),
        next((i for i, (exposure, _) in enumerate(rows) if exposure is verdict.advised), None),
    )


def _photos(chain: Chain) -> Table:
    """Compare the restored photos: expected and simulated gains over the open shutter."""
    simulated = chain.gains_db()
    opened_db = chain.advice.here.open_shutter.psnr_db
    rows = []
    for shot in chain.shots:
        name = _NAMES[shot.kind]
        if shot.kind == "coded" and not chain.coded:
            name += " (not advised)"
        rows.append(
            (
                name,
                _open_time(shot.exposure.code),
                f"{shot.exposure.psnr_db - opened_db:+.2f}",
                f"{simulated[shot.kind]:+.2f}",
                f"{shot.psnr_db:.2f}",
            )
        )
    return Table(
        ("photo", "open for", "expected gain, dB", "simulated gain, dB", "PSNR restored, dB"),
        tuple(rows),
        chain.shots.index(chain.advised_shot),
    )


def _devices(chain: Chain) -> Table | None:
    """List the shutters that can play the code; None where no code is advised."""
    if chain.code is None:
        return None
    program = Program(chain.code.bits, chip_ns=chain.code.chip_ns)
    profiles = [load_profile(name) for name in profile_names()]
    if chain.device is not None and chain.device not in profiles:
        profiles.insert(0, chain.device)
    rows = []
    for profile in profiles:
        broken = profile.check(program)
        reason = (*broken, "can be played")[0].removeprefix(f"{profile.name}: ")
        rows.append((profile.name, reason))
    highlight = None
    if chain.device is not None:
        highlight = profiles.index(chain.device)
    return Table(("shutter or controller", "this code"), tuple(rows), highlight)


def _truth(chain: Chain) -> dict[str, float] | None:
    """Errors of the estimated motion; None where the true one is not known."""
    if (truth := chain.scene.motion) is None:
        return None
    path = chain.estimate.best
    distance = timed_distance_px if path.direction == "known" else path_distance_px
    psf = truth.psf(truth.frame_size(PSF_PX))
    return {"mnc": mnc_subpixel(chain.estimate.psf, psf), "distance_px": distance(path, truth)}


def _open_time(code: cep.ShutterCode) -> str:
    return duration(code.open_chips * code.chip_ns * 1e-9)


def _cell(value: object) -> str:
    text = number(value) if isinstance(value, float) else str(value)
    return text.replace("-", "−") if text[:1] in "+-" else text  # as wide as a plus
