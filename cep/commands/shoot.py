"""``cep shoot``: a photo through a code, by a camera and a shutter controller."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from cep.commands.code_options import exposure_seconds
from cep.commands.console import announce, finish, printed_command, progress
from cep.commands.options import (
    ChipNs,
    Force,
    Json,
    MotionOptions,
    command,
    flag,
    option,
    output_option,
)
from cep.commands.shoot_runs import (
    calibrate_by_shots,
    calibrate_with_set,
    end_unless_counted,
    take_photos,
)

if TYPE_CHECKING:
    from cep.optics.code import ShutterCode
    from cep.shutter.exposure_plan import ShotSettings

_RUN = "Instead of one photo"
_FOLDER = Path("shot")


@dataclass(frozen=True, kw_only=True)
class ShootOptions(MotionOptions):
    """Options of ``cep shoot``."""

    camera: str | None = option(
        "--camera",
        "KIND:ADDRESS",
        "Camera, as pylon: or pylon:22845317; twin: is an emulated one, burst:VIDEO a"
        " slow-motion video, folder:PATH the next photo that another program saves.",
    )
    port: str | None = option(
        "--port",
        None,
        "Serial port of the shutter's controller, its USB serial number, or auto.",
        short="-p",
    )
    code: str | None = option("--code", "CODE", "Code of the exposure: bits, code.json or a name.")
    chip_ns: ChipNs = None
    trigger: str | None = option(
        "--trigger",
        "WHO",
        "Who begins: shutter (its output busy triggers the camera), camera (its output"
        " exposure active triggers the shutter), external (the machine triggers the shutter,"
        " that the camera), host (this computer both, without a wire between them).",
    )
    profile: str | None = option(
        "--profile",
        "NAME|FILE",
        "The camera's file: its noise, for the restoration, and the times that cep hw"
        " timing has measured.",
    )
    lead_in: str | None = option(
        "--lead-in",
        "TIME",
        "Closed time before the code, for the camera's delay: that of --profile, or 1ms.",
    )
    exposure: str | None = option(
        "--exposure", "TIME", "Of the camera; the least that holds the code when omitted."
    )
    gain: float | None = option("--gain", "DB", "Of the camera.")
    wait: str = option(
        "--wait", "TIME", "For the machine's trigger, or another program's photo.", "10s"
    )
    repeat: int = option(
        "--repeat",
        "N",
        "Take so many photos, and say how repeatable they are.",
        1,
        panel=_RUN,
        min=1,
    )
    set_folder: Path | None = option(
        "--set",
        "DIR",
        "Take all photos of a set of cep calibration-set, and calibrate.",
        panel=_RUN,
    )
    is_calibrating: bool = flag(
        "--calibrate",
        "Take photos of a motion that repeats until its order in time is sure: the first"
        " with the shutter open, each other through a code chosen by those before it.",
        panel=_RUN,
    )
    arm: str | None = option(
        "--arm",
        "N|always",
        "Without --camera: play on every trigger of a running belt, so many times.",
        panel=_RUN,
    )
    wiring: bool = flag(
        "--wiring",
        "Say which pin goes where, and how long the camera has to expose; -o wiring.svg draws it.",
        panel=_RUN,
    )
    output: Path = output_option(
        "Folder to write into, made when missing; of --wiring a picture.",
        _FOLDER,
        metavar="FOLDER",
    )
    force: Force = False
    as_json: Json = False

    def load_code(self) -> ShutterCode:
        """Return the code of ``--code``."""
        from cep.codes.sources import load_code

        if self.code is None:
            raise ValueError("--code: is needed: bits, a code.json or a published name")
        return load_code(self.code, chip_ns=self.chip_ns)

    def check(self) -> None:
        """Refuse options that contradict each other."""
        from cep.shutter.exposure_plan import Release

        if self.trigger is not None and self.trigger not in [*Release]:
            raise ValueError(
                f"--trigger: must be one of {', '.join(Release)}, got {self.trigger[:40]!r}"
            )
        runs = {
            "--set": self.set_folder,
            "--calibrate": self.is_calibrating or None,
            "--arm": self.arm,
            "--wiring": self.wiring or None,
        }
        options = [name for name, value in runs.items() if value is not None]
        if len(options) > 1:
            raise ValueError(f"{' and '.join(options)}: give one of them at most")
        if self.set_folder is not None and (self.code is not None or self.repeat > 1):
            raise ValueError("--code and --repeat: not valid with --set, which has the codes")
        if self.is_calibrating and (self.code is not None or self.repeat > 1):
            raise ValueError(
                "--code and --repeat: not valid with --calibrate, which chooses codes"
            )
        if self.arm is not None and (self.camera is not None or self.port is None):
            raise ValueError(
                "--arm: needs --port and no --camera; photos of a camera on a belt are --trigger"
                " external --repeat N"
            )
        if self.arm is None and self.camera is None and not self.wiring:
            raise ValueError("--camera: is needed, as pylon:, or twin: for an emulated one")

    def settings(self) -> ShotSettings:
        """Return what the photos are taken with."""
        from cep.optics.camera import Camera
        from cep.shutter.exposure_plan import Release, ShotSettings

        wait_s = exposure_seconds(self.wait)
        assert wait_s is not None
        return ShotSettings(
            release=None if self.trigger is None else Release(self.trigger),
            motion=self.load_motion().trajectory if self.has_motion else None,
            profile=None if self.profile is None else Camera.load(self.profile),
            lead_in_s=exposure_seconds(self.lead_in),
            exposure_s=exposure_seconds(self.exposure),
            gain_db=self.gain,
            wait_s=wait_s,
        )


@command(ShootOptions)
def shoot(options: ShootOptions) -> None:
    """Take a photo through a code: upload, read back, arm, fire, read the frame, check, restore.

    The strobe or shutter plays the code while the camera exposes once. Writes photo.tif, the
    frame's own code values; photo.json, which holds all that cep deblur photo.tif needs; and,
    where the motion is known, restored.png. A photo counts if the code was played once, without a
    missed edge, within the exposure that the camera states, and if the camera gave one frame.

    Whatever fails, the shutter is closed: by this computer, or, where it is gone, by the
    controller within a second or at the code's end.

    Words: exposure active is the camera's output that is high while it exposes (strobe out, flash
    sync); blanking the closed time between two exposures.

    Example: cep shoot --camera twin: --code raskar-52 --chip-ns 200000 --linear 52 -o shot

    Example: cep shoot --camera pylon: --port /dev/ttyACM0 --code code.json --trajectory
    motion/trajectory.json -o shot

    Example: cep shoot --camera burst:fall.mp4 --code code.json -o shot

    Example: cep shoot --camera pylon: --wiring --code code.json -o wiring.svg

    Example: cep shoot --camera pylon: --port auto --set set -o calibration

    Example: cep shoot --camera pylon: --port auto --calibrate --chip-ns 200000 -o calibration
    """
    options.check()
    if options.wiring:
        _wiring(options)
    elif options.arm is not None:
        _arm(options, options.arm)
    elif options.set_folder is not None:
        calibrate_with_set(options, options.set_folder)
    elif options.is_calibrating:
        calibrate_by_shots(options)
    else:
        _photos(options)


def _photos(options: ShootOptions) -> None:
    """Take one photo, or several of one code."""
    code = options.load_code()
    stems = ["photo"]
    if options.repeat > 1:
        stems = [f"photo_{number:03d}" for number in range(1, options.repeat + 1)]
    photos = take_photos(options, [code], stems, count=options.repeat)
    restored = None
    following = f"then: {printed_command('cep', 'deblur', photos.files[0])}"
    if options.has_motion and photos.shots[0].counts:
        with progress("restoring") as tick:
            photos.restore(tick)
        restored = photos.restored
        following = f"{restored}: the photo restored along the motion that was given"
    lines = [photos.headline, following]
    result: dict[str, object] = {
        "photos": photos.files,
        **photos.shots[-1].record.to_dict(),
        "restored": restored,
    }
    if len(photos.shots) > 1:
        from cep.shutter.shoot import repeatability

        alike = repeatability([shot.light for shot in photos.shots])
        result["repeatability"] = alike
        lines.insert(1, f"{len(photos.shots)} photos: {alike}")
    result["warnings"] = photos.warnings
    finish(result, lines, as_json=options.as_json)
    end_unless_counted(photos)


def _arm(options: ShootOptions, count: str) -> None:
    """Play on every trigger of a belt."""
    import math

    from cep.shutter.play import play_on_triggers

    assert options.port is not None
    plays = None if count == "always" else int(count) if count.isdecimal() else 0
    if plays == 0:
        raise ValueError(f"--arm: must be a number of plays or always, got {count[:40]!r}")
    with progress("playing on triggers") as tick:
        belt = play_on_triggers(
            options.port,
            options.load_code(),
            plays=plays,
            wait_s=math.inf if plays is None else exposure_seconds(options.wait) or math.inf,
            tell=lambda total: tick(total / plays if plays else 0.0, f"{total} plays"),
        )
    of = f" of {plays}" if plays else ""
    line = (
        f"{options.port}: played {belt.plays}{of} times in {belt.seconds:.1f} s,"
        f" {belt.missed_edges} edges missed, shutter closed"
    )
    finish({"port": options.port, **vars(belt)}, [line], as_json=options.as_json)
    if plays and belt.plays < plays:
        announce(f"no trigger within {options.wait}: {plays - belt.plays} plays are missing")
        raise typer.Exit(1)


def _wiring(options: ShootOptions) -> None:
    """Say which pin goes where, and draw it."""
    from cep.commands.hardware_options import open_controller
    from cep.plots.canvas import check_figure_name, save
    from cep.shutter.wiring import wiring, wiring_figure, wiring_lines
    from motdiff.files.outputs import claim

    picture = None if options.output == _FOLDER else options.output
    if picture is not None:
        try:
            check_figure_name(picture)
        except ValueError as error:
            raise ValueError(f"--output: {error}") from None
    kind = (options.camera or "pylon:").partition(":")[0]
    firmware = None
    if options.port is not None:
        with open_controller(options.port) as controller:
            firmware = controller.announced.firmware
    boards = wiring(kind, options.load_code(), firmware=firmware, settings=options.settings())
    lines = wiring_lines(boards)
    result: dict[str, object] = {"camera": kind, "wiring": lines}
    if picture is None or not boards:
        finish(result, lines, as_json=options.as_json)
        return
    figure = wiring_figure(boards)
    finish(
        result | {"picture": picture},
        [*lines, f"{picture}: the same, drawn"],
        as_json=options.as_json,
        outputs=claim([picture], force=options.force),
        save=lambda staged: save(figure, staged[picture]),
    )
