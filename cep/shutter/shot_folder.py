"""Folder of photos through codes: each is on the disk before the next, the first is restored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

from cep.files.shot_files import write_shot
from cep.restoration.restore import restore
from cep.restoration.result import Restoration
from cep.shutter.rig import Shot
from motdiff.files.outputs import claim_folder

_RESTORED = "restored.png"


class ShotFolder:
    """Photos that are written as they are taken.

    Parameters
    ----------
    folder : Path
        Made with the first photo, when missing.
    stems : sequence of str
        Names of the photos, without suffix, in order.
    force : bool
        Replace what is there.

    Attributes
    ----------
    shots : list of Shot
    files : list of Path
        Photos that are written, one for each shot.

    Raises
    ------
    ValueError
        If a file is there and ``force`` is not given, or the folder cannot be written.
    """

    def __init__(self, folder: Path, stems: Sequence[str], *, force: bool = False) -> None:
        names = [f"{stem}{suffix}" for stem in stems for suffix in (".tif", ".json")]
        claim_folder(folder, [*names, _RESTORED], force=force)
        self.folder = folder
        self.shots: list[Shot] = []
        self.files: list[Path] = []
        self._stems = stems
        self._force = force

    def keep(self, shot: Shot) -> None:
        """Write a photo; the last one once more where it turned out not to count."""
        self.folder.mkdir(parents=True, exist_ok=True)
        if self.shots and shot.frame is self.shots[-1].frame:
            write_shot(self.folder, self.files[-1].stem, shot.frame, shot.record, force=True)
            self.shots[-1] = shot
            return
        stem = self._stems[len(self.files)]
        self.files.append(
            write_shot(self.folder, stem, shot.frame, shot.record, force=self._force)
        )
        self.shots.append(shot)

    @property
    def counts(self) -> bool:
        """Whether all photos count: one that does not is the last."""
        return self.shots[-1].counts

    @property
    def headline(self) -> str:
        """What was taken, and whether it counts."""
        photos = f"{self.files[-1]}"
        if len(self.files) > 1:
            photos = f"{self.files[0]} to {self.files[-1].name}"
        return f"{photos}: {self.shots[-1].verdict if self.counts else 'the last does not count'}"

    @property
    def warnings(self) -> list[str]:
        """Of all photos, each once; none where one does not count, which is said instead."""
        if not self.counts:
            return []
        return [*dict.fromkeys(text for shot in self.shots for text in shot.warnings)]

    @property
    def restored(self) -> Path:
        """Path of the restored photo."""
        return self.folder / _RESTORED

    def restore(self, progress: Callable[[float, str], None]) -> None:
        """Write the first photo restored along its motion, whose warnings become the photo's.

        An error says that the photo was taken.
        """
        first = self.shots[0]
        try:
            sharp = restored_shot(first, progress)
            sharp.save(self.restored, bits=8 if first.record.bits <= 8 else 16)
        except BaseException as error:  # Ctrl-C as well: the photo is there
            error.add_note(f"{self.files[0]} was taken, and counts")
            raise
        self.shots[0] = replace(first, warnings=(*first.warnings, *sharp.warnings))

    def drop_others(self) -> None:
        """Remove what an earlier run left under names that this one did not need."""
        for stem in self._stems[len(self.files) :]:
            for suffix in (".tif", ".json"):
                (self.folder / f"{stem}{suffix}").unlink(missing_ok=True)
        self.drop_restored()

    def drop_restored(self) -> None:
        """Remove the restored photo of other photos, which these have replaced."""
        self.restored.unlink(missing_ok=True)


def restored_shot(shot: Shot, progress: Callable[[float, str], None]) -> Restoration:
    """Restore a photo along the motion of its record, darkened where its light would not fit."""
    record = shot.record
    sharp = restore(
        shot.light,
        code=record.code,
        trajectory=record.trajectory,
        camera=record.noise,
        progress=progress,
    )
    return sharp.below_white()
