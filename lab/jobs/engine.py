"""Run of cells in this process, in worker processes or on a Dask cluster; finished cells are
cached at once.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from lab.jobs.cache import Cache
from lab.jobs.cells import Cell, Figure, Finished, Result, fingerprints, pinned, worked
from lab.jobs.executors import Tasks, in_processes, on_cluster
from lab.jobs.machine import machine
from motdiff.progress import in_words


@dataclass(frozen=True)
class Outcome:
    """Results of a run.

    Attributes
    ----------
    results : tuple of Result
        In the order of the cells, without those that were not reached.
    missing : int
        Cells that were not reached, after Ctrl-C.
    warnings : tuple of str
    """

    results: tuple[Result, ...]
    missing: int
    warnings: tuple[str, ...]

    @property
    def figures(self) -> dict[tuple[str, ...], Mapping[str, Figure]]:
        """Figures by name of the cell, empty for failed cells."""
        return {result.cell.name: result.finished.figures for result in self.results}

    @property
    def failures(self) -> dict[tuple[str, ...], str]:
        """Reasons of the failed cells by name."""
        return {
            result.cell.name: result.finished.failure
            for result in self.results
            if result.finished.failure
        }

    @property
    def reasons(self) -> dict[str, str]:
        """Reasons of the failed cells by label."""
        return {"/".join(name): reason for name, reason in self.failures.items()}

    @property
    def machines(self) -> list[Mapping[str, Any]]:
        """Machines that computed the results, the busiest first; cached results may come from
        other machines.
        """
        counts: list[tuple[int, Mapping[str, Any]]] = []
        for result in self.results:
            index = next(
                (i for i, (_, machine) in enumerate(counts) if machine == result.finished.machine),
                None,
            )
            if index is None:
                counts.append((1, result.finished.machine))
            else:
                counts[index] = (counts[index][0] + 1, counts[index][1])
        return [machine for _, machine in sorted(counts, key=lambda item: -item[0])]


def run_cells(
    cells: Sequence[Cell],
    *,
    cache: Path | str,
    workers: int = 1,
    dask: str | None = None,
    progress: Callable[[float, str], None] = lambda _fraction, _note: None,
    finished: Callable[[Result], None] = lambda _result: None,
) -> Outcome:
    """Run every cell that is not cached; one that raises counts as failed, and the others
    continue.

    Parameters
    ----------
    cells : sequence of Cell
        Each with a name of its own. Those with the same work and arguments run once.
    cache : folder of finished cells, made if missing; none is left empty after an error
        Failed ones are not kept: they are tried again next time.
    workers : int
        Processes; 1 runs in this one.
    dask : str, optional
        Address of the scheduler of a cluster to run on instead; files among the arguments must be
        there too.
    progress : callable, optional
        Called with the fraction done and a note with the time left.
    finished : callable, optional
        Called with each result as soon as it is there, those found on disk first. What it raises
        ends the run, but for Ctrl-C, after which it may not have been called with all results.

    Returns
    -------
    Outcome
        After Ctrl-C with the cells finished until then.

    Raises
    ------
    ValueError
        If a name comes twice, the content of an argument cannot be hashed, or no cluster answers.
    OSError
        If a file cannot be read or the cache cannot be written, as on a full disk; finished cells
        are kept.
    RuntimeError
        If the cluster disconnects; finished cells are kept.
    """
    if workers < 1:
        raise ValueError(f"workers: must be at least 1, got {workers}")
    names = [cell.name for cell in cells]
    if len(set(names)) < len(names):
        twice = next(cell for cell in cells if names.count(cell.name) > 1)
        raise ValueError(f"cells: every name must come once, {twice.label} comes twice")
    with _no_empty_folder(Path(cache)):
        return _run(
            cells, Cache(cache), workers=workers, dask=dask, progress=progress, finished=finished
        )


@dataclass(frozen=True)
class Engine:
    """Where cells are kept and what runs them, as :func:`run_cells` takes it."""

    cache: Path
    workers: int = 1
    dask: str | None = None

    @classmethod
    def of(
        cls, output: Path, *, cache: Path | None, workers: int | None, dask: str | None
    ) -> Self:
        """Fill in what is None: cells in the folder ``output``, as many workers as there are
        cores.
        """
        return cls(cache or output / "cells", workers or machine()["cores"] or 1, dask)

    def run(
        self,
        cells: Sequence[Cell],
        *,
        progress: Callable[[float, str], None] = lambda _fraction, _note: None,
        finished: Callable[[Result], None] = lambda _result: None,
    ) -> Outcome:
        """Run cells; see :func:`run_cells`."""
        return run_cells(
            cells,
            cache=self.cache,
            workers=self.workers,
            dask=self.dask,
            progress=progress,
            finished=finished,
        )


def _run(
    cells: Sequence[Cell],
    store: Cache,
    *,
    workers: int,
    dask: str | None,
    progress: Callable[[float, str], None],
    finished: Callable[[Result], None],
) -> Outcome:
    keys = fingerprints(cells)
    by_key = dict(zip(keys, cells, strict=True))
    alike: dict[str, list[Cell]] = {key: [] for key in by_key}
    for key, cell in zip(keys, cells, strict=True):
        alike[key].append(cell)
    stored_results = {key: stored for key in by_key if (stored := store.find(key)) is not None}
    cached = frozenset(stored_results)
    missing = {key: cell for key, cell in by_key.items() if key not in stored_results}
    waiting = {
        key: (cell.work, pinned_cell)
        for (key, cell), pinned_cell in zip(missing.items(), pinned(missing.values()), strict=True)
    }

    def tell(key: str) -> None:
        for cell in alike[key]:
            finished(Result(cell, stored_results[key], key in cached))

    try:
        progress(0.0, f"0 of {len(by_key)} cells")
        for count, key in enumerate(stored_results, 1):
            tell(key)
            progress(count / len(by_key), f"{count} of {len(by_key)} cells")
        began_s = time.monotonic()
        with closing(run_tasks(waiting, workers=workers, dask=dask)) as stream:
            for key, came in stream:
                if not came.failure:
                    store.keep(key, by_key[key], came)
                stored_results[key] = came
                tell(key)
                left_s = (
                    (time.monotonic() - began_s)
                    / (len(stored_results) - len(cached))
                    * (len(by_key) - len(stored_results))
                )
                progress(
                    len(stored_results) / len(by_key),
                    f"{len(stored_results)} of {len(by_key)} cells, about {in_words(left_s)} left",
                )
    except KeyboardInterrupt:  # it may have come between the writing of a cell and its entry here
        stored_results |= {
            key: stored
            for key in missing
            if key not in stored_results and (stored := store.find(key)) is not None
        }
    results = tuple(
        Result(cell, stored_results[key], key in cached)
        for key, cell in zip(keys, cells, strict=True)
        if key in stored_results
    )
    return Outcome(results, len(cells) - len(results), tuple(store.warnings))


@contextmanager
def _no_empty_folder(folder: Path) -> Iterator[None]:
    """On an exception, remove a folder that was made here and is still empty."""
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        yield
    except BaseException:
        for path in missing:
            try:
                path.rmdir()
            except OSError:  # something is in it, or it was never made
                break
        raise


def run_tasks(
    waiting: Tasks, *, workers: int, dask: str | None
) -> Generator[tuple[str, Finished]]:
    """Yield tasks as they finish, with no cache: for work whose results have a file of their own.

    Parameters
    ----------
    waiting : mapping from a key to a function and its arguments
    workers, dask
        As of :func:`run_cells`.
    """
    if dask is not None and waiting:
        yield from on_cluster(waiting, dask)
    elif workers > 1 and len(waiting) > 1:
        yield from in_processes(waiting, workers)
    else:
        for key, task in waiting.items():
            yield key, worked(*task)
