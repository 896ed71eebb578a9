"""Faults of a file system, put into the Python process: a disk that is full from some write on, a
rename that fails."""

import builtins
import errno
import io
import os
from contextlib import contextmanager


class _FullFile:
    """A file that takes half of what is written to it."""

    def __init__(self, file):
        self._file = file

    def write(self, data):
        self._file.write(data[: len(data) // 2])
        self._file.flush()
        raise OSError(errno.ENOSPC, "No space left on device")

    def __getattr__(self, name):
        return getattr(self._file, name)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._file.close()


@contextmanager
def full_disk(monkeypatch, *, writes=None):
    """Let the disk take ``writes`` files and folders and nothing more; yields a list that counts
    them."""
    counted = []
    open_ = io.open
    mkdir = os.mkdir

    def counted_open(file, mode="r", *arguments, **options):
        opened = open_(file, mode, *arguments, **options)
        if not set(mode) & set("wxa+"):
            return opened
        counted.append(str(file))
        return opened if writes is None or len(counted) <= writes else _FullFile(opened)

    def counted_mkdir(path, *arguments, **options):
        counted.append(str(path))
        if writes is not None and len(counted) > writes:
            raise OSError(errno.ENOSPC, "No space left on device", str(path))
        mkdir(path, *arguments, **options)

    with monkeypatch.context() as patch:
        patch.setattr(io, "open", counted_open)
        patch.setattr(builtins, "open", counted_open)
        patch.setattr(os, "mkdir", counted_mkdir)
        yield counted


@contextmanager
def failing_rename(monkeypatch, *, number=None, links=True):
    """Let one rename fail, the one of that number; yields a list that counts them.

    ``links`` is whether the file system has hard links.
    """
    counted = []
    replace = os.replace

    def counted_replace(source, target, **options):
        counted.append(str(target))
        if len(counted) - 1 == number:
            raise OSError(errno.EIO, "Input/output error", str(source))
        replace(source, target, **options)

    def no_link(source, target, **_options):
        raise OSError(errno.EPERM, "Operation not permitted", str(source))

    with monkeypatch.context() as patch:
        patch.setattr(os, "replace", counted_replace)
        patch.setattr(os, "rename", counted_replace)
        if not links:
            patch.setattr(os, "link", no_link)
        yield counted
