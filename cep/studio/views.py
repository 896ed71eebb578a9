"""Content of the page as JSON: pictures of a code, verdicts, photos, documents to save."""

from __future__ import annotations

import base64
import threading
from collections import OrderedDict
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import cep
from cep.codes.published import names
from cep.files.code_files import StoredCode, code_document
from cep.files.formatting import duration
from cep.files.images import encode_image
from cep.optics.camera import camera_names
from cep.plots.advice import EXPOSURE_NAMES
from cep.report.scene import bundled_picture
from cep.shutter.cameras import CAMERAS
from cep.shutter.play import on_ticks
from cep.studio.fields import FieldError
from cep.studio.live import LiveBench, LiveScene, broken_limits
from cep.studio.motions import EXAMPLES, path_fields
from cep.studio.state import Setting, read_search, read_state
from hw.cameras import camera_class
from hw.device import load_profile, profile_names
from hw.export import EXPORTERS, export_program, find_exporter
from hw.program import Program
from motdiff.files.json_files import plain
from motdiff.types import FloatArray

STUDIO_SCHEMA = "cep.studio/1"
_BENCHES = 6  # motions, cameras and shutters kept; a few MB each
_SCENE_PX = 256  # side of the photos that are shown
_LEAST_PX = 64  # of the scene that a motion must leave of it: less shows nothing
_FLOOR_DB = 50.0  # of the map's 8 bits
_WORDS = {"open": "open shutter", **EXPOSURE_NAMES}


