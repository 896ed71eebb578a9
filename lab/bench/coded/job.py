"""The table of ``python -m lab bench cep``, planned."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from shlex import quote

from lab.bench import datasets
from lab.bench.coded.calibrations import CALIBRATIONS
from lab.bench.coded.designs import USUAL_DESIGNS, design_of
from lab.bench.coded.protocol import CodedProtocol, coded_protocol
from lab.bench.coded.report import OUTPUTS, coded_report
from lab.bench.coded.run import measure_coded, scene_px
from lab.bench.harness import Job, Progress, Report, Request, outcome_warnings
from lab.bench.table_io import Provenance
from lab.bench.user_codes import load_user_codes, user_code_options


def cep_job(
    request: Request,
    *,
    protocol: str = "paper",
    designs: Sequence[str] = (),
    codes: Sequence[str] = (),
    changes: Sequence[str] = (),
) -> Job:
    """Plan the table of codes, compared by the photos they give.

    Parameters
    ----------
    request : Request
    protocol : str
        As of :func:`lab.bench.coded.protocol.coded_protocol`.
    designs : sequence of str
        Ways to choose the code; when empty those of :data:`lab.bench.coded.designs.USUAL_DESIGNS`.
    codes : sequence of str
        User-defined codes, each ``NAME=SOURCE``.
    changes : sequence of str
        Of the protocol's fields, as of :func:`lab.bench.coded.protocol.coded_protocol`.

    Raises
    ------
    ValueError
        If a file is in the way, an option is not valid, or the folder holds no usable photo. Names
        of designs are checked when the job runs.
    OSError
        If a file cannot be read.
    """
    request.claim(OUTPUTS)
    full = coded_protocol(protocol, changes)
    chosen = full.quick if request.quick else full
    names = list(designs) or list(USUAL_DESIGNS)
    user_codes = load_user_codes(codes)
    calibrates = any(design_of(name).path in CALIBRATIONS for name in names)
    photos, scenes, photo_warnings = _photos(request.data, chosen, calibrates=calibrates)
    command = request.command(
        "cep",
        {
            "--protocol": Path(protocol).name,
            "--set": " --set ".join(map(quote, changes)),
            "--designs": ",".join(designs),
            "": user_code_options(codes, user_codes),
        },
    )

    def measure(progress: Progress) -> Report:
        measured = measure_coded(
            chosen,
            photos,
            engine=request.engine,
            designs=names,
            codes=user_codes,
            calibrated_on=scenes,
            progress=progress,
        )
        outcome = measured.outcome
        warnings = [*photo_warnings, *outcome_warnings(outcome)]
        return coded_report(measured, Provenance(command, chosen.seed, outcome.machines, warnings))

    about = {
        "folder": request.output,
        "protocol": chosen.name,
        "designs": names,
        "codes": {name: code.bits for name, code in user_codes.items()},
    }
    return Job(request, OUTPUTS, about, measure)


def _photos(
    data: Path | None, protocol: CodedProtocol, *, calibrates: bool
) -> tuple[dict[str, Path], tuple[Path, ...], list[str]]:
    """Pick the sharp photos and others to calibrate on, with warnings where they are not as the
    protocol asks.
    """
    paths = datasets.bundled_photos() if data is None else datasets.photo_folder(data)
    photos = datasets.pick(paths, protocol.photos, least_px=scene_px(protocol))
    warnings = [] if data else [datasets.BUNDLED_WARNING]
    if len(photos) < protocol.photos:
        warnings.append(
            f"{len(photos)} photos are large enough, the protocol asks for {protocol.photos}"
        )
    scenes: tuple[Path, ...] = ()
    if calibrates:
        unused = [path for path in paths if path not in photos]
        try:
            scenes = datasets.pick(unused, protocol.motions, least_px=scene_px(protocol))
        except ValueError:  # none is large enough
            warnings.append(
                "no other photos are large enough to calibrate on: calibrations show those"
                " restored"
            )
    return dict(zip(datasets.labels_of(photos), photos, strict=True)), scenes, warnings
