"""How many faults, put into random lines of the product, its quick tests notice.

    python -m lab.studies.mutations [--count 30] [--seed 1] [--workers 2]

In a clone of the last commit one operator of a line is exchanged (`<` and `>`, `+` and `-`, `and`
and `or`, ...), in one room after the other. The tests that mirror the module and its doctests are
run for each mutation; those that these do not notice are all put in together, and each is noticed
if a test that then fails in the whole quick suite of the product fails for it alone. A mutation
that changes nothing that matters counts as unnoticed.
"""

from __future__ import annotations

import argparse
import ast
import os
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import cycle
from pathlib import Path

import numpy as np

from lab.studies.inputs import study_parser

PRODUCT = ("cep", "motdiff", "hw")
EXCHANGED = {
    "<": ">",
    "<=": ">",
    ">": "<",
    ">=": "<",
    "==": "!=",
    "!=": "==",
    "is": "is not",
    "is not": "is",
    "in": "not in",
    "not in": "in",
    "and": "or",
    "or": "and",
    "+": "-",
    "-": "+",
    "*": "/",
    "/": "*",
    "//": "*",
    "**": "*",
}
_OPERATOR = re.compile(r"<<|>>|not\s+in|is\s+not|\b(?:is|in|and|or)\b|[<>=!]=|//|\*\*|[-+*/<>]")
_LONGEST_S = 3600.0  # a mutation that never ends is noticed
# what git ignores, and tests of the emulators' boards are skipped without
_NODE_MODULES = Path("tests/emulators/node/node_modules")


@dataclass(frozen=True)
class Mutation:
    """Operator of a module's text, between two offsets, and what replaces it."""

    module: Path
    line: int
    start: int
    stop: int
    before: str
    after: str

    def __str__(self) -> str:
        return f"{self.module}:{self.line}: {self.before} -> {self.after}"


def mutations_of(module: Path, text: str) -> Iterator[Mutation]:
    """Every operator between two operands, but those of annotations and formatted strings."""
    tree = ast.parse(text)
    starts = np.cumsum([0, *(len(line.encode()) for line in text.splitlines(keepends=True))])
    data = text.encode()
    formatted = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.JoinedStr)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in formatted:
            continue
        match node:
            case ast.Compare(left=first, comparators=[second]):
                pass
            case ast.BoolOp(values=[first, second, *_]) | ast.BinOp(left=first, right=second):
                pass
            case _:
                continue
        gap = int(starts[first.end_lineno - 1] + first.end_col_offset)
        end = int(starts[second.lineno - 1] + second.col_offset)
        token = _OPERATOR.search(data[gap:end].decode())
        if token is None:
            continue
        operator = " ".join(token[0].split())
        if operator in EXCHANGED:
            line = int(np.searchsorted(starts, gap, side="right"))
            yield Mutation(
                module,
                line,
                gap + token.start(),
                gap + token.end(),
                operator,
                EXCHANGED[operator],
            )


def drawn(root: Path, count: int, rng: np.random.Generator) -> list[Mutation]:
    """Draw mutations, one of a module of each room in turn."""
    rooms: dict[Path, list[list[Mutation]]] = {}
    for package in PRODUCT:
        for path in sorted((root / package).rglob("*.py")):
            module = path.relative_to(root)
            options = list(mutations_of(module, path.read_text(encoding="utf-8")))
            if options:
                rooms.setdefault(Path(*module.parent.parts[:2]), []).append(options)
    names = list(rooms)
    rng.shuffle(names)
    choices = []
    for name, _ in zip(cycle(names), range(count), strict=False):
        options = rooms[name][rng.integers(len(rooms[name]))]
        choices.append(options[rng.integers(len(options))])
    return choices


def mirroring(root: Path, module: Path) -> Path | None:
    """Test module that mirrors a module, or else the tests of its room; None without either."""
    folder = root / "tests" / module.parent
    path = folder / f"test_{module.stem.strip('_')}.py"
    if path.exists():
        return path.relative_to(root)
    return folder.relative_to(root) if folder.is_dir() and len(module.parts) > 2 else None


