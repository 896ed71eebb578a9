"""``--next`` of ``cep calibrate``: the code of the photo to be taken next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.commands.code_options import Device
from cep.commands.console import printed_command
from cep.commands.options import option
from cep.search.chip_count import STANDARD_CHIPS
from motdiff.estimators.registry import blind_methods

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from cep.calibration.next_code import NextCode
    from cep.commands.calibrate import CalibrateOptions
    from cep.optics.code import ShutterCode
    from motdiff.estimators.base import MotionEstimate
    from motdiff.files.outputs import Outputs

_PANEL = "With --next"

_OPTIONS = {
    "least_probability": "--sure",
    "chips": "--chips",
    "chip_ns": "--chip-ns",
    "device": "--device",
}
"""Options that are for the next code alone, by their names in Python."""


@dataclass(frozen=True, kw_only=True)
class NextOptions:
    """Options of the next photo's code."""

    next_file: Path | None = option(
        "--next",
        "FILE",
        "Code file to write: the code of the next photo, chosen for this motion, until"
        " its order in time is sure. The first photo has an open shutter.",
        panel=_PANEL,
    )
    least_probability: float | None = option(
        "--sure",
        "P",
        "Probability of the order from which no other photo is asked for.",
        panel=_PANEL,
        min=0,
        max=0.97,  # the largest that is stated
        show_default="0.95",
    )
    chips: int | None = option(
        "--chips",
        "N",
        "Chips of the first code.",
        short="-n",
        panel=_PANEL,
        min=4,
        max=512,
        show_default=f"as in the codes, else {STANDARD_CHIPS}",
    )
    chip_ns: int | None = option(
        "--chip-ns",
        "NS",
        "Chip time of the first code.",
        panel=_PANEL,
        min=1,
        show_default="1000000",
    )
    device: Device = None

    def check_next(
        self, sources: Sequence[str], *, method: str, is_blind: bool, photos: int
    ) -> None:
        """Refuse what does not go with ``--next``, or with its absence."""
        options = [_OPTIONS[name] for name in self._given()]
        if self.next_file is None:
            if options:
                raise ValueError(f"{options[0]}: is for --next FILE, the code of the next photo")
            return
        if photos > 1 and not sources:
            raise ValueError(
                "--next: needs the code of each photo, as --code open for the first one"
            )
        if sources and sources[0] != "open":
            raise ValueError(
                f"--next: begins with a photo through an open shutter (--code open), got"
                f" --code {sources[0]}"
            )
        if not (is_blind or sources):
            raise ValueError(
                f"--next: needs --method {' or '.join(blind_methods())} for the first photo, and"
                " --code after it"
            )
        if sources and method == "point":
            raise ValueError(
                "--next: is for photos of a scene; a light's trail through one code has an order"
            )
        if len(sources) > 1:
            for name in ("--chips", "--chip-ns"):
                if name in options:
                    raise ValueError(f"{name}: the codes given say it")

    def check_code(self, codes: Sequence[ShutterCode]) -> None:
        """Refuse a next code that cannot be, where one is asked for."""
        if self.next_file is not None:
            from cep.calibration.next_code import next_limits

            next_limits(codes, **self._given())

    def _given(self) -> dict[str, Any]:
        """Return the settings of the next code that are given, by their names in Python."""
        values = {name: getattr(self, name) for name in _OPTIONS}
        return {name: value for name, value in values.items() if value is not None}

    def write_next(
        self,
        photos: Sequence[ArrayLike],
        codes: Sequence[ShutterCode],
        estimate: MotionEstimate,
        *,
        outputs: Outputs,
        seed: int,
    ) -> NextCode | None:
        """Choose the next code and write it; None where no other photo is needed."""
        import numpy as np

        from cep.calibration.next_code import next_code

        assert self.next_file is not None
        rng = np.random.default_rng(seed)
        choice = next_code(photos, codes, estimate, **self._given(), rng=rng)
        if choice is not None:
            with outputs.written(summary=choice.code.bits) as staged:
                choice.save(staged[self.next_file])
        return choice


def next_step(
    choice: NextCode | None,
    options: CalibrateOptions,
    *,
    sources: Sequence[str],
    codes: Sequence[ShutterCode],
    estimate: MotionEstimate,
    folder: Path,
) -> list[str]:
    """Say what to do now: the next photo and the command after it, or that none is needed."""
    target = options.next_file
    assert target is not None
    gamma = options.gamma if options.gamma != "srgb" else None
    photos = list(map(str, options.images))
    if choice is None:
        if estimate.details.get("motion_blur") is False:
            shows = "photos show" if len(photos) > 1 else "photo shows"
            return [f"No code: the {shows} no motion blur."]
        trajectory = folder / "trajectory.json"
        optimize = optimize_command(trajectory, codes, device=options.device)
        deblur = printed_command(
            "cep", "deblur", *photos, code=list(sources), trajectory=trajectory, gamma=gamma
        )
        return [
            "Take no other photo: the order in time is known with probability"
            f" {estimate.confidence:.2f}; no code is written.",
            f"then: {optimize}",
            f"photos: {deblur}",
        ]
    number = len(photos) + 1
    calibrate = printed_command(
        "cep",
        "calibrate",
        *photos,
        f"P{number}",
        code=[*(sources or ["open"]), target],
        next=target.with_name(f"{target.stem}_{number + 1}.json"),
        o=f"motion_{number}",
        sure=options.least_probability,
        device=options.device,
        gamma=gamma,
        seed=options.seed or None,
    )
    return [
        f"Take the next photo of this motion with {target}: {choice.reason}.",
        f"then: {calibrate}",
    ]


def optimize_command(trajectory: Path, codes: Sequence[ShutterCode], **options: object) -> str:
    """Write the search of a code for a motion, as long as the codes that it was found through."""
    from cep.calibration.next_code import timed_codes

    timed = timed_codes(codes)
    return printed_command(
        *("cep", "optimize"),
        trajectory=trajectory,
        chips=timed[0].chips if timed else None,
        exposure=f"{timed[0].duration_ns * 1e-6:g}ms" if timed else None,
        **options,
    )