class Views:
    """Views of settings.

    What depends on motion, camera and shutter alone is kept from one code to the next: a code
    that is dragged must be followed within milliseconds.
    """

    def __init__(self) -> None:
        self._benches: OrderedDict[str, LiveBench] = OrderedDict()
        self._judge: LiveBench | None = None  # of the latest verdict
        # file, its time, and scene of the latest photo
        self._own: tuple[Path, int, LiveScene] | None = None
        self._keeping = threading.Lock()

    def picture(
        self, setting: Setting, *, steps: int | None = None, seed: int = 0
    ) -> dict[str, Any]:
        """Return all that follows a chip: figures, MTFs, limits that it breaks, commands.

        Parameters
        ----------
        steps, seed : int
            Of the search that found the code.
        """
        bench, problem_error = self._bench(setting)
        code = setting.code()
        figures = bench.figures(code)
        open_figures = bench.opened
        broken: tuple[str, ...] = ()
        if problem_error is None:
            broken = broken_limits(bench.problem, code, setting.profile)
        path = setting.trajectory
        return _plain(
            {
                "code": {
                    "bits": code.bits,
                    "chips": code.chips,
                    "open": code.open_chips,
                    "duty": code.duty,
                    "openings": code.pulses,
                    "chip_ns": code.chip_ns,
                    "chip": duration(code.chip_ns * 1e-9),
                    "exposure": duration(code.duration_ns * 1e-9),
                    "broken": broken,
                },
                "motion": {
                    "length_px": path.length_px,
                    "extent_px": path.extent_px,
                    "direction": path.direction,
                    "path": path_fields(path),
                    "both": bench.problem.both_directions(path),
                    "angle_deg": float(np.degrees(np.arctan2(bench.axis[1], bench.axis[0]))),
                },
                "figures": figures.metrics.to_dict() | {"psnr_db": figures.psnr_db},
                "open": open_figures.metrics.to_dict() | {"psnr_db": open_figures.psnr_db},
                "map": _map(figures.band),
                "open_map": _map(open_figures.band),
                "commands": setting.commands(steps=steps, seed=seed),
                "error": problem_error and problem_error.to_dict(),
            }
        ) | {
            "curve": np.round(figures.curve, 5).tolist(),  # finer than a screen shows
            "open_curve": np.round(open_figures.curve, 5).tolist(),
        }

    def photos(
        self, setting: Setting, scene: Path | None, codes: Mapping[str, str], *, restored: bool
    ) -> dict[str, Any]:
        """Return simulated or restored photos of a scene through codes, by the codes' names.

        The scene is a .npy file, or the bundled picture.
        """
        bench, _ = self._bench(setting)
        live_scene = self._scene(scene)
        frame = len(bench.psf(cep.ShutterCode("1")))
        side = min(live_scene.shape)
        if side < frame + _LEAST_PX:
            raise FieldError(
                "scene", f"the motion spans {frame} px, too far for this scene of {side} px"
            )
        images = {}
        for name, bits in codes.items():
            code = setting.code(bits)
            photo = bench.photo(code, live_scene, side_px=_SCENE_PX)
            if restored:
                image = bench.restored(code, photo)
            else:
                image = photo / max(code.duty, 1e-6)  # a coded photo is darker: as bright as open
            images[name] = _jpeg(image)
        return images

    def verdict(self, setting: Setting) -> dict[str, Any]:
        """Return what to do with this code at this light, and what it is compared with."""
        bench, error = self._bench(setting)
        if error is not None:
            raise error
        try:
            verdict = self._judging(bench).verdict(
                setting.code(), path_error_px=setting.path_error_px
            )
        except ValueError as wrong:
            raise FieldError.of(wrong, fallback="photons") from None
        best = {kind: verdict.best(kind) for kind in ("open", "snapshot", "strobe")}
        psnrs = {exposure.code.bits: exposure.psnr_db for exposure in verdict.exposures}
        return _plain(
            {
                "sentence": verdict.sentence,
                "choice": verdict.choice,
                "gains_db": verdict.gains_db,
                "psnr_db": psnrs[setting.bits],
                "open_psnr_db": verdict.open_shutter.psnr_db,
                "ways": [
                    {"name": _WORDS[kind], **exposure.to_dict()}
                    for kind, exposure in best.items()
                    if exposure is not None
                ],
            }
        )

    def compared(self, setting: Setting, pins: Mapping[str, str]) -> dict[str, Any]:
        """Return the figures and curves of codes pinned beside the page's, by their names."""
        bench, _ = self._bench(setting)
        # those of another number of chips are shown without figures
        codes = {
            name: setting.code(bits) for name, bits in pins.items() if len(bits) == setting.chips
        }
        expected = self._judging(bench).psnr_db(
            list(codes.values()), path_error_px=setting.path_error_px
        )
        rows = {}
        for (name, code), psnr_db in zip(codes.items(), expected, strict=True):
            figures = bench.figures(code)
            rows[name] = {
                "bits": code.bits,
                "open": code.open_chips,
                "curve": np.round(figures.curve, 5),
                **figures.metrics.to_dict(),
                "psnr_db": psnr_db,
            }
        return _plain({"pins": rows})

    def exported(self, setting: Setting, file_format: object) -> dict[str, Any]:
        """Return the code as a timed program: name and text of the file, and its warnings."""
        if file_format not in [*EXPORTERS]:  # it may be no text
            raise FieldError("format", f"must be one of {', '.join(EXPORTERS)}")
        code, profile = setting.code(), setting.profile
        exporter = find_exporter(str(file_format))
        try:
            program, warnings = on_ticks(Program(code.bits, code.chip_ns), exporter.tick_ns)
            if profile is not None and (problems := profile.check(program)):
                raise ValueError("device: the code cannot be played: " + "; ".join(problems))
            text = export_program(program, exporter.name, device=profile)
        except ValueError as error:
            raise FieldError("format", str(error)) from None
        return {"name": exporter.file_name("code"), "text": text, "warnings": warnings}

    def saved(self, setting: Setting, state: Mapping[str, Any]) -> dict[str, Any]:
        """Return one document: the page's state, motion, code with its certificate, commands."""
        state = read_state(state)
        bench, _ = self._bench(setting)
        code = setting.code()
        path = setting.trajectory
        proven = cep.certify(code, bench.along)
        metrics = bench.figures(code).metrics
        about = {}
        if setting.profile is not None:
            about = {"device": setting.profile.to_dict()}
        steps, seed = read_search(state.get("search") or {})
        samples = {name: getattr(path, name) for name in "txy"}
        source = {"method": setting.motion["kind"]}
        if setting.path_error_px:
            source["path_uncertainty_px"] = setting.path_error_px
        return _plain(
            {
                "schema": STUDIO_SCHEMA,
                "state": state,
                "trajectory": {
                    "schema": "cep.trajectory/1",
                    "units": "px",
                    "direction": path.direction,
                    **samples,
                    "weight": 1.0,
                    "alternatives": [],
                    "source": source,
                },
                "code": code_document(
                    StoredCode(code, metrics.to_dict(), about, proven.to_dict())
                ),
                "commands": setting.commands(steps=steps, seed=seed),
            }
        )

    def _judging(self, bench: LiveBench) -> LiveBench:
        """Return the bench; the one that judged before frees its memory."""
        with self._keeping:
            before = self._judge
            self._judge = bench
        if before is not None and before is not bench:
            before.forget_otfs()
        return bench

    def _scene(self, file: Path | None) -> LiveScene:
        if file is None:
            return _bundled_scene()
        with self._keeping:
            # another search of the same photo writes it again
            written_ns = file.stat().st_mtime_ns
            if self._own is None or self._own[:2] != (file, written_ns):
                self._own = file, written_ns, LiveScene(np.load(file, allow_pickle=False))
            return self._own[2]

    def _bench(self, setting: Setting) -> tuple[LiveBench, FieldError | None]:
        """Return the bench of a setting, and what is wrong with its limits: it measures anyway."""
        error = None
        try:
            problem = setting.problem()
        except FieldError as wrong:
            error = wrong
            problem = setting.problem(limited=False)
        with self._keeping:
            if (bench := self._benches.get(setting.key)) is not None:
                self._benches.move_to_end(setting.key)
                return bench, error
        try:
            bench = LiveBench(problem)
        except ValueError as wrong:
            raise FieldError.of(wrong, fallback="motion") from None
        with self._keeping:
            # another request may have made it meanwhile
            bench = self._benches.setdefault(setting.key, bench)
            while len(self._benches) > _BENCHES:
                self._benches.popitem(last=False)
        return bench, error


