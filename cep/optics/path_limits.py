"""Limits on paths: too wide or dense to be measured, or too short for so many chips."""

from __future__ import annotations

from cep.optics.straight_motion import stays_in_place, straight_axis, uniform_length_px
from motdiff.trajectory import Trajectory, check_length

FINEST_CHIP_PX = 0.25
"""Shortest mean displacement per chip, px: the pitch of the HR map. Chips below it differ by
nothing a pixel sees."""

LARGEST_FRAME_PX = 1024
"""Widest PSF frame, px, of a bent path that is measured: the work grows with its area, to minutes
and a gigabyte."""

MOST_SAMPLES = 20_000
"""Most samples of a bent path that is measured: the work grows with them, to half a minute of a
code's figures."""

_MOST_WORK = 2**29  # samples times pixels of the frame: minutes of a code's figures


def check_frame(trajectory: Trajectory) -> None:
    """Refuse a path too long, or one too dense or, where it is bent, too wide to be measured.

    ValueError if it is longer than :data:`motdiff.trajectory.LONGEST_PX`, the PSF would need a
    frame of more than :data:`LARGEST_FRAME_PX`, or there are more samples than
    :data:`MOST_SAMPLES`, of a wide path fewer.
    """
    check_length(trajectory)
    if uniform_length_px(trajectory) is not None:
        return
    frame = 1  # of a straight path: it is measured along its axis alone
    if straight_axis(trajectory) is None:
        frame = trajectory.frame_size()
    if frame > LARGEST_FRAME_PX:
        raise ValueError(
            f"trajectory: the path needs a PSF of {frame} px around its zero, at most"
            f" {LARGEST_FRAME_PX} can be handled"
        )
    # a PSF is drawn for each sample: the work is their product
    max_samples = min(MOST_SAMPLES, _MOST_WORK // frame**2)
    if trajectory.t.size > max_samples:
        raise ValueError(
            f"trajectory: the path has {trajectory.t.size} samples, at most {max_samples} of such"
            " a path can be measured; give fewer, the noise between them is not the"
            " camera's motion"
        )


def resolved_chips(trajectory: Trajectory) -> int:
    """Most chips that a path can tell apart, at :data:`FINEST_CHIP_PX` each; at least 1."""
    return max(1, int(trajectory.length_px / FINEST_CHIP_PX))


def check_resolved(trajectory: Trajectory, chips: int) -> None:
    """Refuse a code with more chips than the path can tell apart.

    That is one whose chips cover less than a quarter of a pixel on average; the ValueError says
    how many chips would do, or how long a path where there is none.
    """
    if chips > 1 and stays_in_place(trajectory):
        raise ValueError(
            f"trajectory: the path stays in place, a code of {chips} chips needs a motion of at"
            f" least {chips * FINEST_CHIP_PX:g} px ({FINEST_CHIP_PX} px each)"
        )
    resolved = resolved_chips(trajectory)
    if chips > resolved:
        raise ValueError(
            f"chips: {chips} chips are too many for a path of {trajectory.length_px:.1f} px, "
            f"at most {resolved} can be resolved ({FINEST_CHIP_PX} px each)"
        )