class Workplace:
    """Clone of the repository in which tests are run on mutated modules."""

    def __init__(self, root: Path) -> None:
        self.root = root
        # subprocesses of tests import the mutated modules as well
        self._environment = {
            **os.environ,
            "PYTHONPATH": str(root),
            "PYTHONDONTWRITEBYTECODE": "1",
            "OMP_NUM_THREADS": "1",
        }

    def failing(
        self,
        mutations: Sequence[Mutation],
        tests: Sequence[str],
        *,
        workers: int = 1,
        first: bool = False,
    ) -> list[str]:
        """Names of tests that fail with some mutations; "timeout" where they never end."""
        originals = {mutation.module: self._text(mutation.module) for mutation in mutations}
        for mutation in sorted(mutations, key=lambda mutation: -mutation.start):
            text = self._text(mutation.module)
            changed = text[: mutation.start] + mutation.after.encode() + text[mutation.stop :]
            (self.root / mutation.module).write_bytes(changed)
        options = ["-n", str(workers), "--dist", "worksteal"] if workers > 1 else []
        command = [
            sys.executable,
            "-m",
            "pytest",
            *tests,
            *options,
            "-m",
            "not slow",
            "-q",
            "-rfE",
        ]
        if first:
            command.append("-x")
        try:
            run = subprocess.run(
                [*command, "-p", "no:cacheprovider"],
                cwd=self.root,
                env=self._environment,
                capture_output=True,
                text=True,
                timeout=_LONGEST_S,
            )
        except subprocess.TimeoutExpired:
            return ["timeout"]
        finally:
            for module, text in originals.items():
                (self.root / module).write_bytes(text)
        names = re.findall(r"^(?:FAILED|ERROR) (\S+(?: \S+)*?)(?: - .*)?$", run.stdout, re.M)
        # a module that cannot be imported stops pytest before it names a test
        return names or ([] if run.returncode in (0, 5) else ["interrupted"])

    def _text(self, module: Path) -> bytes:
        return (self.root / module).read_bytes()


def main() -> None:
    parser: argparse.ArgumentParser = study_parser(__doc__)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    repository = Path(__file__).resolve().parents[2]
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "clone"
        subprocess.run(["git", "clone", "--quiet", str(repository), str(root)], check=True)
        if (repository / _NODE_MODULES).is_dir():
            (root / _NODE_MODULES).symlink_to(repository / _NODE_MODULES)
        workplace = Workplace(root)
        mutations = drawn(root, options.count, np.random.default_rng(options.seed))
        doubtful = []
        for mutation in mutations:
            tests = mirroring(root, mutation.module)
            failed = workplace.failing(
                [mutation],
                list(map(str, filter(None, [tests, mutation.module]))),  # its doctests too
                first=True,
            )
            print(f"{mutation}: {failed[0] if failed else f'not by {tests}'}", flush=True)
            if not failed:
                doubtful.append(mutation)
        noticed = len(mutations) - len(doubtful)
        print(f"\n{noticed} of {len(mutations)} noticed by the tests that mirror them", flush=True)
        failed = workplace.failing(doubtful, [], workers=options.workers) if doubtful else []
        if {"timeout", "interrupted"} & set(failed):
            raise SystemExit("error: the whole suite did not come to its end: fewer at once")
        # some fail under load, or for what this machine lacks
        anyway = set(workplace.failing([], failed, workers=options.workers)) if failed else set()
        if {"timeout", "interrupted"} & anyway:
            raise SystemExit("error: the failing tests did not come to their end without faults")
        by_fault = [name for name in failed if name not in anyway]
        for mutation in doubtful:
            own_failed = workplace.failing([mutation], by_fault, first=True) if by_fault else []
            noticed += bool(own_failed)
            print(f"{mutation}: {own_failed[0] if own_failed else 'not noticed'}", flush=True)
    print(f"\n{noticed} of {len(mutations)} noticed")


if __name__ == "__main__":
    main()