def start_view() -> dict[str, Any]:
    """Return what can be chosen: cameras, shutters, published codes, example motions, formats."""
    cameras = {name: cep.Camera.load(name) for name in camera_names()}
    profiles = {name: load_profile(name) for name in profile_names()}
    return _plain(
        {
            "version": cep.__version__,
            "cameras": [
                {
                    "name": name,
                    "about": camera.kind,
                    "photons": camera.photons_full_scale,
                    "read_noise": camera.read_noise_e,
                    "bits": camera.bits,
                }
                for name, camera in cameras.items()
            ],
            "devices": _choices({name: profile.description for name, profile in profiles.items()}),
            "formats": _choices({name: exporter.summary for name, exporter in EXPORTERS.items()}),
            "kinds": _choices({kind: camera_class(kind, CAMERAS).summary for kind in CAMERAS}),
            "examples": _choices(EXAMPLES),
            "published": [{"name": name, "bits": cep.load_code(name).bits} for name in names()],
        }
    )


def _choices(lines: Mapping[str, str]) -> list[dict[str, str]]:
    """List choices by their names, as options take them, each with a line about it."""
    return [{"name": name, "about": about} for name, about in lines.items()]


@cache
def _bundled_scene() -> LiveScene:
    """Part of the bundled picture with the face in its middle, in colour."""
    return LiveScene(bundled_picture()[:384, 40:424])


def _map(band: FloatArray) -> dict[str, Any]:
    return {"rows": band.shape[0], "columns": band.shape[1], "db": _decibels(band)}


def _decibels(band: FloatArray) -> str:
    """MTF as text: one byte each, 255 for 1 and 0 for the floor, in decibels."""
    levels = 1 + 20 * np.log10(np.maximum(band, 1e-9)) / _FLOOR_DB
    return base64.b64encode(
        np.rint(255 * np.clip(levels, 0, 1)).astype(np.uint8).tobytes()
    ).decode()


def _plain(fields: Mapping[str, Any]) -> dict[str, Any]:
    view: dict[str, Any] = plain(fields)
    return view


def _jpeg(image: FloatArray) -> str:
    return "data:image/jpeg;base64," + base64.b64encode(encode_image(image, ".jpg")).decode()
