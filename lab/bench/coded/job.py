"""The table of ``python -m lab bench cep``: planned, then measured and written."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from shlex import quote

from cep.jobs.engine import Engine
from lab.bench import datasets
from lab.bench.coded.calibrations import CALIBRATIONS
from lab.bench.coded.designs import USUAL_DESIGNS, design_of
from lab.bench.coded.protocol import CodedProtocol, coded_protocol
from lab.bench.coded.report import OUTPUTS, write_coded_report
from lab.bench.coded.run import measure_coded, scene_px
from lab.bench.coded.tables import coded_tables
from lab.bench.job import Job, Part, part_of_tables, spelled
from lab.bench.own_codes import load_own_codes, spelled_own_codes
from motdiff.files.outputs import claim_folder


def cep_job(
    output: Path,
    engine: Engine,
    *,
    data: Path | None,
    protocol: str,
    designs: Sequence[str],
    codes: Sequence[str] = (),
    changes: Sequence[str] = (),
    quick: bool,
    force: bool,
) -> Job:
    """Plan the table of codes, compared by the photos they give.

    Parameters
    ----------
    output : Path
        Folder to write into.
    engine : Engine
    data : Path, optional
        Folder of sharp photos; those that scikit-image carries when None.
    protocol : str
        As of :func:`lab.bench.coded.protocol.coded_protocol`.
    designs : sequence of str
        Ways to choose the code; when empty those of :data:`lab.bench.coded.designs.USUAL_DESIGNS`.
    codes : sequence of str
        Codes of the user's own, each ``NAME=SOURCE``.
    changes : sequence of str
        Of the protocol's fields, as of :func:`lab.bench.coded.protocol.coded_protocol`.
    quick : bool
        The protocol's small size.
    force : bool
        Whether existing files may be replaced.

    Raises
    ------
    ValueError
        If a file is in the way, an option is not valid, or the folder holds no usable photo. Names
        of designs are checked when the job runs.
    OSError
        If a file cannot be read.
    """
    claim_folder(output, OUTPUTS, force=force)
    chosen = coded_protocol(protocol, changes)
    chosen = chosen.quick if quick else chosen
    names = list(designs) or list(USUAL_DESIGNS)
    own = load_own_codes(codes)
    photos, scenes, warnings = _photos(
        data, chosen, calibrates=any(design_of(n).path in CALIBRATIONS for n in names)
    )
    given = {
        "--data": data and data.resolve().name,
        "--protocol": Path(protocol).name,
        "--set": " --set ".join(map(quote, changes)),
        "--designs": ",".join(designs),
        "": spelled_own_codes(codes, own),
    }
    command = spelled("cep", given, quick=quick)

    def run(progress: Callable[[float, str], None]) -> Part:
        measured = measure_coded(
            chosen,
            photos,
            cache=engine.cache,
            designs=names,
            codes=own,
            calibrated_on=scenes,
            workers=engine.workers,
            dask=engine.dask,
            progress=progress,
        )
        all_warnings = [*warnings, *measured.warnings]
        if measured.failures:
            name, reason = next(iter(measured.failures.items()))
            all_warnings.append(
                f"{len(measured.failures)} cells failed, the first: {name}: {reason}"
            )
        if measured.missing:
            all_warnings.append(
                "stopped early: cells are left out; the same command with --force goes on"
            )
        tables = coded_tables(measured)
        files = write_coded_report(
            output, tables, measured, command=command, warnings=all_warnings, force=force
        )
        return part_of_tables(
            f"Coded exposure, {chosen.name}",
            command,
            tables,
            files,
            failures=measured.failures,
            missing=measured.missing,
            warnings=all_warnings,
            machines=measured.machines,
        )

    about = {
        "folder": output,
        "protocol": chosen.name,
        "designs": names,
        "codes": {name: one.bits for name, one in own.items()},
    }
    return Job(about, run)


def _photos(
    data: Path | None, protocol: CodedProtocol, *, calibrates: bool
) -> tuple[dict[str, Path], tuple[Path, ...], list[str]]:
    """Pick the sharp photos and others to calibrate on, and list in what they are not as the
    protocol asks.
    """
    paths = datasets.bundled_photos() if data is None else datasets.photo_folder(data)
    picked = datasets.pick(paths, protocol.photos, least_px=scene_px(protocol))
    warnings = []
    if data is None:
        warnings.append(datasets.BUNDLED_WARNING)
    if len(picked) < protocol.photos:
        warnings.append(
            f"{len(picked)} photos are large enough, the protocol asks for {protocol.photos}"
        )
    scenes: tuple[Path, ...] = ()
    if calibrates:
        scenes = _others(paths, picked, protocol)
        if not scenes:
            warnings.append(
                "no other photos are large enough to calibrate on: calibrations show those"
                " restored"
            )
    return dict(zip(datasets.labels_of(picked), picked, strict=True)), scenes, warnings


def _others(
    paths: Sequence[Path], picked: Sequence[Path], protocol: CodedProtocol
) -> tuple[Path, ...]:
    rest = [path for path in paths if path not in picked]
    try:
        return datasets.pick(rest, protocol.motions, least_px=scene_px(protocol))
    except ValueError:  # none is large enough
        return ()
