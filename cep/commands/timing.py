"""``cep hw timing``: when a camera exposes, by flashes of the controller's light."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.code_options import exposure_seconds
from cep.commands.console import Page, Table, finish, progress
from cep.commands.options import CameraFileOptions, Force, Json, command, option

if TYPE_CHECKING:
    from cep.shutter.exposure_fit import Interval
    from cep.shutter.timing import TimedCamera


@dataclass(frozen=True, kw_only=True)
class TimingOptions(CameraFileOptions):
    """Options of ``cep hw timing``."""

    camera: str = option("--camera", "KIND:ADDRESS", "Camera, as in cep shoot.", default=MISSING)
    port: str | None = option(
        "--port", None, "Controller of the light, as in cep shoot.", short="-p"
    )
    exposure: str = option("--exposure", "TIME", "Exposure to set and to time.", "2ms")
    gain: float | None = option("--gain", "DB", "Of the camera.")
    trigger: str | None = option(
        "--trigger",
        "WHO",
        "shutter: the controller's output busy triggers the camera; camera: its output"
        " exposure active triggers the controller.",
    )
    profile: str | None = option(
        "--profile", "NAME|FILE", "Camera whose noise figures are written with the times."
    )
    force: Force = False
    as_json: Json = False


@command(TimingOptions)
def timing(options: TimingOptions) -> None:
    """Measure when a camera exposes: delay, true length, jitter and row time, with intervals.

    The controller flashes a light at swept delays after the camera's trigger, 40 frames in all.
    Connect an LED in place of the shutter, at the controller's output, and point it at the bare
    camera or at a white card; switch other light off. A liquid-crystal shutter adds its own delay.
    Writes a camera file with the times, whose lead-in cep shoot needs.

    Words: exposure start delay, trigger latency, rolling shutter, line time, strobe delay.

    Example: cep hw timing --camera pylon: --port /dev/ttyACM0 -o camera.toml

    Example: cep hw timing --camera twin:delay_us=300,row_us=15 --exposure 5ms
    """
    from cep.optics.camera import Camera
    from cep.shutter.exposure_plan import Release
    from cep.shutter.timing import time_camera
    from motdiff.files.outputs import claim

    options.check_names()
    if options.trigger not in (None, "shutter", "camera"):
        raise ValueError(f"--trigger: must be shutter or camera, got {options.trigger[:40]!r}")
    noise = None if options.profile is None else Camera.load(options.profile)
    exposure_s = exposure_seconds(options.exposure)
    assert exposure_s is not None
    outputs = claim([options.output, options.figure], force=options.force)
    with progress("timing the exposure") as tick:
        timed = time_camera(
            options.camera,
            port=options.port,
            exposure_s=exposure_s,
            gain_db=options.gain,
            release=None if options.trigger is None else Release(options.trigger),
            progress=tick,
        )
    profile = timed.profile(noise)

    def save(staged: Mapping[Path, Path]) -> None:
        profile.to_file(staged[options.output])
        timed.save_figure(staged[options.figure])

    finish(
        {
            "file": options.output,
            "image": options.figure,
            **timed.to_dict(),
            "lead_in_ns": profile.lead_in_s * 1e9,
        },
        _page(timed, options, lead_in_s=profile.lead_in_s),
        as_json=options.as_json,
        outputs=outputs,
        save=save,
    )


def _page(timed: TimedCamera, options: TimingOptions, *, lead_in_s: float) -> Page:
    figures = timed.timing
    rows = [
        ("delay", *_microseconds(figures.start)),
        ("length", *_microseconds(figures.length)),
        ("jitter", *_microseconds(figures.jitter)),
        ("row time", *_microseconds(figures.row)),
    ]
    if timed.dead_s is not None:
        rows.append(("dead time", "", "0", f"{1e6 * timed.dead_s:.0f}"))
    start, length = (
        f"{1e6 * value.value:.2f} ± {5e5 * (value.upper - value.lower):.2f} us"
        for value in (figures.start, figures.length)
    )
    return [
        f"{timed.camera} exposes {start} after its trigger, for {length}; it states"
        f" {1e6 * timed.stated_s:.2f} us",
        Table("us", ("", "estimate", "from", "to"), rows),
        f"{options.output}: the camera with its times; a code wants --lead-in"
        f" {1e6 * lead_in_s:.0f}us; the window is in {options.figure}",
    ]


def _microseconds(interval: Interval) -> tuple[str, str, str]:
    values = (interval.value, interval.lower, interval.upper)
    return tuple(f"{1e6 * value:.3f}" for value in values)  # type: ignore[return-value]
