"""File of a proof in blocks: a header, then a line for each finished block.

The file is both the state of an unfinished proof and the proof itself. Format:
docs/proofs/README.md.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from lab.block_proofs.blocks import VERSION, BlockPlan
from motdiff.files.json_files import fault, load_schema
from motdiff.files.outputs import naming

SCHEMA = "cep.proof/1"
FILE_NAME = "proof.jsonl"


class ProofFile:
    """Records of a proof on disk; opened by one run at a time, see :meth:`open`."""

    def __init__(self, path: Path, plan: BlockPlan) -> None:
        self.path = path
        self.plan = plan
        self.records: dict[int, dict[str, Any]] = {}
        self._number = {block.first: index for index, block in enumerate(plan.blocks)}

    @classmethod
    @contextmanager
    def open(cls, folder: Path | str, plan: BlockPlan) -> Iterator[ProofFile]:
        """Open the proof in a folder, made where it is missing, and hold it until the end.

        A last line that was cut short, as by a lost power supply, is dropped: its block is judged
        again. The file is written with its first block: a proof that judged none leaves nothing.

        Raises
        ------
        ValueError
            If the folder is a file, another run holds it, or the file is of another problem or
            version, or damaged; it stays as it is.
        OSError
            If it cannot be written.
        """
        folder = Path(folder)
        path = folder / FILE_NAME
        if folder.exists() and not folder.is_dir():
            raise ValueError(f"{folder}: is a file, a folder for the proof is needed")
        is_new = not folder.exists()
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder), _removed_if(is_new, folder):
            proof = cls(path, plan)
            if path.exists() and path.stat().st_size:
                records, whole_bytes = _read(path, plan)
                for line, record in enumerate(records, 2):
                    try:
                        proof._add(record)
                    except ValueError as error:
                        raise ValueError(
                            f"{path}: line {line}: {error}; give another folder"
                        ) from None
                with path.open("r+b") as stream:
                    stream.truncate(whole_bytes)
            yield proof

    @property
    def missing(self) -> list[int]:
        """Numbers of blocks without a record."""
        return [index for index in range(len(self.plan.blocks)) if index not in self.records]

    def keep(self, record: Mapping[str, Any]) -> None:
        """Append a record.

        Raises
        ------
        ValueError
            If it does not add up, or its block has one already.
        OSError
            If the file cannot be written to; it is named.
        """
        self._add(record)
        lines = _line(record)
        if not self.path.exists() or not self.path.stat().st_size:
            lines = _line(_header(self.plan)) + lines
        # the error of a full disk does not name the file
        with naming({}, self.path), self.path.open("ab") as stream:
            stream.write(lines)
            stream.flush()
            os.fsync(stream.fileno())  # a block may have taken hours

    def _add(self, record: Mapping[str, Any]) -> None:
        """Add a record that is on disk, or will be."""
        schema = load_schema("lab.block_proofs", "proof")["$defs"]["record"]
        if (reason := fault(dict(record), schema)) is not None:
            raise ValueError(reason)
        first = record["first"]
        until = record["until"]
        index = self._number.get(first, -1)
        if index < 0 or until != self.plan.blocks[index].until:
            raise ValueError(f"there is no block of prefixes {first} to {until}")
        if index in self.records:
            raise ValueError(f"the block of prefixes {first} to {until} comes twice")
        codes = self.plan.blocks[index].codes
        if record["codes"] != codes:
            raise ValueError(
                f"the block does not add up: {record['codes']} codes instead of {codes}"
            )
        if len(record["survivors"].split()) != len(record["minima"].split()):
            raise ValueError("the block does not add up: as many minima as survivors are needed")
        self.records[index] = dict(record)


def _header(plan: BlockPlan) -> dict[str, Any]:
    return {"schema": SCHEMA, "version": VERSION, **plan.header()}


def _line(record: Mapping[str, Any]) -> bytes:
    return json.dumps(record).encode() + b"\n"


def _read(path: Path, plan: BlockPlan) -> tuple[list[dict[str, Any]], int]:
    """Read the records of a plan's proof, and the length of the file's whole lines in bytes."""
    content = path.read_bytes()
    if _line(_header(plan)).startswith(content):
        return [], 0  # cut short before its first block was whole
    whole_bytes = content.rfind(b"\n") + 1
    lines = []
    for number, line in enumerate(content[:whole_bytes].splitlines(), 1):
        try:
            lines.append(json.loads(line))
            if not isinstance(lines[-1], dict):
                raise ValueError
        except (ValueError, RecursionError):
            raise ValueError(
                f"{path}: line {number} is damaged; give another folder, or delete that line"
            ) from None
    header = lines[0] if lines else {}
    if header.get("schema") != SCHEMA:
        raise ValueError(f"{path}: is no proof ({SCHEMA}); give another folder")
    if header.get("version") != VERSION:
        raise ValueError(
            f"{path}: a proof of version {header.get('version')}, not {VERSION}; give another"
            " folder"
        )
    if {key: header.get(key) for key in plan.header()} != plan.header():
        stored = (
            f"{header.get('chips')} chips, {header.get('fewest_open')} to"
            f" {header.get('most_open')} open"
        )
        request = f"{plan.chips} chips, {plan.fewest} to {plan.most} open"
        raise ValueError(f"{path}: a proof for {stored}, not for {request}; give another folder")
    return lines[1:], whole_bytes


@contextmanager
def _removed_if(is_new: bool, folder: Path) -> Iterator[None]:
    """Remove a folder at the end if it was made here and is empty."""
    try:
        yield
    finally:
        if is_new:
            with suppress(OSError):  # it holds a proof
                folder.rmdir()


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Refuse a second run on the same folder; a run that is killed frees it."""
    try:
        import fcntl
    except ImportError:  # Windows
        yield
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise ValueError(
                f"{folder}: another run works on this proof; give another folder, or wait"
            ) from None
        yield
    finally:
        os.close(handle)
