"""Work of the jobs, each in its own process: calibration, search, advice, play, a photo."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from cep.studio.fields import FieldError, nameless, writing
from cep.studio.motions import described_paths
from cep.studio.photo_files import PREVIEW_PX, beside, read_motion, write_motion, write_preview
from cep.studio.shots import shoot
from cep.studio.state import read_search, read_setting
from motdiff.files.json_files import plain

Order = Mapping[str, Any]
Tell = Callable[..., None]
_EVERY_S = 0.1  # between two messages of progress
_SCENE_PX = 420  # side of the part that is restored, and then photographed through codes
_SEARCHED_PX = 576  # side of the part of a photo; crops of a few hundred px are searched anyway
_UNO = "cxp-avr"  # profile of the emulated controller
_CALM = 5  # niceness: the page goes first


@dataclass(frozen=True)
class Kind:
    """A kind of job.

    Attributes
    ----------
    do : callable
        Takes the order and a function that tells the page of its progress; returns the result.
    name : str
        What the page calls it.
    keeps_best : bool
        Whether a stop is a result: the best so far.
    gives_way : bool
        Whether it was started by the page itself, and ends when another job is asked for.
    needs_rest : bool
        Whether it must not be ended without closing a shutter.
    """

    do: Callable[[Order, Tell], Mapping[str, Any]]
    name: str
    keeps_best: bool = False
    gives_way: bool = False
    needs_rest: bool = False


def run(kind: str, order: Order, pipe: Connection) -> None:
    """Do one job and tell the page of it through the pipe; the entry of the job's process."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    stop_if_asked = lost_interrupts()
    with suppress(OSError, AttributeError):
        os.nice(_CALM)
    last = 0.0

    def tell(share: float | None = None, note: str | None = None, **more: Any) -> None:
        nonlocal last
        stop_if_asked()
        time_s = time.monotonic()
        # a call that only looks for a stop must not take the place of the next share
        if more or (share is not None and time_s - last > _EVERY_S):
            last = time_s
            message = {"share": share, "note": note, **more}
            pipe.send({name: plain(value) for name, value in message.items() if value is not None})

    try:
        result = KINDS[kind].do(order, tell)
        pipe.send({"state": "done", "share": 1.0, "note": "", "result": plain(result)})
    except KeyboardInterrupt:
        pipe.send({"state": "stopped"})
    except ValueError as error:
        wrong = FieldError.of(error, fallback="job")
        pipe.send({"state": "failed", "error": wrong.to_dict()})
    except BrokenPipeError:  # the server is gone
        pass
    except Exception as error:  # whatever it is, the page says so, and the server goes on
        message = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
        with suppress(OSError):
            pipe.send({"state": "failed", "error": {"field": "job", "message": message}})
    finally:
        pipe.close()


def lost_interrupts() -> Callable[[], None]:
    """Keep interrupts that Python drops, and return a function that raises a kept one.

    Python prints and forgets a KeyboardInterrupt that comes in a finalizer or in the callback of a
    weak reference. A search that was stopped at such a moment went on.
    """
    lost: list[bool] = []
    earlier_hook = sys.unraisablehook

    def keep(dropped: Any) -> None:
        if issubclass(dropped.exc_type, KeyboardInterrupt):
            lost.append(True)
        else:
            earlier_hook(dropped)

    def stop_if_asked() -> None:
        if lost:
            lost.clear()
            raise KeyboardInterrupt

    sys.unraisablehook = keep
    return stop_if_asked


def _calibrate(order: Order, tell: Tell) -> Mapping[str, Any]:
    import cep
    from cep.files.images import read_detail
    from cep.restoration.sharpen import sharpen
    from motdiff.crops import centre_crop
    from motdiff.files.outputs import new_file

    file = Path(order["path"])
    tell(0.0, "reading the photo")
    try:
        photo, small, (height, width) = read_detail(
            file, side_px=_SEARCHED_PX, preview_px=PREVIEW_PX
        )
    except ValueError as error:
        raise FieldError("photo", nameless(error, file, "the photo")) from None
    with writing("photo"):
        write_preview(file, "preview", small)
    pixels = photo.pixels
    notes = list(photo.warnings)
    if pixels.shape[:2] != (height, width):
        notes.append(
            f"The motion was searched in the {pixels.shape[1]} x {pixels.shape[0]} px of the photo"
            " with most detail."
        )
    tell(0.02, "searching the motion", best={"preview": True, "width": width, "height": height})
    try:
        motion = cep.estimate_motion(
            pixels,
            method=order.get("method", "motdiff"),
            progress=lambda share, what: tell(0.02 + 0.8 * share, what),
        )
    except ValueError as error:
        raise FieldError("photo", str(error).removeprefix("photo: ")) from None
    with writing("photo"):
        write_motion(file, motion)
    tell(0.85, "restoring a part of the photo")
    scene = sharpen(centre_crop(pixels, _SCENE_PX, _SCENE_PX).astype(np.float64), motion)
    # under another name first: a page may read the one before
    with writing("photo"), new_file(beside(file, "scene.npy")) as temporary:
        np.save(temporary, np.clip(scene.image, 0, 1).astype(np.float32))
    return {
        "method": motion.method,
        "confidence": motion.confidence,
        "paths": described_paths(motion.weights, motion.trajectories),
        "width": width,
        "height": height,
        "warnings": [*notes, *motion.warnings],
        "doubts": [doubt for doubt in motion.warnings if doubt not in motion.psf_warnings],
        "summary": scene.summary,
        "kept": scene.kept,
        "path_error": motion.path_error_px,
    }


