"""How many faults, put into random lines of the product, its quick tests notice.

    python -m lab.studies.mutations [--count 30] [--seed 1] [--workers 2]

In a clone of the last commit one operator of a line is exchanged (`<` and `>`, `+` and `-`, `and`
and `or`, ...), in one room after the other. The tests that mirror the module and its doctests are
run for each mutation; those that these do not notice are all put in together, and each is noticed
if a test that then fails in the whole quick suite of the product fails for it alone. A mutation
that changes nothing that matters counts as unnoticed; one with which tests take five times as
long as without counts as noticed. Ctrl-C ends the study with what is known by then.
"""

from __future__ import annotations

import ast
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
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
_WHOLE_S = 3600.0  # for the whole suite, and for tests without a mutation
_SLOWER = 5.0  # times as long as without it: a mutation that never ends is noticed
_LEAST_S = 60.0  # on a busy machine a start alone may take that long
UNFINISHED = frozenset({"timeout", "interrupted"})
"""In place of names of tests: they never ended, or could not begin."""
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
        assert first.end_lineno is not None
        assert first.end_col_offset is not None
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
    """Draw different mutations, one of a module of each room in turn; all of them where there are
    fewer.
    """
    rooms: dict[Path, list[list[Mutation]]] = {}
    for package in PRODUCT:
        for path in sorted((root / package).rglob("*.py")):
            module = path.relative_to(root)
            options = list(mutations_of(module, path.read_text(encoding="utf-8")))
            if options:
                rooms.setdefault(Path(*module.parent.parts[:2]), []).append(options)
    names = list(rooms)
    rng.shuffle(names)
    choices: list[Mutation] = []
    for name in cycle(names):
        if len(choices) == count or not any(rooms.values()):
            break
        if modules := rooms[name]:
            options = modules[number := int(rng.integers(len(modules)))]
            choices.append(options.pop(rng.integers(len(options))))
            if not options:
                del modules[number]
    return choices


def names_of_tests(root: Path, module: Path) -> list[str]:
    """Names of what tests a module: the tests that mirror it, and its doctests."""
    return [str(path) for path in (mirroring(root, module), module) if path is not None]


def mirroring(root: Path, module: Path) -> Path | None:
    """Test module that mirrors a module, or else the tests of its room; None without either."""
    folder = root / "tests" / module.parent
    path = folder / f"test_{module.stem.strip('_')}.py"
    if path.exists():
        return path.relative_to(root)
    return folder.relative_to(root) if folder.is_dir() and len(module.parts) > 2 else None


@dataclass(frozen=True)
class SuiteRun:
    """What became of some tests.

    Attributes
    ----------
    failed : tuple of str
        Names of those that failed, or of :data:`UNFINISHED`.
    wall_s : float
    """

    failed: tuple[str, ...]
    wall_s: float

    @property
    def finished(self) -> bool:
        """Whether all tests came to their end."""
        return not UNFINISHED & set(self.failed)

    @property
    def imported(self) -> bool:
        """Whether every module of tests could be imported; else pytest runs no test at all."""
        return all("::" in name for name in self.failed)

    @property
    def limit_s(self) -> float:
        """Longest time that the same tests get with a mutation."""
        return max(_LEAST_S, _SLOWER * self.wall_s)


