"""Files that pages send: streamed into the server's own folder under names of its own making."""

from __future__ import annotations

import secrets
import tempfile
from collections.abc import AsyncIterator, Callable, Mapping
from pathlib import Path

from cep.files.raw_files import RAW_SUFFIXES
from cep.studio.fields import FieldError, writing

_KEPT = 8  # photos; the oldest goes first
# by their first bytes, whatever the name says
_PHOTOS: Mapping[str, Callable[[bytes], bool]] = {
    ".jpg": lambda head: head.startswith(b"\xff\xd8\xff"),
    ".png": lambda head: head.startswith(b"\x89PNG\r\n\x1a\n"),
    ".tif": lambda head: head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"),
    ".webp": lambda head: head[:4] == b"RIFF" and head[8:12] == b"WEBP",
}
_HEAD = 16  # bytes that tell the formats apart


class Uploads:
    """Folder of a run's uploads, removed with :meth:`close`.

    A client names a file by the key that it was given, which is looked up and is no part of any
    path.
    """

    def __init__(self) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="cep-studio-")
        self._photos: dict[str, Path] = {}

    @property
    def folder(self) -> Path:
        """Where they are."""
        return Path(self._folder.name)

    async def photo(self, chunks: AsyncIterator[bytes], *, suffix: str = "") -> str:
        """Keep a photo and return its key; what is no photo, or breaks off, leaves nothing behind.

        Parameters
        ----------
        chunks : async iterator of bytes
        suffix : str
            Of the file's name where it is one of a RAW file: many begin as TIFF files do.
        """
        key = secrets.token_hex(16)
        partial = self.folder / f"{key}.part"
        try:
            with writing("photo"):
                head = await _streamed(chunks, partial)
            # RAW files have no head in common: their suffix is believed, and LibRaw finds out
            kinds = [ending for ending in RAW_SUFFIXES if ending == suffix.lower()]
            kinds += [ending for ending, is_kind in _PHOTOS.items() if is_kind(head)]
            if not kinds:
                raise FieldError(
                    "photo",
                    "a photo is a PNG, JPEG, TIFF, WebP or RAW file; this file is none of them",
                )
            self._photos[key] = partial.rename(self.folder / f"{key}{kinds[0]}")
        finally:
            partial.unlink(missing_ok=True)
        self._drop_oldest()
        return key

    async def text(self, chunks: AsyncIterator[bytes], suffix: str, *, field: str) -> Path:
        """Keep a text for as long as it is read; the caller removes it."""
        partial = self.folder / f"{secrets.token_hex(16)}{suffix}"
        try:
            with writing(field):
                await _streamed(chunks, partial)
        except BaseException:
            partial.unlink(missing_ok=True)
            raise
        return partial

    def add(self, content: bytes, suffix: str) -> str:
        """Keep a photo that the server made."""
        key = secrets.token_hex(16)
        file = self.folder / f"{key}{suffix}"
        try:
            with writing("photo"):
                file.write_bytes(content)
        except FieldError:
            file.unlink(missing_ok=True)
            raise
        self._photos[key] = file
        return key

    def reserve(self, suffix: str) -> tuple[str, Path]:
        """Return the key and the place of a photo that a job will make."""
        key = secrets.token_hex(16)
        self._photos[key] = self.folder / f"{key}{suffix}"
        self._drop_oldest()
        return key, self._photos[key]

    def path(self, key: object) -> Path:
        """Return the file of a key."""
        file = self._photos.get(str(key))
        if file is None or not file.is_file():
            raise FieldError("photo", "this photo is no longer here: drop it again")
        return file

    def close(self) -> None:
        """Remove everything."""
        self._folder.cleanup()

    def _drop_oldest(self) -> None:
        while len(self._photos) > _KEPT:
            oldest = self._photos.pop(next(iter(self._photos)))
            for file in self.folder.glob(f"{oldest.stem}*"):
                file.unlink(missing_ok=True)


async def _streamed(chunks: AsyncIterator[bytes], path: Path) -> bytes:
    head = b""
    with path.open("wb") as file:
        async for chunk in chunks:
            head = (head + chunk[:_HEAD])[:_HEAD]
            file.write(chunk)
    return head
