"""``cep optimize``: the shutter code for a motion."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from cep.commands.code_options import (
    CODE,
    SEARCH,
    CodeOptions,
    SearchRunOptions,
    chips_option,
    ending,
    objective_mix,
    openings,
    saved_on_interrupt,
)
from cep.commands.console import Page, Table, announce, finish, printed_command, progress
from cep.commands.options import MOTION, CommonOptions, MotionOptions, command, option

if TYPE_CHECKING:
    from cep.search.optimized_code import OptimizedCode
    from cep.search.problem import Scenario, SearchProblem
    from motdiff.files.trajectories import StoredMotion

_SPEEDS = 5  # of a range: the worst speed lies at one of its ends or near the middle


@dataclass(frozen=True, kw_only=True)
class OptimizeOptions(CommonOptions, SearchRunOptions, CodeOptions, MotionOptions):
    """Options of ``cep optimize``."""

    chips: int | None = chips_option(fewest=1)
    frames: int = option(
        "--frames",
        "N",
        "2 for two cameras that record one exposure at the same time, beside each other or behind"
        " a beam splitter: one plays the code, the other its complement, and cep deblur restores"
        " from both. --photons is the light of each.",
        1,
        panel=CODE,
    )
    speed: str | None = option(
        "--speed",
        "LOW:HIGH",
        "Design for these factors of the path's length, as 0.8:1.2; the worst counts.",
        panel=MOTION,
    )
    method: str = option(
        "--method",
        "NAME",
        "anneal; or exact, which proves the best min-mtf, to about 40 chips.",
        "anneal",
        panel=SEARCH,
    )

    def scenarios(self, stored: StoredMotion) -> tuple[Scenario, ...]:
        """Return the motion at the speeds that are designed for."""
        from cep.search.problem import Scenario, speed_range

        if self.speed is None:
            return (Scenario(stored.trajectory),)
        first, _, second = self.speed.partition(":")
        try:
            low, high = float(first), float(second or first)
        except ValueError:
            raise ValueError(f"--speed: must be LOW:HIGH as 0.8:1.2, got {self.speed!r}") from None
        # a single factor is one speed, not a range
        return speed_range(stored.trajectory, low, high, _SPEEDS if low < high else 1)

    def searched(self, stored: StoredMotion, motions: tuple[Scenario, ...]) -> SearchProblem:
        """Return the problem along a motion, of the standard number of chips where it is open."""
        from cep.optics.straight_motion import uniform_length_px
        from cep.search.chip_count import STANDARD_EXPOSURE_S, problem_of_standard_chips

        exact = self.method == "exact"
        objective = objective_mix(self.objective or "mse")
        if self.objective is None and exact and uniform_length_px(stored.trajectory) is not None:
            objective = "min-mtf"  # a proof is for the minimum of a code's polynomial
        if self.chips is not None:
            return self.problem(*motions, objective=objective, frames=self.frames)
        return problem_of_standard_chips(
            lambda chips: self.problem(
                *motions,
                chips=chips,
                exposure_s=STANDARD_EXPOSURE_S,
                objective=objective,
                frames=self.frames,
            )
        )


@command(OptimizeOptions)
def optimize(options: OptimizeOptions) -> None:
    """Search the code whose photo restores best along a motion; Ctrl-C keeps the best so far.

    The code is compared with what would be used instead, and never loses to another code that
    keeps the limits, by the objective; between it and a single exposure photographs decide. With
    --frames 2 it is compared together with its complement in a second camera. Of one camera its
    minimum is certified, and a bound says how far from the best it can be at most. cep audit
    code.json checks the certificate again.

    Fields of --json that need a word:

    - complement: with --frames 2 the chips of the second camera. min_mtf is then of the root of
      the mean of both |H|^2, noise_gain_db and mse_db of the restoration from both photos;
      certificate, bound and gap are null.
    - bound: what no code of so much light can exceed: min_chip for a uniform straight motion, else
      min_mtf. With --objective noise: the noise gain that none can fall below. null for other
      objectives.
    - gap: how far this code is from the bound, 0..1; in dB for the noise.
    - noise_gain_db: null above 100 dB, as of codes with a zero.
    - stopped: steps (all moves made), time, proven, complete (no other code keeps the limits), or
      interrupted (Ctrl-C).
    - within_limits, of each of baselines: whether it keeps the limits; the search could not return
      the others.
    - verdict: what to do and what it gains, in one or two sentences. choice: open, snapshot (one
      shorter exposure), strobe (even pulses) or code. gains_db: gain of the best of each over the
      open shutter, on twelve photographs or parts of that of --scene; of code this one.
    - proven: no code is better, over the whole unit circle; or, unless one straight motion is all
      there is, at the band's samples.

    Example: cep optimize --trajectory motion/trajectory.json --chips 40 --open 40%:60% -o
    code.json

    Example: cep optimize --linear 36 --chips 36 --method exact

    Example: cep optimize --linear 52 --open 26 --objective min-mtf:0.15,noise:1

    Example: cep optimize --trajectory motion/trajectory.json --frames 2 -o code.json
    """
    with progress("counting codes" if options.method == "exact" else "searching") as tick:
        from cep.search.code_search import SearchOptions
        from cep.search.optimize import checked_motion
        from cep.search.optimize import optimize as optimize_code
        from motdiff.files.outputs import claim

        stored = options.load_motion()
        error_px = options.path_error_px(stored)
        scenarios = options.scenarios(stored)
        problem = options.searched(stored, scenarios)
        pictures = options.pictures(*(scenario.trajectory for scenario in scenarios))
        # wrong options are named before outputs in the way
        how: dict[str, Any] = {
            "method": options.method,
            "steps": options.steps,
            "time_s": options.time_s,
            "seed": options.seed,
        }
        SearchOptions(**how)  # for its checks alone
        checked_motion(problem, stored.trajectory)
        outputs = claim(
            [options.output],
            force=options.force,
            inputs=filter(None, [options.trajectory, options.scene_file]),
        )
        with saved_on_interrupt(outputs) as keep:
            best = optimize_code(
                problem,
                **how,
                along=stored.trajectory,
                path_error_px=error_px,
                photographs=pictures,
                announce=announce,
                progress=tick,
                on_found=lambda code: keep({options.output: code}),
            )
    source = {
        "trajectory": options.trajectory,
        "linear_px": options.linear,
        "speed": options.speed,
    }
    finish(
        {
            "file": options.output,
            **best.to_dict(),
            "warnings": best.warnings,
            "seed": options.seed,
        },
        _page(best, options),
        as_json=options.as_json,
        outputs=outputs,
        save=lambda staged: best.save(staged[options.output], source=source),
        summary=best.code.bits,
    )


def _page(best: OptimizedCode, options: OptimizeOptions) -> Page:
    """Lay a search and its comparison out for people."""
    from cep.files.formatting import duration, number

    code = best.code
    search = best.search
    file = str(options.output)
    modulus, figure, head = ("|H|", "min_mtf", "min MTF")
    if best.along is None:  # a straight motion's minimum is that of the code's polynomial
        modulus, figure, head = ("|P|", "min_chip", "min |P|, chips")
    yield best.verdict.sentence
    yield f"{file}: {code.bits}"
    if best.complement:
        yield f"complement:{file}: {best.complement.bits}"
    chip, exposure = (duration(time_ns * 1e-9) for time_ns in (code.chip_ns, code.duration_ns))
    yield (
        f"{code.open_chips} of {code.chips} chips open, {openings(code)}; {chip} a chip,"
        f" {exposure} in all; {search.seconds:.1f} s, {ending(search.stopped, search.steps)}"
    )
    columns = ("code", "open", head, "noise gain, dB", "MSE, dB")
    rows = [
        (
            row.label,
            row.code.open_chips,
            *(row.metrics.in_words(name) for name in (figure, "noise_gain_db", "mse_db")),
        )
        for row in best.comparison
    ]
    yield Table("compared on this motion (worse direction where unknown)", columns, rows)
    if best.complement:
        yield "both cameras, restored together; min MTF: root of the mean of both |H|^2, sampled"
        complement = f"complement:{file}"
        exported = printed_command("cep", "export", file)
        yield f"one camera: {exported} -f FORMAT; the other: {complement}"
        restored = printed_command(
            *("cep", "deblur", "a.png", "b.png"),
            code=[file, complement],
            trajectory=options.trajectory,
            linear=None if options.linear is None else f"{options.linear:g}",
        )
        yield f"photos: {restored}"
    if best.certificate:
        yield (
            f"certified: min {modulus} lies within "
            f"{best.certificate.lower:.6g}..{best.certificate.upper:.6g}"
        )
    if search.stopped == "proven" and search.proof is not None:
        proven = "proven"
        if "file" in search.proof:  # an earlier proof that comes with the package
            proven += f" ({search.proof['file']})"
        yield f"{proven}: no code within the limits is better on {search.proof['domain']}"
    elif best.bound is not None:
        yield (
            f"{best.figure}: no code with so many open chips can do better than"
            f" {number(best.bound)}"
        )
