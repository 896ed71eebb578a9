"""Declaration of an estimator: its name, needs, options with their help, and the works it uses."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import MISSING, Field, dataclass, field, fields
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar, Literal

if TYPE_CHECKING:
    from pathlib import Path

    from motdiff.estimators.base import Estimator

Kind = Literal["number", "text", "duration", "photo", "gyro", "codes"]
"""What an option's value is on the command line. The last three are read from files: a photo as
an array in linear light, a gyroscope's recording, and the code of each blurred photo."""


@dataclass(frozen=True)
class Option:
    """How an option of an estimator is given on the command line, and its help.

    Attributes
    ----------
    kind : Kind
    help : str
    flag : str
        As ``--focal``.
    metavar : str
    shown_default : str
        The default in words; empty where the help says it.
    choices : tuple of str
        The values that there are; empty where any is taken.
    """

    kind: Kind
    help: str
    flag: str
    metavar: str
    shown_default: str = ""
    choices: tuple[str, ...] = ()


def option(kind: Kind, help: str, *, default: Any = MISSING, **declared: Any) -> Any:
    """Make the field of an :class:`Option`; one without a default is needed."""
    return field(default=default, metadata={"option": Option(kind, help, **declared)})


def codes_option(**default: Any) -> Any:
    """Make the field ``codes``, which is the same for every method that has it."""
    return option(
        "codes",
        "Code that the photo was taken through: bits, code.json, a published name, or open; once"
        " for each photo, in order. The path is then found with its order in time.",
        flag="--code",
        metavar="CODE",
        **default,
    )


@dataclass(frozen=True, kw_only=True)
class Method(ABC):
    """An estimator as it is registered, with the values of its options.

    A subclass is a frozen dataclass with a field for each option. The command line imports it for
    its help pages, so numpy, torch and the estimator itself are imported inside :meth:`make`.

    Attributes
    ----------
    name : str
        As ``--method`` and ``method=`` have it.
    about : str
        The method in a few words, for the help page.
    cites : tuple of str
        Works behind it, by their keys in ``cep/files/works.bib``.
    smallest_px : int
        Least side of a photo.
    is_blind : bool
        Whether blurred photos of any scene are all that it needs; several of one motion are then
        searched together, by a method ``estimate_from(photos)`` of the estimator.
    one_photo_as : str
        Why a folder of photos cannot share the options; empty where it can.
    """

    name: ClassVar[str]
    about: ClassVar[str]
    cites: ClassVar[tuple[str, ...]] = ()
    smallest_px: ClassVar[int] = 1
    is_blind: ClassVar[bool] = False
    one_photo_as: ClassVar[str] = ""

    @abstractmethod
    def make(self, *, seed: int = 0, progress: Callable[[float], None] | None = None) -> Estimator:
        """Make the estimator.

        Parameters
        ----------
        seed : int
            Of what it draws at random.
        progress : callable, optional
            Called with the finished share 0..1, by estimators that take long.
        """

    def loading_shares(self) -> tuple[float, float, float] | None:
        """Shares of the time at which torch begins to load, is there, and the estimator is made.

        None where the estimator does without torch.
        """
        return None

    def weight_files(self) -> tuple[Path, ...]:
        """Files of trained weights, on which a result depends."""
        return ()

    def load(
        self, *, seed: int = 0, progress: Callable[[float, str], None] = lambda _share, _note: None
    ) -> Estimator:
        """Make the estimator, and report the share of loading and estimating that is done."""
        shares = self.loading_shares()
        if shares is None:
            return self.make(seed=seed)
        loading_begins, torch_loaded, loaded = shares

        def search_progress(share: float) -> None:
            progress((1 - share) * loaded + share, "searching the motion")

        progress(loading_begins, "loading torch")
        import_module("torch")  # about half of the loading time, so that the bar moves in between
        kind = "network" if self.weight_files() else "search"
        progress(torch_loaded, f"loading the {kind}")
        estimator = self.make(seed=seed, progress=search_progress)
        search_progress(0.0)
        return estimator


def command_options(method: type[Method]) -> dict[str, Option]:
    """Return the options of a method that the command line has, by the names of their fields."""
    return {
        declared.name: declared.metadata["option"]
        for declared in fields(method)
        if "option" in declared.metadata
    }


def is_needed(option_field: Field[Any]) -> bool:
    """Whether an option has no default."""
    return option_field.default is MISSING
