"""Verdict in words: what to do, what it gains, and under which conditions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from cep.files.formatting import duration
from cep.optics.code import ShutterCode
from cep.search.expected import WORTH_DB
from cep.search.exposures import TRIMMED_FROM, Exposure, gain_range_db

if TYPE_CHECKING:
    from cep.search.verdict import Verdict

_Gain = tuple[str, str]  # verb, and what follows it


class _Words(NamedTuple):
    """What is done, and with what it is compared, with one camera or two."""

    leave_open: str
    expose: str
    code: str
    open_shutter: str
    snapshot: str


_SINGLE = _Words(
    "Leave the shutter open",
    "expose",
    "Code this exposure",
    "the open shutter",
    "the best single exposure",
)
_PAIR = _Words(
    "Leave both shutters open",
    "expose both cameras",
    "Play the code in one camera and its complement in the other",
    "two open shutters",
    "the best single exposure of both",
)


def recommendation(verdict: Verdict) -> str:
    """Say what to do and what it gains, without a full stop."""
    advised = verdict.advised
    words = _PAIR if verdict.is_pair else _SINGLE
    if advised.kind == "open":
        return f"{words.leave_open}: no shorter exposure and no code found gains {WORTH_DB:g} dB"
    gains = []
    if not verdict.open_saturates:  # a gain over what cannot be recorded says nothing
        gains.append(_gain(verdict, verdict.open_shutter, words.open_shutter))
    if advised.kind == "snapshot":
        text = f"Coding does not pay here: {words.expose} {_share(advised.code)}"
        if not verdict.code_name:
            return f"{text}{_joined(', which ', gains)}; no code that was tried is better"
        if verdict.compared_code:
            gains.append(_gain(verdict, verdict.compared_code, verdict.code_name, ranged=True))
        return text + _joined(", which ", gains)
    user_code = verdict.user_code
    if user_code == advised:
        user_code = None  # the code to take is not compared with itself
    action = words.code
    if advised.kind == "strobe":
        action = f"Pulse the shutter evenly, {_pulses(advised.code)}"
    elif user_code:
        action += f" by {advised.code.bits}"
    if snapshot := verdict.best("snapshot"):
        verb, over = _gain(verdict, snapshot, words.snapshot, ranged=True)
        gains.append((verb, f"{over}, {_share(snapshot.code)}"))
    if user_code:
        gains.append(_gain(verdict, user_code, verdict.code_name))
    return action + _joined(": that ", gains)


def conditions(verdict: Verdict) -> str:
    """Say what the gains are, at which light and noise, and what the limits cost: sentences."""
    sentences = [f"{_meaning(verdict)} {_light_and_noise(verdict)}."]
    if verdict.compared_code is None:
        sentences.append("No code is possible.")
    if verdict.open_saturates:
        sentences.append("The open shutter saturates at this light.")
    if outside := verdict.outside:
        more = _amount(outside.psnr_db - verdict.advised.psnr_db, verdict.photographs)
        sentences.append(f"If the limits can be loosened, {_named(outside)} gains {more} more.")
    return " ".join(sentences)


def _meaning(verdict: Verdict) -> str:
    """Say what the gains are."""
    if not verdict.photographs:
        return f"Gains are about those that a model of {verdict.scene.name} expects"
    spread = ""
    if verdict.photographs >= TRIMMED_FROM:
        spread = " (in brackets: without the least and the greatest)"
    return f"Gains are means over {verdict.scene.counted(verdict.photographs)}{spread}, restored"


def _light_and_noise(verdict: Verdict) -> str:
    """Light, noise and the error of the path, in words."""
    camera = verdict.camera
    light = f"at {camera.photons_full_scale:,.0f} photo-electrons at full scale"
    if verdict.is_pair:
        light += " in each of the two cameras"
    elif verdict.frames > 1:
        light += f" in each of {verdict.frames} frames"
    noise = [f"{camera.read_noise_e:.3g} e- of read noise"]
    if camera.dark_current_e_s:
        noise.append(f"{camera.dark_current_e_s:.3g} e-/s of dark current")
    if verdict.path_error_px:
        noise.append(f"a path known to {verdict.path_error_px:.2g} px")
    return f"{', '.join([light, *noise[:-1]])} and {noise[-1]}"


def _gain(verdict: Verdict, alternative: Exposure, name: str, *, ranged: bool = False) -> _Gain:
    """Say what the advised exposure gains over another, or loses to it."""
    advised = verdict.advised
    gain_db = advised.psnr_db - alternative.psnr_db
    photographs = min(len(advised.photo_psnr_db), len(alternative.photo_psnr_db))
    better, worse = advised, alternative
    if abs(gain_db) < WORTH_DB:
        verb, text = "restores", f"as well as {name}"
    elif gain_db > 0:
        verb, text = "gains", f"{_amount(gain_db, photographs)} over {name}"
    else:
        verb, text = "loses", f"{_amount(gain_db, photographs)} to {name}"
        better, worse = alternative, advised  # a loss is stated by its size
    limits_db = gain_range_db(better, worse)
    if not ranged or limits_db is None:
        return verb, text
    low, high = (round(limit_db, 1) + 0.0 for limit_db in limits_db)  # no -0.0
    return verb, f"{text} ({low:.1f} to {high:.1f} on {verdict.scene.counted(photographs)})"


def _joined(opening: str, gains: Sequence[_Gain]) -> str:
    """Gains as one clause, empty without any; the first one's verb is not repeated."""
    if not gains:
        return ""
    first, gain = gains[0]
    further = [text if verb == first else f"{verb} {text}" for verb, text in gains[1:]]
    return opening + " and ".join([f"{first} {gain}", *further])


def _amount(gain_db: float, photographs: int) -> str:
    decimals = 1 if abs(gain_db) >= 0.95 else 2  # two digits that count
    about = "" if photographs else "about "
    return f"{about}{abs(gain_db):.{decimals}f} dB"


def _named(exposure: Exposure) -> str:
    if exposure.kind == "strobe":
        return _pulses(exposure.code)
    if exposure.kind == "snapshot":
        return f"a single exposure of {_share(exposure.code)}"
    return {"open": "the open shutter", "code": "a code"}[exposure.kind]


def _pulses(code: ShutterCode) -> str:
    """Even pulses in words."""
    first_open = code.bits.index("1")
    first_closed = code.bits.index("0", first_open)
    period = code.bits.find("1", first_closed) - first_open  # from start to start
    return f"{code.pulses} pulses of {first_closed - first_open} chips, one every {period} chips"


def _share(code: ShutterCode) -> str:
    """Open part of the exposure in words, with its time."""
    # 1/4 rather than 25 %, as shutter speeds are written
    ratio = code.chips / code.open_chips
    share = f"1/{float(f'{ratio:.2g}'):g}" if ratio >= 2 else f"{100 / ratio:.0f} %"
    open_s, exposure_s = (count * code.chip_ns * 1e-9 for count in (code.open_chips, code.chips))
    return f"{share} of the time ({duration(open_s)} of {duration(exposure_s)})"
