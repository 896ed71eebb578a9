"""How ``cep optimize`` runs a search, and where its result goes: the same for one code, frames and classes."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.cli.console import finish
from cep.cli.options import table_files

if TYPE_CHECKING:
    from rich.console import Console

    from cep.cli.console import Tick
    from cep.optics.code import ShutterCode
    from cep.workflows.optimize import Search
    from hw.device import DeviceProfile

__all__ = ["SearchRun"]


@dataclass(frozen=True, kw_only=True)
class SearchRun:
    """Options of a search that do not change what is searched.

    Parameters
    ----------
    how : Search
    profile : DeviceProfile, optional
        That must be able to play every code.
    output : Path
    force, as_json : bool
        As the command's options.
    tables : Path, optional
        As ``--table``.
    tick : Tick
    """

    how: Search
    profile: DeviceProfile | None
    output: Path
    force: bool
    as_json: bool
    tables: Path | None
    tick: Tick

    def outputs(self, *files: Path) -> list[Path]:
        """Return the files that are written: the codes', :attr:`output` when omitted, and the tables'."""
        return [*(files or (self.output,)), *table_files(self.tables)]

    @contextmanager
    def keeping(self, *codes: ShutterCode) -> Iterator[None]:
        """Write codes that were found; where that fails, as on a full disk, the error says them: none is lost.

        Raises
        ------
        ValueError
            If the device cannot play one.
        """
        from cep.search.playable import unplayable

        for code in codes:
            if reason := unplayable(code.bits, self.profile, code.chip_ns):
                raise ValueError(reason)
        try:
            yield
        except OSError as error:
            error.add_note(f"found: {', '.join(code.bits for code in codes)}")
            raise

    def shown(self, result: Mapping[str, Any], show: Callable[[Console], None]) -> Callable[[], None]:
        """Return the function that prints a result: by ``show`` for people, or as JSON with the seed."""
        from functools import partial

        return partial(
            finish, {**result, "seed": self.how.seed}, as_json=self.as_json, show=show,
            tables=self.tables,
        )  # fmt: skip
