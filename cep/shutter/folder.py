"""Camera by a folder: the next photo that another program saves there."""

from __future__ import annotations

import time
from contextlib import suppress
from pathlib import Path
from typing import ClassVar, Self

from cep.files.images import PHOTO_SUFFIXES, read_code_values
from cep.files.raw_files import RAW_SUFFIXES, read_raw
from cep.files.white_level import white_level
from cep.shutter.cameras import path_and_settings
from hw.cameras.camera import Camera, CameraError, CameraSettings, Frame, FrameLostError, Trigger

_LOOK_S = 0.05
_QUIET_S = 0.25  # a file that did not grow for so long may be whole
_GAMMAS = ("srgb", "linear")


class FolderCamera(Camera):
    """Photos that any other program saves in a folder.

    Of a RAW file and a picture of the same name the one that comes first is taken, and the other
    passed over.

    Parameters
    ----------
    folder : Path
    gamma : {"srgb", "linear"}
        Curve of pictures; RAW files are linear.
    """

    name: ClassVar[str] = "folder"
    summary: ClassVar[str] = (
        "folder:PATH, the next photo that another program saves there; #gamma=linear for frames"
    )
    triggers: ClassVar[frozenset[Trigger]] = frozenset({Trigger.LINE})

    def __init__(self, folder: Path, gamma: str) -> None:
        self.folder = folder
        self.gamma = gamma
        self._stems: set[str] = set()
        self._frames = 0

    @classmethod
    def open(cls, address: str) -> Self:
        """Watch a folder, as ``PATH`` or ``PATH#gamma=linear``."""
        folder, settings = path_and_settings(address, gamma="srgb")
        if settings["gamma"] not in _GAMMAS:
            raise ValueError(
                f"camera: gamma must be srgb or linear, got {settings['gamma'][:40]!r}"
            )
        if not folder.is_dir():
            raise ValueError(f"camera: {folder} is no folder")
        camera = cls(folder, settings["gamma"])
        camera._stems = {path.stem for path in camera._photos()}
        return camera

    def configure(self, settings: CameraSettings) -> CameraSettings:
        """Return the settings, which are those that the other program has to be given."""
        return settings

    def arm(self) -> None:
        """Pass over the photos that are there."""
        self._stems |= {path.stem for path in self._photos()}

    def wait_ready(self, timeout_s: float) -> None:
        """Return at once: the other program arms the camera."""

    def fire(self) -> None:
        """Refuse: only the other program can."""
        raise CameraError("folder: another program takes the photo, this computer cannot")

    def read(self, timeout_s: float) -> Frame:
        """Wait for the next whole photo."""
        deadline = time.monotonic() + timeout_s
        sizes: dict[Path, tuple[int, float]] = {}
        reason = "no photo was saved there"
        while True:
            for path in self._photos():
                if path.stem in self._stems:
                    continue
                reason = f"{path.name} is not whole"
                now_s = time.monotonic()
                try:
                    size = path.stat().st_size
                except FileNotFoundError:
                    continue
                if sizes.get(path, (-1, 0.0))[0] != size:
                    sizes[path] = (size, now_s)
                if size and now_s - sizes[path][1] >= min(_QUIET_S, timeout_s):
                    try:
                        return self._frame(path)
                    except (OSError, ValueError) as error:
                        reason = str(error)
            if time.monotonic() >= deadline:
                raise FrameLostError(f"{self.folder}: no photo within {timeout_s:g} s: {reason}")
            time.sleep(_LOOK_S)

    def close(self) -> None:
        """Do nothing: nothing is held."""

    def _photos(self) -> list[Path]:
        """Photos of the folder, the earliest first."""
        times_ns: dict[Path, int] = {}
        try:
            for path in self.folder.iterdir():
                if path.suffix.lower() not in PHOTO_SUFFIXES or path.name.startswith("."):
                    continue
                with suppress(FileNotFoundError):  # its program renames it once it is whole
                    if path.is_file():
                        times_ns[path] = path.stat().st_mtime_ns
        except OSError as error:
            raise CameraError(f"{self.folder}: cannot be read: {error.strerror}") from None
        return sorted(times_ns, key=times_ns.__getitem__)

    def _frame(self, path: Path) -> Frame:
        is_raw = path.suffix.lower() in RAW_SUFFIXES
        values = read_raw(path) if is_raw else read_code_values(path)[0]
        bits = 16 if is_raw else int(white_level(values).code).bit_length()
        self._stems.add(path.stem)
        self._frames += 1
        return Frame(
            values=values,
            bits=bits,
            frame_id=self._frames,
            camera=path.name,
            gamma="linear" if is_raw else self.gamma,
        )
