"""What ``cep optimize`` runs: the search or the proof, and the bound that its result is held against."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cep.cli.console import progress

if TYPE_CHECKING:
    from cep.code import ShutterCode
    from cep.search.problem import SearchProblem

__all__ = ["bounded", "search", "warnings_of"]

_RELAXED = 128  # chips to which the relaxation takes seconds
_ROUNDED = 16  # codes drawn from it


def search(
    problem: SearchProblem, *, method: str, effort: str, steps: int | None, time_s: float, seed: int
) -> dict[str, Any]:
    """Run the search; code, objective, steps, seconds, interrupted, and the proof's log, None without one."""
    import numpy as np

    from cep.baselines.published import for_chips
    from cep.search.annealing.anneal import anneal, standard_moves
    from cep.search.exhaustive.exact import codes_to_count, exact

    if method == "exact":
        if steps is not None:
            raise ValueError("--steps: a proof with --method exact counts every code; leave it out")
        with progress(f"counting {codes_to_count(problem):.2g} codes") as tick:
            proven = exact(problem, progress=lambda fraction, best: tick(fraction, f"{best.open_chips} open"))
        unit = 1 if problem.scenarios else problem.chips  # |P| counts chips, the objective is light-true
        return {
            "code": proven.code,
            "objective": -20 * float(np.log10(max(proven.minimum.upper / unit, 1e-300))),
            "steps": codes_to_count(problem),
            "seconds": proven.seconds,
            "interrupted": not proven.proven,
            "proof": proven.proof.to_dict(),
        }
    starts = _rounded(problem, seed) if effort == "sdp" else []
    with progress("searching") as tick:
        found = anneal(
            problem,
            rng=np.random.default_rng(seed),
            steps=steps or standard_moves(problem),
            time_s=time_s,
            start=[*(entry.code for entry in for_chips(problem.chips)), *starts],
            progress=lambda fraction, best: tick(fraction, f"{best.open_chips} open"),
        )
    return {
        "code": found.code,
        "objective": found.objective,
        "steps": found.steps,
        "seconds": found.seconds,
        "interrupted": found.interrupted,
        "proof": None,
    }


def _rounded(problem: SearchProblem, seed: int) -> list[ShutterCode]:
    """Codes drawn from the relaxation along a path; on the unit circle it knows nothing of the code."""
    import numpy as np

    from cep.code import ShutterCode
    from cep.search.bounding.bounds import relaxed_minimum
    from cep.search.bounding.relaxation import rounded_codes

    low, high = problem.open_limits
    k = min(max((low + high) // 2, 2), problem.chips - 1)
    if not problem.scenarios or problem.response is not None or not low <= k <= high or problem.chips > _RELAXED:
        return []
    try:
        codes = rounded_codes(relaxed_minimum(problem, k), _ROUNDED, rng=np.random.default_rng([seed, 3]))
    except ValueError:  # no solver found an optimum: the search does without
        return []
    return [ShutterCode.from_array(code) for code in codes]


def bounded(
    problem: SearchProblem, metrics: Any, *, straight: bool, effort: str
) -> tuple[str, float | None, float | None]:
    """Name, bound and gap of the figure that was optimised, None where nothing bounds it."""
    from cep.search.bounding.bounds import bound

    if problem.objective not in ("min-mtf", "noise"):
        return "", None, None
    limits = bound(problem, effort=effort)  # type: ignore[arg-type]
    if problem.objective == "noise":
        return "noise gain, dB", limits.noise, metrics.noise_gain_db - limits.noise
    limit, reached = (limits.min_chip, metrics.min_chip) if straight else (limits.min_mtf, metrics.min_mtf)
    # with so many open chips every code may have a zero: then the limit is 0, and reached
    return "min |P|, chips" if straight else "min MTF", limit, 1 - reached / limit if limit > 0 else 0.0


def warnings_of(problem: SearchProblem, *, interrupted: bool, method: str) -> list[str]:
    """Say what the user should know of the result besides its figures."""
    told = []
    if interrupted:
        what = "the proof was stopped early" if method == "exact" else "the search was stopped early"
        told.append(f"{what}, this is the best code so far")
    if problem.response is not None or len(problem.scenarios) > 1 or problem.scenarios[0].edges is not None:
        told.append("the certificate is for a shutter that opens at once and on time, along the motion as it was given")
    return told
