"""``cep advise``: whether to code an exposure at all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cep.commands.code_options import Device, ExposureTime, chips_option, exposure_seconds
from cep.commands.console import Page, Table, announce, finish, progress
from cep.commands.options import (
    CameraOptions,
    CommonOptions,
    MotionOptions,
    SceneOptions,
    TableFile,
    command,
    option,
    output_option,
    table_files,
)

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from cep.optics.code import ShutterCode
    from cep.search.advise import Advice
    from cep.search.exposures import Exposure
    from cep.search.problem import SearchProblem
    from motdiff.trajectory import Trajectory

_SAME_TIME = 0.01  # relative: a device's ticks round the chip times


@dataclass(frozen=True, kw_only=True)
class AdviseOptions(CommonOptions, CameraOptions, SceneOptions, MotionOptions):
    """Options of ``cep advise``."""

    chips: int | None = chips_option(fewest=2)
    exposure: ExposureTime = None
    code: list[str] | None = option(
        "--code",
        "CODE",
        "A code to judge as well: bits, code.json or a name; may be repeated. A file's"
        " chip time sets the exposure.",
    )
    device: Device = None
    path_error: float | None = option(
        "--path-error",
        "PX",
        "Error of the trajectory, px rms; as its file states it when omitted, else none.",
        min=0,
    )
    output: Path | None = output_option("Also draw the gains over the light: .png, .pdf or .svg.")
    tables: TableFile = None

    def codes(self) -> list[ShutterCode]:
        """Return the codes to judge, all of as many chips."""
        from cep.codes.sources import load_code

        codes = [load_code(source) for source in self.code or ()]
        if len({self.chips, *(code.chips for code in codes)} - {None}) > 1:
            raise ValueError("--code: every code must have as many chips, those of --chips")
        return codes

    def chip_ns(self, codes: Sequence[ShutterCode]) -> int | None:
        """Return the chip time that the files of the codes state, ns; None where none does.

        They must not contradict each other or ``--exposure``.
        """
        from cep.codes.sources import stated_chip_ns
        from cep.files.formatting import duration

        times_ns = sorted(set(filter(None, map(stated_chip_ns, self.code or (), codes))))
        if len(times_ns) > 1:
            raise ValueError(
                "--code: the files state chips of"
                f" {' and '.join(duration(t * 1e-9) for t in times_ns)}"
            )
        if not times_ns:
            return None
        chips = codes[0].chips
        code_s = chips * times_ns[0] * 1e-9
        exposure_s = exposure_seconds(self.exposure)
        if exposure_s is not None and abs(code_s - exposure_s) > _SAME_TIME * exposure_s:
            raise ValueError(
                f"--exposure: {duration(exposure_s)} contradicts the file of --code, whose {chips}"
                f" chips of {duration(times_ns[0] * 1e-9)} take {duration(code_s)}; leave"
                " --exposure out"
            )
        return times_ns[0]

    def problem(
        self, motion: Trajectory, *, chips: int, chip_ns: int | None = None
    ) -> SearchProblem:
        """Return the problem of so many chips; they last ``chip_ns`` where that is stated."""
        from cep.search.chip_count import STANDARD_EXPOSURE_S
        from cep.search.problem import ProblemFields, SearchProblem

        exposure_s: float | None = exposure_seconds(self.exposure) or STANDARD_EXPOSURE_S
        fields: ProblemFields = {"camera": self.load_camera(), "scene": self.load_scene()}
        if chip_ns is not None:
            fields["chip_ns"] = chip_ns
            exposure_s = None
        return SearchProblem.along(
            motion, chips=chips, device=self.device, exposure_s=exposure_s, **fields
        )


@command(AdviseOptions)
def advise(options: AdviseOptions) -> None:
    """Say whether to leave the shutter open, expose for a shorter time, pulse evenly or code.

    Each way may be open for any part of the exposure that the shutter's limits allow, and the
    scene is as bright for all. At the camera's light the gains are measured: twelve photographs,
    or up to twelve parts of your own (--scene), are taken each way, with the camera's photon and
    read noise, and restored. At other light they are about those of a model of them. A code is
    searched at each light level.

    Fields of --json that need a word:

    - choice: open, snapshot (one shorter exposure), strobe (even pulses) or code, at the camera's
      light.
    - gains_db: of the best of each kind over the open shutter; of code: even pulses included.
    - scene: what is photographed, or the file of --scene.
    - photographs: on how many the gains were measured, or parts of that of --scene; 0 where they
      are the model's, as at other light, for motions of more than 128 px and for the scenes text,
      texture and flat-part. photo_psnr_db has each one's figure.
    - code_gain_db: of the best code over the best of open shutter and single exposure.
      code_gain_range_db: on the photographs, without the least and the greatest; null without.
    - open_saturates: whether the open shutter collects more than the camera can record. Its
      figures, which gains_db compares with, are then as if it could; ways that saturate are never
      advised.
    - equal_light_gains_db: the same where a brighter lamp makes up for the closed time, of the
      best of each kind there.
    - codes: those of --code.
    - crossover: ranges of light, photo-electrons at full scale, in which a code gains 0.1 dB or
      more; null at an end that lies beyond the levels tried.
    - outside_limits: a better way that the shutter's limits rule out, or null.

    Example: cep advise --linear 40 --exposure 1/30 --photons 3000 --read-noise 10

    Example: cep advise --trajectory motion/trajectory.json --device sony-pregius --exposure 0.004
    """
    with progress("comparing") as tick:
        from cep.files.formatting import duration
        from cep.plots.advice import advice_figure
        from cep.plots.canvas import check_figure_name, save
        from cep.search.advise import advise as compare_exposures
        from cep.search.chip_count import STANDARD_EXPOSURE_S, problem_of_standard_chips
        from motdiff.files.outputs import claim

        output = options.output
        if output is not None:
            check_figure_name(output)  # before minutes of work
        codes = options.codes()
        stored = options.load_motion()
        motion = stored.trajectory
        error_px = options.path_error
        if error_px is None:
            error_px = options.path_error_px(stored)
        chip_ns = options.chip_ns(codes)
        chips = options.chips
        if codes:
            chips = codes[0].chips
        # wrong options are named before outputs in the way
        if chips is None:
            options.load_camera(), options.load_scene()  # else a wrong one is read for each number
            problem = problem_of_standard_chips(lambda count: options.problem(motion, chips=count))
        else:
            problem = options.problem(motion, chips=chips, chip_ns=chip_ns)
        pictures = options.pictures(motion)
        outputs = claim(
            filter(None, [output, *table_files(options.tables)]),
            force=options.force,
            inputs=filter(None, [options.trajectory, options.scene_file]),
        )
        advice = compare_exposures(
            problem,
            *codes,
            path_error_px=error_px,
            photographs=pictures,
            seed=options.seed,
            announce=announce,
            progress=tick,
        )
    candidates = [
        candidate
        for code in codes
        for candidate in advice.here.exposures
        if candidate.code.bits == code.bits
    ]
    warnings = []
    if options.exposure is None and chip_ns is None:
        length = duration(STANDARD_EXPOSURE_S)
        warnings.append(f"the exposure is taken as {length}; --exposure says how long it is")

    def draw(staged: Mapping[Path, Path]) -> None:
        if output is not None:
            save(advice_figure(advice), staged[output])

    finish(
        {
            **advice.to_dict(),
            "codes": [candidate.to_dict() for candidate in candidates],
            "plot": output,
            "seed": options.seed,
            "warnings": warnings,
        },
        _page(advice, candidates, output),
        as_json=options.as_json,
        outputs=outputs,
        save=draw,
        tables=options.tables,
        summary=advice.here.sentence,
    )


def _page(
    advice: Advice,
    own_codes: Sequence[Exposure],
    plot: Path | None,
) -> Page:
    from cep.files.formatting import duration, formatted

    at_camera = advice.here
    problem = advice.problem
    yield at_camera.sentence
    yield advice.where
    open_shutter = at_camera.open_shutter
    best = map(at_camera.best, at_camera.gains_db)
    # by name, as the best code may be the same even pulses as the best strobe
    exposures = {
        exposure.label: exposure for exposure in (open_shutter, *best) if exposure is not None
    }
    exposures |= {
        f"your {exposure.label}, {exposure.code.bits}": exposure for exposure in own_codes
    }
    rows: list[tuple[object, ...]] = []
    for name, exposure in exposures.items():
        gain_db = exposure.psnr_db - open_shutter.psnr_db
        equal_light_db = None
        if not at_camera.open_saturates:  # else it saturates under the brighter lamp all the more
            equal_light_db = exposure.equal_light_db - open_shutter.equal_light_db
        cells = (formatted(figure, "+.2f") for figure in (gain_db, equal_light_db))
        rows.append((name, exposure.code.open_chips, *cells))
    columns = ("", f"open, of {problem.chips}", "gain, dB", "at equal light, dB")
    yield Table("over the open shutter, worse direction where unknown", columns, rows)
    levels = [
        (
            f"{level.camera.photons_full_scale:,.0f}",
            formatted(level.gains_db.get("snapshot"), "+.2f"),
            formatted(level.gains_db.get("code"), "+.2f"),
            level.choice,
        )
        for level in advice.levels
    ]
    heads = ("photo-electrons", "single exposure, dB", "code, dB", "advised")
    yield Table("over the light", heads, levels)
    chip, length = (
        duration(time_ns * 1e-9) for time_ns in (problem.chip_ns, problem.chips * problem.chip_ns)
    )
    yield f"{problem.chips} chips of {chip}, {length} in all"
    if plot is not None:
        yield f"{plot}: gains over the light"