class UnfinishedError(RuntimeError):
    """Tests did not come to their end, so that nothing can be said by them."""


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
        self._unmutated: dict[tuple[str, ...], SuiteRun] = {}

    def unmutated(self, tests: Sequence[str], *, workers: int = 1) -> SuiteRun:
        """Run tests without a mutation, once: some fail for what a machine lacks."""
        key = tuple(tests)
        if key not in self._unmutated:
            self._unmutated[key] = self.run([], tests, limit_s=_WHOLE_S, workers=workers)
        return self._unmutated[key]

    def run(
        self,
        mutations: Sequence[Mutation],
        tests: Sequence[str],
        *,
        limit_s: float,
        workers: int = 1,
        first: bool = False,
        without: Sequence[str] = (),
    ) -> SuiteRun:
        """Run tests with some mutations, to the first failure where asked; all but some."""
        options = ["-m", "not slow", "-q", "-rfE", "-p", "no:cacheprovider"]
        options += ["-n", str(workers), "--dist", "worksteal"] if workers > 1 else []
        options += ["-x"] if first else []
        options += [word for name in without for word in ("--deselect", name)]
        started_s = time.monotonic()
        with self._mutated(mutations):
            failed = self._failing([sys.executable, "-m", "pytest", *tests, *options], limit_s)
        return SuiteRun(failed, time.monotonic() - started_s)

    def _failing(self, command: Sequence[str], limit_s: float) -> tuple[str, ...]:
        process = subprocess.Popen(
            command,
            cwd=self.root,
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )
        with process:
            try:
                printed, _ = process.communicate(timeout=limit_s)
            except subprocess.TimeoutExpired:
                return ("timeout",)
            finally:  # with its workers and emulators, also after Ctrl-C
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
        names = re.findall(r"^(?:FAILED|ERROR) (\S+(?: \S+)*?)(?: - .*)?$", printed, re.M)
        # a module that cannot be imported stops pytest before it names a test
        return tuple(names or ([] if process.returncode in (0, 5) else ["interrupted"]))

    @contextmanager
    def _mutated(self, mutations: Sequence[Mutation]) -> Iterator[None]:
        paths = {self.root / mutation.module for mutation in mutations}
        originals = {path: path.read_bytes() for path in paths}
        try:
            # the last first: the offsets of the others stay true
            for mutation in sorted(mutations, key=lambda mutation: -mutation.start):
                path = self.root / mutation.module
                text = path.read_bytes()
                changed = mutation.after.encode()
                path.write_bytes(text[: mutation.start] + changed + text[mutation.stop :])
            yield
        finally:
            for path, text in originals.items():
                path.write_bytes(text)


def judged(
    workplace: Workplace, mutations: Sequence[Mutation], *, workers: int
) -> Iterator[tuple[Mutation, str]]:
    """Give each mutation with a test that notices it, or with none, as soon as it is known.

    Raises
    ------
    UnfinishedError
        If the whole suite does not come to its end; what is given by then is true.
    """
    doubtful = []
    for mutation in mutations:
        tests = names_of_tests(workplace.root, mutation.module)
        unmutated = workplace.unmutated(tests)
        failed: tuple[str, ...] = ()
        if unmutated.finished and unmutated.imported:
            failed = workplace.run(
                [mutation], tests, limit_s=unmutated.limit_s, first=True, without=unmutated.failed
            ).failed
        if failed:
            yield mutation, failed[0]
        else:
            print(f"{mutation}: not by {tests[0]}", flush=True)
            doubtful.append(mutation)
    if not doubtful:
        return
    suite = workplace.run(doubtful, [], limit_s=_WHOLE_S, workers=workers)
    if not suite.finished:
        raise UnfinishedError("the whole suite did not come to its end: fewer at once")
    by_fault: list[str] = []
    limit_s = _WHOLE_S
    if suite.failed:
        # some fail under load, or for what this machine lacks
        unmutated = workplace.unmutated(suite.failed, workers=workers)
        if not unmutated.finished:
            raise UnfinishedError("the failing tests did not come to their end without faults")
        limit_s = unmutated.limit_s * workers
        by_fault = [name for name in suite.failed if name not in unmutated.failed]
    for mutation in doubtful:
        failed = ()
        if by_fault:
            failed = workplace.run([mutation], by_fault, limit_s=limit_s, first=True).failed
        yield mutation, failed[0] if failed else ""


def tally(count: int, noticing: Mapping[Mutation, str]) -> str:
    """Say how many of so many mutations are noticed, as far as they are judged."""
    noticed = sum(map(bool, noticing.values()))
    missing = count - len(noticing)
    return f"{noticed} of {count} noticed" + (f", {missing} not judged" if missing else "")


@contextmanager
def cloned(repository: Path) -> Iterator[Path]:
    """Clone the last commit of a repository for as long as it is used."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder) / "clone"
        subprocess.run(["git", "clone", "--quiet", str(repository), str(root)], check=True)
        if (repository / _NODE_MODULES).is_dir():
            (root / _NODE_MODULES).symlink_to(repository / _NODE_MODULES)
        yield root


def main() -> None:
    parser = study_parser(__doc__)
    parser.add_argument("--count", type=int, default=30)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    noticing: dict[Mutation, str] = {}
    refusal = ""
    with cloned(Path(__file__).resolve().parents[2]) as root:
        mutations = drawn(root, options.count, np.random.default_rng(options.seed))
        try:
            for mutation, test in judged(Workplace(root), mutations, workers=options.workers):
                noticing[mutation] = test
                print(f"{mutation}: {test or 'not noticed'}", flush=True)
        except KeyboardInterrupt:
            refusal = "stopped"
        except UnfinishedError as error:
            refusal = f"error: {error}"
    print(f"\n{tally(len(mutations), noticing)}")
    if refusal:
        raise SystemExit(refusal)


if __name__ == "__main__":
    main()
