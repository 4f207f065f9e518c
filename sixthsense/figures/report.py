"""Reports on finished or killed runs: their figures, a table of their metrics, and an HTML page."""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args

from sixthsense.config.section import shown
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.evaluation.measured_run import MeasuredRun, ReportError, numbered_names
from sixthsense.evaluation.tables import digits, text_table
from sixthsense.figures.panels import KINDS, figure_if_any
from sixthsense.figures.plot import save
from sixthsense.figures.report_page import page

Form = Literal["png", "svg", "pdf"]


def as_form(text: str) -> Form:
    """Parse the name of a file format of figures; raises ReportError with the allowed names."""
    forms: tuple[Form, ...] = get_args(Form)
    for form in forms:
        if text == form:
            return form
    raise ReportError(f"--figures: found {shown(text)}, {allowed_names(forms, nearest(text, forms))}")


def report(runs: Sequence[MeasuredRun], out: Path | str, form: Form = "png") -> list[Path]:
    """Write the figures and `report.html` into the folder `out`, for several runs also `metrics.csv`.

    The folder is created if missing. `form` "svg" or "pdf" adds each figure as vector graphics. A figure whose data all
    runs lack, such as errors without truth, is left out. Returns the written files. Raises ReportError for no run and
    for more than 12 runs.
    """
    out = Path(out)
    pictures: dict[Path, str] = {}
    files: list[Path] = []
    for name, kind in KINDS.items():
        figure = figure_if_any(name, runs)
        if figure is not None:
            pictures[out / f"{name}.png"] = kind.caption
            files += [out / f"{name}.{form}"] if form != "png" else []
            for file in dict.fromkeys((out / f"{name}.png", out / f"{name}.{form}")):
                save(figure, file)
    if len(runs) > 1:
        files.append(out / "metrics.csv")
        with files[-1].open("w", newline="", encoding="utf-8") as stream:
            csv.writer(stream).writerows(table(runs))
    files.append(out / "report.html")
    files[-1].write_text(page(runs, pictures), encoding="utf-8")
    return [*pictures, *files]


def table(runs: Sequence[MeasuredRun], text: Callable[[Any], str] = str) -> list[list[str]]:
    """A heading, and a row per metric with a column per run, by default in full precision; empty without the metric."""
    keys = list(dict.fromkeys(key for run in runs for key in run.metrics))
    rows = [[key, *(text(run.metrics.get(key, "")) for run in runs)] for key in keys]
    return [["metric", *numbered_names(runs)], *rows]


def compact(runs: Sequence[MeasuredRun]) -> str:
    """The table of the runs as aligned text, with four significant digits."""
    return text_table(table(runs, digits))
