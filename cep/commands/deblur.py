"""``cep deblur``: restore a photo along a trajectory, with a PSF, or from the photo alone.

Several photos of one scene and motion, each through its own code, are restored together.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.commands.console import Page, Tick, finish, part, progress
from cep.commands.errors import with_photo_file
from cep.commands.options import (
    MOTION,
    CameraOptions,
    CommonOptions,
    Gamma,
    MotionOptions,
    argument,
    command,
    flag,
    option,
    output_option,
)
from cep.restoration.registry import AUTO_ABOUT, METHODS, find_method

if TYPE_CHECKING:
    from collections.abc import Sequence

    from cep.files.images import Photo
    from cep.files.shot_files import ShotRecord
    from cep.optics.code import ShutterCode
    from cep.restoration.result import Restoration

_WITH_CAMERA = [method.name for method in METHODS.values() if method.uses_camera]


@dataclass(frozen=True, kw_only=True)
class DeblurOptions(MotionOptions, CameraOptions, CommonOptions):
    """Options of ``cep deblur``."""

    images: list[Path] = argument(
        "IMAGE...",
        "Blurred photo, coded or not: PNG, TIFF, JPEG, WebP or RAW; or several of one"
        " scene and motion, each through its own code.",
    )
    codes: list[str] | None = option(
        "--code",
        "CODE",
        "Code of the exposure: bits, code.json or a name; the open shutter when omitted;"
        " complement:CODE is open where CODE is closed. Of several photos once for each, in"
        " order.",
        panel=MOTION,
    )
    psf: Path | None = option(
        "--psf",
        "FILE",
        "Instead of --trajectory, --linear and --code: a PSF as .npy, .mat or .png.",
        panel=MOTION,
    )
    method: str = option(
        "--method",
        "NAME",
        ", ".join(f"{method.name} ({method.about})" for method in METHODS.values())
        + f", or module:name; auto is {AUTO_ABOUT}.",
        "auto",
    )
    anyway: bool = flag(
        "--anyway", "Of a photo alone: restore it even where it would be kept as it is."
    )
    gamma: Gamma = "srgb"
    output: Path | None = output_option("Restored photo; IMAGE_sharp.png when omitted.")

    @property
    def image(self) -> Path:
        """The photo, or the first of several."""
        return self.images[0]

    @property
    def target(self) -> Path:
        """File of the restored photo."""
        return self.output or self.image.with_name(f"{self.image.stem}_sharp.png")

    @property
    def is_blind(self) -> bool:
        """Whether neither motion nor PSF is given."""
        return not self.has_motion and self.psf is None

    @property
    def is_photo_alone(self) -> bool:
        """Whether what suits the photo is to be chosen, since nothing is said of it."""
        is_plain = not self.codes and not self.has_camera
        return self.method == "auto" and self.is_blind and is_plain

    def check(self) -> None:
        """Refuse options that contradict each other, and unknown methods."""
        if self.method != "auto":
            find_method(self.method)
        if sum(source is not None for source in (self.trajectory, self.linear, self.psf)) > 1:
            raise ValueError(
                "--trajectory FILE, --linear PX and --psf FILE: give one of them at most"
            )
        if self.psf is not None and self.codes:
            raise ValueError("--code: not valid with --psf, whose file already holds the code")
        if len(self.images) > 1:
            if self.psf is not None:
                raise ValueError("--psf: not valid with several photos; give the --code of each")
            if self.method not in ("auto", "pnp"):
                raise ValueError(
                    f"--method: several photos are restored by pnp, not by {self.method}"
                )
        elif self.codes and len(self.codes) > 1:
            raise ValueError(
                f"--code: needs one for each photo, got {len(self.codes)} for 1 photo"
            )
        if self.anyway and not (self.is_photo_alone and len(self.images) == 1):
            raise ValueError(
                "--anyway: not valid here: only a photo that is given alone, without a motion,"
                " PSF, code, camera or method, may be kept as it is"
            )
        if self.method not in ("auto", *_WITH_CAMERA):
            *names, last = _WITH_CAMERA
            for name in ("camera", "photons", "read_noise"):
                if getattr(self, name) is not None:
                    raise ValueError(
                        f"--{name.replace('_', '-')}: not valid with --method {self.method};"
                        f" {', '.join(names)} and {last} use the camera"
                    )


@command(DeblurOptions)
def deblur(options: DeblurOptions) -> None:
    """Restore a photo along a trajectory, with a PSF, or from itself alone.

    Of an ordinary photo alone the blur is estimated, and the photo restored with what suits it; a
    photo without motion blur, or one that no restoration improves, is written as it was, and the
    first line says so; --anyway restores it all the same.

    Along a trajectory of unknown direction the orders in time that it may have had are tested, and
    it is said which fits: forward, reverse, or reordered where loops were run the other way round.
    --linear is a straight and uniform motion along the rows. A single photo without a trajectory
    shows its PSF, but seldom the order in time; give --code for its light.

    The camera's figures are for the methods wiener and pnp.

    A photo of cep shoot brings its code, motion and code values along, in the .json beside it; an
    option replaces the file's.

    Several photos of one scene and one motion, as of two cameras in one exposure, are restored
    together, each with its --code; the motion, which need not repeat, is found in them. A code and
    its complement show the motion of a hand.

    Example: cep deblur photo.jpg

    Example: cep deblur photo.jpg --anyway -o tried.png

    Example: cep deblur shot/photo.tif

    Example: cep deblur coded.png --trajectory trajectory.json --code code.json -o sharp.png

    Example: cep deblur coded.png --linear 40 --code code.json -o sharp.png

    Example: cep deblur coded.png --code code.json -o sharp.png

    Example: cep deblur a.png b.png --code raskar-52 --code complement:raskar-52 -o sharp.png
    """
    images = options.images
    with progress("restoring") as tick:
        tick(0.0, "reading the photos" if len(images) > 1 else "reading the photo")
        from cep.codes.sources import load_codes
        from cep.files.images import check_image_name, parse_gamma, read_photo
        from cep.files.shot_files import read_shot, record_beside
        from motdiff.files.outputs import claim

        options.check()
        parse_gamma(options.gamma)
        codes = load_codes(options.codes or [])
        check_image_name(options.target)
        outputs = claim([options.target], force=options.force, inputs=images)
        records = [record_beside(image) for image in images]
        photos = [
            read_photo(image, gamma=options.gamma) if record is None else read_shot(image, record)
            for image, record in zip(images, records, strict=True)
        ]
        warnings = [line for photo in photos for line in photo.warnings]
        warnings += [
            f"{image}: does not count: {problem}"
            for image, record in zip(images, records, strict=True)
            if record is not None
            for problem in record.problems
        ]
        try:
            if len(images) > 1:
                restored = _restored_together(options, photos, records, codes, tick)
            else:
                restored = _restored(options, photos[0], records[0], codes, tick)
        except ValueError as error:
            raise ValueError(with_photo_file(str(error), images)) from None
        if any(record is not None for record in records) or len(images) > 1:
            restored = restored.below_white()
        with outputs.written() as folder:
            restored.save(folder[options.target], bits=photos[0].bits, gamma=options.gamma)
        tick(1.0)
    result: dict[str, object] = {
        "image": options.target,
        **restored.to_dict(),
        "seed": options.seed,
        "warnings": [*warnings, *restored.warnings],
    }
    if len(images) > 1:
        result = {"images": images, **result}
    finish(result, _page(restored, options), as_json=options.as_json)


def _restored(
    options: DeblurOptions,
    photo: Photo,
    record: ShotRecord | None,
    codes: Sequence[ShutterCode],
    tick: Tick,
) -> Restoration:
    """Restore a single photo with what the options and its record say of it."""
    from cep.calibration.photo_checks import check_photos, check_texture
    from cep.files.psf_files import load_psf
    from cep.files.raw_files import RAW_SUFFIXES
    from cep.optics.path_limits import check_resolved
    from cep.restoration.choice import looks_linear
    from cep.restoration.restore import restore

    code = codes[0] if codes else None
    inputs: dict[str, Any] = {}
    doubts: tuple[str, ...] = ()
    if options.has_camera:
        inputs["camera"] = options.load_camera()
    if options.has_motion:
        inputs["trajectory"] = options.load_motion().trajectory
        if code is not None:
            check_resolved(inputs["trajectory"], code.chips)
    if options.psf is not None:
        inputs["psf"], doubts = load_psf(options.psf)
    if record is not None:
        if options.psf is None:
            code = code or record.code
            if not options.has_motion and record.trajectory is not None:
                inputs["trajectory"] = record.trajectory
        if record.noise is not None and options.method in ("auto", *_WITH_CAMERA):
            inputs.setdefault("camera", record.noise)
    is_blind = not inputs.keys() & {"trajectory", "psf"}
    if is_blind:
        is_alone = options.is_photo_alone and record is None
        check_photos([photo.pixels], "motdiff" if is_alone else "pmp")
    else:
        check_texture(photo.pixels)
    tick(0.05, "searching the PSF" if is_blind else "restoring")
    restored = restore(
        photo.pixels,
        code=code,
        method=options.method,
        anyway=options.anyway,
        seed=options.seed,
        progress=part(tick, 0.05, 0.98),
        **inputs,
    )
    # a floating-point or RAW file is linear whatever is said of it; a PSF that was found in the
    # photo fits the curve on which it was searched
    is_curved = photo.bits < 32 and options.image.suffix.lower() not in RAW_SUFFIXES
    may_be_linear = record is None and is_curved and options.gamma == "srgb" and not is_blind
    if may_be_linear and looks_linear(photo.pixels, restored.psf):
        doubts += (
            f"{options.image}: the motion fits better if its code values are light and not on the"
            " sRGB curve: if it is a linear file, give --gamma linear",
        )
    return replace(restored, warnings=(*doubts, *restored.warnings))


def _restored_together(
    options: DeblurOptions,
    photos: Sequence[Photo],
    records: Sequence[ShotRecord | None],
    codes: Sequence[ShutterCode],
    tick: Tick,
) -> Restoration:
    """Restore one scene from several photos of one motion, each through its own code."""
    from cep.calibration.photo_checks import check_photos, check_times
    from cep.files.shot_files import stated_motion
    from cep.optics.path_limits import check_resolved
    from cep.restoration.together import restore_together

    codes = codes or [record.code for record in records if record is not None]
    if len(codes) != len(photos):
        raise ValueError(
            f"--code: needs one for each photo, got {len(codes)} for {len(photos)} photos"
        )
    check_times(codes)
    cameras = [None if record is None else record.noise for record in records]
    if options.has_camera:
        cameras = [options.load_camera()] * len(photos)
    trajectory = stated_motion(options.images, records)
    if options.has_motion:
        trajectory = options.load_motion().trajectory
    if trajectory is not None:
        check_resolved(trajectory, codes[0].chips)
    pixels = [photo.pixels for photo in photos]
    check_photos(pixels, "coded")
    return restore_together(
        pixels,
        codes,
        trajectory,
        cameras=cameras,
        seed=options.seed,
        progress=part(tick, 0.02, 0.98),
    )


def _page(restored: Restoration, options: DeblurOptions) -> Page:
    """Say how the photo was restored, what it leaves unexplained, and how wide its border is."""
    target = options.target
    if restored.kept:
        return [f"{restored.summary}; --anyway restores it all the same.", f"{target}"]
    figures = (
        f"residual {restored.residual:.3g} of full scale; the outer {restored.unreliable_px} px"
        " lean on a guess"
    )
    if restored.summary:
        return [f"{restored.summary}.", f"{target}; {figures}"]
    confidence = restored.psf_confidence
    reason = restored.method_reason and f" ({restored.method_reason})"
    if len(options.images) > 1:
        motion = f"along the given motion, direction {restored.direction}"
        if confidence is not None:
            motion = (
                f"along the motion found in them, which is right with probability {confidence:.2f}"
            )
        about = f"restored from {len(options.images)} photos together, {motion};"
    elif restored.psf_source == "photo":
        about = (
            "restored with the PSF found in this photo alone, which is good with probability"
            f" {confidence:.2f}; its order in time is not known; {restored.method}{reason},"
        )
    else:
        about = f"{restored.method}{reason}, direction {restored.to_dict()['direction']}"
        if restored.direction_test is not None:
            about += f" (confidence {restored.direction_test.confidence:.2f})"
        about += ","
    return [f"{target}: {about} {figures}"]
