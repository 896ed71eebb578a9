"""HTML report of the demo: the verdict, photos, motion, exposure or code, MTF, gains, commands."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version
from typing import TYPE_CHECKING

import numpy as np

from cep.files.formatting import duration
from cep.files.images import encode_image
from cep.optics.band import grid_samples
from cep.optics.code import ShutterCode
from cep.optics.exposure import coded_psf, mtf
from cep.optics.mtf import SCENE_MEAN, inverse_scene, noise_variance
from cep.plots import before_after, code_strips, mtf_figure, psf_figure
from cep.plots.advice import advice_figure
from cep.report.motion_section import motion_section
from cep.report.result_page import Picture, Report, Section, Table, picture
from cep.search.expected import WORTH_DB, light_noise
from hw.device import load_profile, profile_names
from hw.program import Program
from motdiff.crops import luminance
from motdiff.psf_frame import PSF_PX
from motdiff.types import FloatArray

if TYPE_CHECKING:
    from cep.optics.camera import Camera
    from cep.proofs.certify.certificate import Certificate
    from cep.report.demo_chain import Chain, Shot
    from cep.search.advise import Advice
    from motdiff.trajectory import Trajectory

DEMO_PICTURES = ("advice", "code_strip", "mtf", "photos", "scene_at_rest")
"""Pictures of the report that are files of their own too; the code strip where a code is
advised."""

_AGREES_DB = 0.3
_INTERVALS = 128
_NAMES = {"open": "open shutter", "snapshot": "best single exposure", "coded": "best code"}


def demo_report(chain: Chain, *, options: str = "", guide: str = "") -> Report:
    """Make the report of a chain.

    Parameters
    ----------
    chain : Chain
    options : str
        How camera and device are named on a command line.
    guide : str
        Address of docs/hardware.md; the page names it without a link when empty.
    """
    colophon = (
        f"coded-exposure {_version('coded-exposure')}, numpy {_version('numpy')}, torch"
        f" {_version('torch')}, Python {platform.python_version()}; seed {chain.seed}. demo.json"
        " holds all figures of the camera. "
        + "Seconds: "
        + ", ".join(f"{what} {seconds:.1f}" for what, seconds in chain.seconds)
        + "."
    )
    sections = [
        _gain(chain),
        _photos(chain),
        motion_section(chain),
        _exposure(chain),
        _mtf(chain),
        _agreement(chain),
    ]
    if chain.contrast is not None:
        sections.append(_contrast(chain.contrast))
    if chain.coded:
        sections.append(_wiring(chain, guide))
    return Report(
        "Should this exposure be coded?",
        chain.advice.here.sentence,
        _facts(chain),
        (*sections, _commands(chain, options)),
        colophon,
        setting=_setting(chain),
        remarks=(*_scene_remark(chain), _difference(chain)),
    )


def share_below_noise(path: Trajectory, code: ShutterCode | None, camera: Camera) -> float:
    """Share of the band, 0..1, in which the reference scene's detail lies below the camera's
    noise.

    There the exposure records less power of a 1/f² scene than of noise.

    Parameters
    ----------
    path : Trajectory
    code : ShutterCode or None
        None: the shutter is open all the time.
    camera : Camera
    """
    samples = grid_samples(_INTERVALS)
    power = mtf(path, code, samples.fx, samples.fy) ** 2
    noise = noise_variance(camera, 1.0) if code is None else light_noise(camera, [code])[0]
    return float(samples.weight @ (power < noise * inverse_scene(samples)[:, 0]))


# -- what to do -----------------------------------------------------------------------------------


def _setting(chain: Chain) -> str:
    camera = chain.camera
    named = camera.name or "a camera without a name"
    kind = f" ({camera.kind})" if camera.kind else ""
    device = "any shutter" if chain.device is None else f"the shutter {chain.device.name}"
    return (
        f"For {named}{kind}: {camera.photons_full_scale:,.0f} photo-electrons at full scale,"
        f" {camera.read_noise_e:.3g} e- of read noise, {camera.bits} bit; an exposure of"
        f" {duration(chain.exposure_s)}, {chain.problem.chips} chips, {device}; motion of"
        f" {chain.estimate.best.length_px:.0f} px."
    )


def _scene_remark(chain: Chain) -> tuple[str, ...]:
    if chain.scene.sharp is not None:
        return ()
    return (
        (
            "The true scene of your photo is not known: its own restoration (TV) stands in for the"
            " scene, and every photo here is simulated from it along the estimated motion. The"
            " figures compare ways to expose; they do not measure how well your photo was"
            " restored."
        ),
    )


def _expected_db(chain: Chain) -> dict[str, float]:
    """Return the expected gain over the open shutter of each photo that was simulated, dB."""
    opened = chain.advice.here.ways[0].psnr_db
    return {shot.kind: shot.way.psnr_db - opened for shot in chain.shots}


def _others(chain: Chain) -> list[Shot]:
    """Photos taken otherwise than advised, the best single exposure first."""
    order = ("snapshot", "coded", "open") if chain.coded else ("coded", "snapshot", "open")
    found = [shot for kind in order if (shot := chain.shot(kind)) is not None]
    return [shot for shot in found if shot is not chain.advised_shot]


def _facts(chain: Chain) -> tuple[tuple[str, str], ...]:
    expected = _expected_db(chain)
    simulated = chain.gains_db()
    advised = chain.advised_shot.kind
    return tuple(
        (
            f"{how} gain over the {_NAMES[other.kind]}",
            f"{_signed(gains[advised] - gains[other.kind])} dB",
        )
        for other in _others(chain)
        for how, gains in (("expected", expected), ("simulated", simulated))
    )


def _difference(chain: Chain) -> str:
    """Why the simulated gains differ from the expected ones, if they do."""
    expected = _expected_db(chain)
    simulated = chain.gains_db()
    advised = chain.advised_shot.kind
    off = {
        other.kind: (
            (simulated[advised] - simulated[other.kind])
            - (expected[advised] - expected[other.kind])
        )
        for other in _others(chain)
    }
    against = [
        other for other in _others(chain) if simulated[other.kind] > simulated[advised] + WORTH_DB
    ]
    contrary = "".join(
        f" In this photo the {_NAMES[other.kind]} restores"
        f" {simulated[other.kind] - simulated[advised]:.1f} dB better than the exposure advised."
        for other in against
    )
    far = {kind: value for kind, value in off.items() if abs(value) >= _AGREES_DB}
    if not far:
        return (
            f"The simulated gains of this photo agree with the expected ones within {_AGREES_DB:g}"
            f" dB.{contrary}"
        )
    said = " and ".join(
        f"{abs(value):.1f} dB {'more' if value > 0 else 'less'} over the {_NAMES[kind]}"
        for kind, value in far.items()
    )
    mean = float(luminance(chain.reference).mean())
    return (
        f"In this photo the gain is {said} than expected. Expected gains are those of a typical"
        f" scene (1/f² spectrum, mean light {SCENE_MEAN:g}) along a motion known"
        f" {_how_exactly(chain)}. This picture has detail of its own, borders, a mean light of"
        f" {mean:.2f}, and {_known_in_words(chain)}.{contrary}"
    )


def _how_exactly(chain: Chain) -> str:
    error_px = chain.advice.path_error_px
    return f"to {error_px:.2g} px" if error_px else "exactly"


def _known_in_words(chain: Chain) -> str:
    if chain.scene.motion is None:
        return "a motion that is taken as exactly known"
    known = chain.gains_db(known=True)
    found = chain.gains_db()
    advised = chain.advised_shot.kind
    return (
        "a motion that is an estimate "
        f"(with the true motion the gain over the open shutter is {_signed(known[advised])} dB, "
        f"with the estimate {_signed(found[advised])} dB)"
    )


def _gain(chain: Chain) -> Section:
    advice = chain.advice
    return Section(
        "Gain over the light",
        (advice.where,),
        (_gains_table(advice),),
        (
            picture(
                advice_figure(advice),
                "Expected gain of each way to expose over the open shutter, at each light level."
                " Each is restored in the best linear way.",
                f"gain over the light: {advice.sentence}",
                name="advice",
            ),
        ),
    )


def _gains_table(advice: Advice) -> Table:
    here = advice.here
    advised = None
    rows: list[tuple[object, ...]] = []
    for kind, gain_db in here.gains_db.items():
        way = here.best(kind)
        if way is None or (kind == "code" and way.kind == "strobe"):  # the same even pulses
            continue
        if way is here.advised:
            advised = len(rows)
        open_s = way.code.open_chips * way.code.chip_ns * 1e-9
        rows.append((way.label, duration(open_s), way.code.pulses, _two(gain_db)))
    light = f"{here.camera.photons_full_scale:,.0f} photo-electrons at full scale"
    return Table(
        ("best of each kind", "open for", "openings", "expected gain, dB"),
        tuple(rows),
        highlight=advised,
        note=(
            f"At {light} and {here.camera.read_noise_e:.3g} e- of read noise; of the worse"
            " direction where the motion's is not known. The marked line is advised."
        ),
    )


# -- photos ---------------------------------------------------------------------------------------


def _photos(chain: Chain) -> Section:
    shown = [shot for shot in chain.shots if shot.kind == "snapshot" or shot is chain.advised_shot]
    opened = chain.shots[0]
    gallery = [
        _photo(
            opened.photo,
            "Blurred",
            "As taken with the shutter open all the time.",
            "the blurred photo",
        ),
        *(
            _photo(
                shot.restored,
                _restored_title(shot),
                f"{_openings(shot.way.code)}; restored to {shot.psnr_db:.2f} dB.",
                f"the scene restored from the photo of the {_NAMES[shot.kind]}",
            )
            for shot in shown
        ),
        _photo(
            chain.reference,
            "Scene at rest" if chain.scene.sharp is not None else "Scene assumed",
            (
                "What a camera at rest would see."
                if chain.scene.sharp is not None
                else "The restoration of your photo that the photos here are simulated from."
            ),
            "the scene without motion",
            name="scene_at_rest",
        ),
    ]
    best = 1 + shown.index(chain.advised_shot)
    others = {
        _NAMES[shot.kind] if shot is not chain.advised_shot else "as advised": shot.restored
        for shot in shown
    }
    table = Table(
        ("photo", "open for", "PSNR restored, dB", "gain, dB"),
        tuple(
            (
                _NAMES[shot.kind]
                + (" (not advised)" if shot.kind == "coded" and not chain.coded else ""),
                duration(shot.way.code.open_chips * shot.way.code.chip_ns * 1e-9),
                f"{shot.psnr_db:.2f}",
                _two(shot.psnr_db - opened.psnr_db),
            )
            for shot in chain.shots
        ),
        highlight=chain.shots.index(chain.advised_shot),
        note=(
            "Every photo is simulated with the same light on the scene and the same motion, and"
            " restored by the same Wiener filter with this camera's noise. PSNR of grey values in"
            " linear light, up to a shift, borders left out."
        ),
    )
    return Section(
        "Photos",
        ("The same scene in the same light, through each exposure.",),
        (table,),
        (
            picture(
                before_after({"blurred": opened.photo, **others, "at rest": chain.reference}),
                "The same pictures, and below each the framed detail enlarged.",
                "blurred, restored and sharp pictures with an enlarged detail of each",
                name="photos",
            ),
        ),
        gallery=tuple(gallery),
        compared=(0, best),
    )


def _photo(image: FloatArray, title: str, caption: str, alt: str, *, name: str = "") -> Picture:
    return Picture(encode_image(image, ".png"), caption, alt, name, title)


def _restored_title(shot: Shot) -> str:
    return {
        "open": "Restored",
        "snapshot": "Single exposure, restored",
        "coded": "Coded, restored",
    }[shot.kind]


def _openings(code: ShutterCode) -> str:
    count = "one opening" if code.pulses == 1 else f"{code.pulses} openings"
    return f"Open for {duration(code.open_chips * code.chip_ns * 1e-9)} in {count}"


# -- exposure -------------------------------------------------------------------------------------


def _exposure(chain: Chain) -> Section:
    code = chain.advised_shot.way.code
    if not chain.coded:
        said = (
            f"{_openings(code)}: the camera's own shutter does that, and nothing is to be wired."
        )
        return Section("Exposure", (said,))
    chip_ms = code.chip_ns * 1e-6
    rows: list[tuple[object, ...]] = []
    at = 0
    for bit, count in code.runs:
        if bit:
            rows.append(
                (str(len(rows) + 1), at * chip_ms, count * chip_ms, (at + count) * chip_ms)
            )
        at += count
    times = Table(
        ("opening", "opens at, ms", "open for, ms", "closes at, ms"),
        tuple(rows),
        note=f"Light comes through for {code.duty:.0%} of the exposure.",
    )
    program = Program.from_bits(code.bits, chip_ns=code.chip_ns)
    profiles = [load_profile(name) for name in profile_names()]
    if chain.device is not None and chain.device not in profiles:
        profiles.insert(0, chain.device)
    checks = [(profile, profile.check(program)) for profile in profiles]
    devices = Table(
        ("shutter or controller", "this code"),
        tuple(
            (
                profile.name,
                "can be played" if not broken else broken[0].removeprefix(f"{profile.name}: "),
            )
            for profile, broken in checks
        ),
        highlight=None if chain.device is None else profiles.index(chain.device),
        note=(
            "By the typical figures of each profile; a file of your own device replaces them"
            " (--device FILE). With --device only codes are searched that it can play."
        ),
    )
    return Section(
        "Code",
        (f"{code.chips} chips of {chip_ms:.4g} ms, 1 is open: {code.bits}",),
        (times, devices),
        (
            picture(
                code_strips(
                    {
                        _NAMES[shot.kind]: shot.way.code
                        for shot in chain.shots
                        if shot.kind != "open"
                    }
                ),
                "The exposures over time: yellow is open.",
                "the code and the best single exposure as strips of chips",
                name="code_strip",
            ),
        ),
    )


def _mtf(chain: Chain) -> Section:
    path = chain.estimate.best
    camera = chain.camera
    shots = [shot for shot in chain.shots if shot.kind != "coded" or chain.coded]
    certificates = dict(chain.certificates)
    below = {shot.kind: _below(path, shot, camera) for shot in shots}
    rows = tuple(
        (
            _NAMES[shot.kind],
            _bounds(certificates[shot.kind]),
            f"{100 * below[shot.kind]:.0f}",
        )
        for shot in shots
    )
    table = Table(
        ("exposure", "smallest MTF, proven", "band below the noise, %"),
        rows,
        highlight=shots.index(chain.advised_shot),
        note=(
            "Of all detail that the pixels could show, the share that is below the noise of this"
            " camera at this light; along the estimated motion, the worse direction where it is"
            " not known."
        ),
    )
    size = path.frame_size(PSF_PX)
    psfs = {_NAMES[shot.kind]: coded_psf(path, shot.way.code, size) for shot in shots}
    advised = chain.advised_shot.kind
    opened = below["open"]
    paragraphs = [
        (
            "The MTF says how much contrast the motion leaves to detail of each size. Where it"
            " dips below the noise the detail is lost, and no restoration brings it back."
        ),
        _dips(certificates[advised]),
    ]
    if advised != "open":
        paragraphs.append(
            f"The open shutter records {opened:.0%} of the band below the noise, the exposure"
            f" advised {below[advised]:.0%}."
        )
    return Section(
        "MTF",
        tuple(paragraphs),
        (table,),
        (
            picture(
                mtf_figure(path, {_NAMES[shot.kind]: shot.way.code for shot in shots}),
                "Above: along the motion's main axis. Below: the whole band, all maps on one"
                " scale.",
                "modulation transfer functions of the exposures",
                name="mtf",
            ),
            picture(
                psf_figure(psfs),
                "The motion as each exposure draws it.",
                "point spread functions of the exposures",
            ),
        ),
    )


def _below(path: Trajectory, shot: Shot, camera: Camera) -> float:
    ways = (path,) if path.direction == "known" else (path, path.reversed())
    return max(share_below_noise(way, shot.way.code, camera) for way in ways)


def _bounds(certificate: Certificate) -> str:
    if certificate.upper == 0:
        return "0"
    return f"{certificate.lower:.2g} to {certificate.upper:.2g}"


def _dips(certificate: Certificate) -> str:
    fx, fy = certificate.at
    where = (
        f"detail of {1 / max(np.hypot(fx, fy), 1e-9):.1f} px per period"
        if np.hypot(fx, fy) > 0
        else "no detail"
    )
    if certificate.upper < 1e-4:
        return (
            f"The MTF of the exposure advised touches zero, at {where} for one. Along a curved"
            " motion such zeros are single points of the band. Their number and width count: the"
            " table says what share they take."
        )
    return (
        f"The MTF of the exposure advised is nowhere in the band below {certificate.lower:.4f}"
        f" (proven), and lowest at {where}."
    )


# -- expected and simulated -----------------------------------------------------------------------


def _agreement(chain: Chain) -> Section:
    expected = _expected_db(chain)
    simulated = chain.gains_db()
    known = chain.gains_db(known=True)
    table = Table(
        ("exposure", "expected, dB", "simulated, dB", "simulated, true motion, dB"),
        tuple(
            (
                _NAMES[kind],
                _two(expected[kind]),
                _two(simulated[kind]),
                _two(known[kind]) if kind in known else None,
            )
            for kind in simulated
        ),
        highlight=list(simulated).index(chain.advised_shot.kind),
        note="Gain over the open shutter, restored.",
    )
    paragraphs = [_difference(chain)]
    if chain.problem.response is not None:
        paragraphs.append(
            "The expected gains count the time that the shutter takes to open and close; in the"
            " simulated photos it opens and closes at once."
        )
    return Section("Expected and simulated gain", tuple(paragraphs), (table,))


def _contrast(advice: Advice) -> Section:
    camera = advice.here.camera
    wrong = advice.choice not in ("strobe", "code")
    return Section(
        "Where coding is wrong" if wrong else "Another camera",
        (
            f"The same motion and exposure with another camera, {camera.name} ({camera.kind}).",
            advice.sentence,
            (
                "A code closes the shutter for part of the time and so loses light. That pays only"
                " where read noise, or a noise like it as that of compression, is large beside the"
                " noise of the light itself."
            ),
        ),
        (_gains_table(advice),),
        (
            picture(
                advice_figure(advice),
                "As above, for this camera.",
                f"gain over the light: {advice.sentence}",
            ),
        ),
    )


def _wiring(chain: Chain, guide: str) -> Section:
    assert chain.code is not None  # only where one is advised
    shortest = min(count for bit, count in chain.code.runs if bit) * chain.code.chip_ns * 1e-9
    return Section(
        "Shutter and wiring",
        (
            (
                f"The shutter must open for {duration(shortest)} at the shortest and close as"
                " fast; the table of the code lists devices that can."
            ),
            (
                "A liquid-crystal shutter before the lens (ferro-electric for chips below 1 ms),"
                " or an LED strobe in the dark, follows a TTL line. An Arduino Uno or Nano with"
                " the project's firmware plays the code on that line; chips below 50 us need a"
                " Raspberry Pi Pico. Keep a resistor of 10 kOhm from the line to ground: closed is"
                " low. The camera exposes for the whole time, and its trigger output starts the"
                " code."
            ),
            (
                "Cameras with several exposures in one frame (FLIR trigger mode 5, Sony Pregius"
                " burst) need no shutter: cep export --format camera writes the code as a list of"
                " widths and gaps."
            ),
            (
                "docs/hardware.md of the project lists devices to buy, the firmware, and how to"
                " check the edges with a logic analyser."
            ),
        ),
        links=(("docs/hardware.md", guide),) if guide else (),
    )


def _commands(chain: Chain, options: str) -> Section:
    count = chain.problem.chips
    whole_ns = chain.problem.chips * chain.problem.chip_ns
    exposure = f"{whole_ns}ns" if whole_ns % 1000 else f"{whole_ns // 1000}us"
    along = " ".join(
        filter(
            None,
            (
                "--trajectory motion/trajectory.json",
                f"--chips {count} --exposure {exposure}",
                options,
            ),
        )
    )
    commands = [f"cep calibrate {_calibration(chain)} -o motion", f"cep advise {along}"]
    kept = (
        "The folder of this page holds the blurred photo and the motion (trajectory.json, psf.npy,"
        " psf.mat)."
    )
    if chain.coded:
        refine = (
            f"cep calibrate blurred.png coded.png --code {'1' * count} --code code.json "
            "--trajectory motion/trajectory.json -o refined.json"
        )
        path = "motion/trajectory.json" if chain.found.codes else "refined.json"
        commands += [
            f"cep optimize {along} -o code.json",
            "cep upload code.json --port auto --arm",
            *([] if chain.found.codes else [refine]),
            f"cep deblur coded.png --trajectory {path} --code code.json -o sharp.png",
        ]
        kept += (
            " It also holds the code (code.json) and the shutter program (shutter_code.h, .csv and"
            " .json)."
        )
    elif chain.choice == "open":
        commands.append("cep deblur blurred.png --trajectory motion/trajectory.json -o sharp.png")
    else:
        commands.append("cep deblur shorter.png -o sharp.png")
    again = (
        "cep demo --photo FILE makes this page of a blurred photo of yours, --camera NAME of"
        " another camera."
    )
    return Section("With your own camera", (kept, again), commands=tuple(commands))


def _calibration(chain: Chain) -> str:
    """Photos and codes of the calibration, as on a command line."""
    if not chain.found.codes:
        return "blurred.png"
    codes = " ".join(
        f"--code {'open' if code.duty == 1 else code.bits}" for code in chain.found.codes
    )
    photos = " ".join(f"calibration_{i}.png" for i in range(2, len(chain.found.codes) + 1))
    return f"blurred.png {photos} {codes}"


def _two(value: float) -> str:
    return f"{value:+.2f}".replace("-", "−")


def _signed(value: float) -> str:
    return f"{value:+.1f}".replace("-", "−")


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:  # run from the source tree
        return "(not installed)"
