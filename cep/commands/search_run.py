"""How ``cep optimize`` runs a search, and where its result goes: the same for one code, frames and
classes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cep.commands.console import finish
from cep.commands.options import table_files

if TYPE_CHECKING:
    from rich.console import Console

    from cep.commands.console import Tick
    from cep.optics.code import ShutterCode
    from cep.search.optimize import Search
    from hw.device import DeviceProfile
    from motdiff.files.outputs import Outputs

Write = Callable[[Mapping[Path, Path]], object]
Keep = Callable[["Sequence[ShutterCode]", Write], None]


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

    def outputs(self, *files: Path, inputs: Sequence[Path] = ()) -> Outputs:
        """Return the files that are written: the codes', :attr:`output` when omitted, and the
        tables'.
        """
        from motdiff.files.outputs import Outputs

        return Outputs(
            (*(files or (self.output,)), *table_files(self.tables)), self.force, tuple(inputs)
        )

    @contextmanager
    def keeping(self, *files: Path) -> Iterator[Keep]:
        """Lose no codes that were found while they are compared: Ctrl-C writes them, another error
        tells them.

        Parameters
        ----------
        *files : Path
            Of the codes, :attr:`output` when omitted.

        Yields
        ------
        function
            To be called with the codes, and with what writes them under the temporary names of the
            files; raises ValueError where the device cannot play one.
        """
        from cep.search.playable import unplayable
        from motdiff.files.outputs import Outputs

        candidates: list[tuple[str, Write]] = []

        def keep(codes: Sequence[ShutterCode], write: Write) -> None:
            for code in codes:
                if reason := unplayable(code.bits, self.profile, code.chip_ns):
                    raise ValueError(reason)
            candidates.append((in_bits(codes), write))

        try:
            yield keep
        except KeyboardInterrupt:
            for bits, write in candidates:
                with Outputs(files or (self.output,), self.force).written(summary=bits) as made:
                    write(made)
            raise
        except Exception as error:
            for bits, _ in candidates:
                error.add_note(f"found: {bits}")
            raise

    def shown(
        self,
        result: Mapping[str, Any],
        show: Callable[[Console], None],
        *,
        outputs: Outputs,
        save: Write,
        codes: Sequence[ShutterCode],
    ) -> Callable[[], None]:
        """Return the function that writes the outputs and prints a result, see
        :func:`cep.commands.console.finish`.
        """
        from functools import partial

        return partial(
            finish,
            {**result, "seed": self.how.seed},
            as_json=self.as_json,
            show=show,
            outputs=outputs,
            save=save,
            tables=self.tables,
            summary=in_bits(codes),
        )


def in_bits(codes: Iterable[ShutterCode]) -> str:
    """Write codes for an error line."""
    return ", ".join(code.bits for code in codes)
