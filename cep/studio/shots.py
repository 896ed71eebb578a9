"""Photos by a camera through the page's code: taken, restored, and packed to be saved."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.studio.fields import FieldError, writing
from cep.studio.photo_files import beside, write_preview
from cep.studio.state import read_setting

if TYPE_CHECKING:
    from cep.shutter.rig import Shot

_VIRTUAL = ("twin", "burst")  # cameras that bring their own shutter
# fields of the page that set what an error of the camera or the controller begins with
_FIELD_OF = {
    "camera": "shot_camera",
    "port": "shot_port",
    "release": "shot_release",
    "trajectory": "motion",
}


def shoot(order: Mapping[str, Any], tell: Callable[..., None]) -> Mapping[str, Any]:
    """Take a photo through the page's code, and restore it along the page's motion.

    Parameters
    ----------
    order : mapping
        ``setting`` of the page; ``camera`` and ``port`` as of ``cep shoot``, the latter
        ``emulated`` for an emulated board; ``release``, who begins; ``photo``, its key, and
        ``path``, its file.
    tell : callable
        Tells the page of the progress; of the photo, as ``best``, before it is restored.
    """
    from cep.files.shot_files import write_shot
    from cep.optics.path_limits import check_resolved
    from cep.shutter.frame_light import FrameLight
    from cep.shutter.shot_folder import restored_shot

    setting = read_setting(order["setting"])
    file = Path(order["path"])
    try:
        check_resolved(setting.trajectory, setting.chips)
        shot, notes = _taken(order, tell)
    except ValueError as error:
        raise _refusal(error, order) from None
    except OSError as error:
        raise FieldError("shot_camera", _line(error)) from None
    except RuntimeError as error:  # of the camera, the controller or the line between
        raise FieldError("shot_camera", f"nothing was taken: {_line(error)}") from None
    light = FrameLight.of(shot.frame)
    linear = shot.light
    rows, columns = linear.shape[:2]
    about = {
        "photo": order["photo"],
        "counts": shot.counts,
        "verdict": shot.verdict,
        "advice": light.advice,
        "is_clipped": light.is_clipped,
        "clipped": light.clipped,
        "histogram": light.counts,
        "width": columns,
        "height": rows,
        "warnings": [*notes, *(text for text in shot.warnings if text != light.advice)],
    }
    with writing("shot_camera"):
        write_shot(file.parent, file.stem, shot.frame, shot.record, force=True)
        write_preview(file, "preview", linear)
        if not shot.counts:
            return about
        tell(0.5, "restoring it", best=about)
        try:
            sharp = restored_shot(shot, lambda share, note: tell(0.5 + 0.45 * share, note))
        except ValueError as error:
            raise _refusal(error, order) from None
        sharp.save(beside(file, "sharp.png"), bits=8 if shot.record.bits <= 8 else 16)
        write_preview(file, "sharp_preview", sharp.image)
    return {**about, "restored": True, "warnings": [*about["warnings"], *sharp.warnings]}


def shot_archive(file: Path) -> bytes:
    """Pack a photo, its record and, where there is one, the restored photo, as a ZIP file."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, source in (
            ("photo.tif", file),
            ("photo.json", file.with_suffix(".json")),
            ("restored.png", beside(file, "sharp.png")),
        ):
            if source.is_file():
                archive.write(source, name)
    return content.getvalue()


def _taken(order: Mapping[str, Any], tell: Callable[..., None]) -> tuple[Shot, tuple[str, ...]]:
    """Take the photo; with it comes a note where the chips were rounded to the board's ticks."""
    from cep.shutter.exposure_plan import Release, ShotSettings
    from cep.shutter.play import on_ticks
    from cep.shutter.shoot import open_rig
    from hw.emulation.uno import EmulatedUno, EmulationError

    setting = read_setting(order["setting"])
    camera = order["camera"]
    release = order["release"]
    notes: tuple[str, ...] = ()
    with ExitStack() as stack:
        port = order["port"]
        if camera.partition(":")[0] in _VIRTUAL:
            port = None
        elif port == "emulated":
            try:
                port = stack.enter_context(EmulatedUno()).port
            except EmulationError as error:
                raise ValueError(f"port: {error}") from None
        tell(0.05, "opening the camera")
        rig = stack.enter_context(open_rig(camera, port))
        code = setting.code()
        if rig.controller is not None:
            code, notes = on_ticks(code, rig.controller.announced.tick_ns)
        tell(0.2, "loading the code and reading it back")
        settings = ShotSettings(
            release=Release(release) if release else None, motion=setting.trajectory
        )
        rig.prepare(code, settings)
        # it may last: the best, none yet, sends it however soon after the note before
        tell(0.3, "waiting for the photo", best={})
        (shot,) = rig.series(1, keep=lambda _shot: None)
    return shot, notes


def _refusal(error: ValueError, order: Mapping[str, Any]) -> FieldError:
    """Return the error of a field: what the page calls camera is its noise model."""
    if isinstance(error, FieldError):
        return error
    head, _, fault = str(error).partition(": ")
    if head in _FIELD_OF:
        return FieldError(_FIELD_OF[head], fault)
    is_port = str(error).startswith(order["port"])
    return FieldError("shot_port" if is_port else "shot_camera", str(error))


def _line(error: Exception) -> str:
    """Return an error and its notes in a line."""
    return "; ".join([str(error), *getattr(error, "__notes__", ())])
