"""Log of a training run: terminal line, CSV file, and a plot of loss and validation MNC."""

from __future__ import annotations

import csv
import io
import math
import sys
from pathlib import Path

from motdiff.files.outputs import write_bytes, write_text
from motdiff.training.trainer import Losses

_MEASURES = ("loss", "path", "dwell", "gradient", "samples_per_s", "validation_mnc")
_FIELDS = ("step", "samples", *_MEASURES)
_EVERY_STEPS = 50  # a row of each update would make files of megabytes


class RunLog:
    """Log of a run; a later piece appends to the same files, see :meth:`resume`.

    Parameters
    ----------
    folder : Path
        ``log.csv`` and ``progress.png`` go there.
    steps : int
        Steps of the whole run, for the time left.
    enabled : bool
        False: writes and prints nothing (the other processes of a group).
    """

    def __init__(self, folder: Path, *, steps: int, enabled: bool = True) -> None:
        self._folder = folder
        self._steps = steps
        self._enabled = enabled
        self._start: tuple[int, float] | None = None  # step and seconds of this piece's first
        self._last_mnc = math.nan
        self._live = sys.stderr.isatty()  # there the line of progress is written over
        self._clear = "\r\x1b[K" * self._live
        self._end = "\n" * (not self._live)

    def say(self, text: str) -> None:
        """Print a line."""
        if self._enabled:
            print(f"{self._clear}{text}", file=sys.stderr, flush=True)  # noqa: T201

    def step(self, step: int, losses: Losses, *, batch: int, seconds: float) -> None:
        """Note the updates done, of ``batch`` samples each; every 50 are one row of the file.

        ``seconds`` were spent over all pieces.
        """
        if not self._enabled:
            return
        if self._start is None:
            self._start = (step, seconds)
        if step % _EVERY_STEPS:
            return
        steps = step - self._start[0]
        elapsed_s = seconds - self._start[1]
        rate = math.nan  # at once after the first update
        if elapsed_s > 0:
            rate = steps * batch / elapsed_s
        values = [losses.smoothed, losses.path, losses.dwell, losses.gradient, rate, math.nan]
        self._row([step, step * batch, *values])
        remaining_min = (self._steps - step) * batch / rate / 60
        text = (
            f"step {step}/{self._steps}  loss {losses.smoothed:.4f}  MNC {self._last_mnc:.3f} "
            f" {rate:.1f} samples/s  {seconds / 60:.0f} min done, {remaining_min:.0f} left"
        )
        print(f"{self._clear}{text}", end=self._end, file=sys.stderr, flush=True)  # noqa: T201

    def resume(self, step: int, *, scheduled: bool) -> bool:
        """Delete the rows of later steps; returns whether there is a validation of ``step``.

        One that was made only because a piece ended there, where a single piece would not be
        ``scheduled`` to validate, is deleted as well.
        """
        path = self._folder / "log.csv"
        if not path.exists():
            return False
        # the lines as they are: those that stay are written back to the byte
        with path.open(newline="", encoding="utf-8") as file:
            header, *lines = file.readlines() or [""]
        rows = [header]
        validated = False
        for line in lines:
            values = next(csv.reader([line]), [])
            cut_short = len(values) < len(_FIELDS) or not line.endswith("\n")  # by a kill
            if cut_short or int(values[0]) > step:
                continue
            validation = int(values[0]) == step and values[-1] != ""
            if scheduled or not validation:
                rows.append(line)
                validated |= validation
        if self._enabled and len(rows) < 1 + len(lines):
            write_text(path, "".join(rows))
        return validated

    def validated(self, step: int, score: float, *, loss: float) -> None:
        """Note the MNC ``score`` and the smoothed ``loss`` of a step, and update the plot."""
        if not self._enabled:
            return
        self._last_mnc = score
        self._row([step, math.nan, loss, math.nan, math.nan, math.nan, math.nan, score])
        self.say(f"step {step}: validation MNC {score:.4f}")
        self._plot()

    def close(self) -> None:
        """End the line on the terminal."""
        if self._enabled and self._live:
            print(file=sys.stderr)  # noqa: T201

    def _row(self, values: list[int | float]) -> None:
        path = self._folder / "log.csv"
        new = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(_FIELDS)
            writer.writerow(map(_text, values))

    def _plot(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        rows = read_log(self._folder / "log.csv")
        figure = Figure(figsize=(8, 4), layout="constrained")
        FigureCanvasAgg(figure)
        loss_axis = figure.add_subplot()
        loss_axis.plot(*_curve(rows, "loss"))
        loss_axis.set(xlabel="step", ylabel="loss (smoothed)")
        score_axis = loss_axis.twinx()
        score_axis.plot(*_curve(rows, "validation_mnc"), "o-", color="C1", markersize=3)
        score_axis.set_ylabel("validation MNC", color="C1")
        picture = io.BytesIO()
        figure.savefig(picture, format="png", dpi=120)
        write_bytes(self._folder / "progress.png", picture.getvalue())


def read_log(path: Path | str) -> list[dict[str, float]]:
    """Rows of a ``log.csv``; missing values are NaN."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        return [
            {name: float(row[name] or math.nan) for name in _FIELDS}
            for row in csv.DictReader(file)
        ]


def last_validation(path: Path | str) -> float | None:
    """Return the MNC of the last validation in a ``log.csv``, None without one or without file."""
    if not Path(path).is_file():
        return None
    _, scores = _curve(read_log(path), "validation_mnc")
    return next(reversed(scores), None)


def _curve(rows: list[dict[str, float]], name: str) -> tuple[list[float], list[float]]:
    """Return the steps and values of a column; of two rows of a step the later one."""
    points = sorted({row["step"]: row[name] for row in rows if not math.isnan(row[name])}.items())
    return [step for step, _ in points], [value for _, value in points]


def _text(value: float) -> str:
    if math.isnan(value):
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"