def _sharpen(order: Order, tell: Tell) -> Mapping[str, Any]:
    from cep.files.images import read_photo
    from cep.restoration.sharpen import sharpen

    file = Path(order["path"])
    motion = read_motion(file)
    tell(0.0, "reading the photo")
    try:
        photo = read_photo(file)
    except ValueError as error:
        raise FieldError("photo", nameless(error, file, "the photo")) from None
    tell(0.2, "restoring the whole photo")
    restored = sharpen(photo.pixels, motion, anyway=order.get("anyway") is True)
    tell(0.9, "writing it")
    with writing("photo"):
        restored.save(beside(file, "sharp.png"), bits=photo.bits)
        write_preview(file, "sharp_preview", restored.image)
    return {"summary": restored.summary, "kept": restored.kept, "warnings": restored.warnings}


def _search(order: Order, tell: Tell) -> Mapping[str, Any]:
    import cep

    setting = read_setting(order["setting"])
    problem = setting.problem()
    steps, seed = read_search(order)
    last_bits = ""

    def best(code: cep.ShutterCode) -> None:
        nonlocal last_bits
        if code.bits == last_bits:
            tell()  # a stop is noticed here too
        else:
            tell(best={"bits": code.bits})
        last_bits = code.bits

    tell(0.0, "measuring what is used instead")
    result = cep.optimize(
        problem,
        steps=steps,
        seed=seed,
        threads=1,
        progress=lambda share, note: tell(share, note),
        on_best=best,  # the page draws each better code
        path_error_px=setting.path_error_px,
        photographs=(),  # beside the live figures, which are the model's
    )
    return {
        "bits": result.code.bits,
        "sentence": result.verdict.sentence,
        "steps": result.search.steps,
        "seed": seed,
        "stopped": result.search.stopped,
        "seconds": result.search.seconds,
        "warnings": result.warnings,
    }


def _advise(order: Order, tell: Tell) -> Mapping[str, Any]:
    import cep
    from cep.search.advise import shifted
    from cep.search.verdict_text import conditions, recommendation

    setting = read_setting(order["setting"])
    advice = cep.advise(
        setting.problem(),
        setting.code(),
        path_error_px=setting.path_error_px,
        photographs=(),  # the model's, shifted as the live figures are
        threads=1,
        progress=lambda share, note: tell(share, note),
    )
    advice = shifted(advice)
    return advice.to_dict() | {
        "recommendation": recommendation(advice.here),
        "conditions": conditions(advice.here),
        "where": advice.where,
    }


def _play(order: Order, tell: Tell) -> Mapping[str, Any]:
    import cep
    from cep.shutter.play import on_ticks, play_emulated
    from hw.device import load_profile

    setting = read_setting(order["setting"])
    port = order["port"]
    code, notes = on_ticks(setting.code(), load_profile(_UNO).tick_ns if port == "emulated" else 1)
    try:
        if port == "emulated":
            tell(0.1, "starting the emulated controller")
            report, edges = play_emulated(code, profile=setting.profile)
        else:
            tell(0.1, "opening the controller")
            with cep.open_shutter(port) as shutter:
                tell(0.4, "loading and reading back")
                report = shutter.upload(code, profile=setting.profile, arm=bool(order.get("arm")))
                edges = ()
    except ValueError as error:
        raise FieldError("port", str(error)) from None
    return {
        "firmware": report.firmware,
        "trust": report.trust.value,
        "meaning": report.trust.meaning,
        "read_back": report.read_back,
        "armed": report.armed,
        "lease_ms": report.lease_ms,
        "edges_ns": edges,
        "duration_ns": code.duration_ns,
        "warnings": [*notes, *report.warnings],
        "seconds": report.seconds,
        "port": "the emulated Uno" if port == "emulated" else report.port,
    }


KINDS: Mapping[str, Kind] = {
    "calibrate": Kind(_calibrate, "The search of a motion"),
    "sharpen": Kind(_sharpen, "The restoration of a photo"),
    "search": Kind(_search, "A search", keeps_best=True),
    "advise": Kind(_advise, "The verdict over the light", gives_way=True),
    "play": Kind(_play, "An upload", needs_rest=True),
    "shoot": Kind(shoot, "A photo", needs_rest=True),
}
"""Kinds of jobs by their names."""
