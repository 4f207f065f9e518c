"""Reports on finished or killed runs: their figures, a table of their metrics, and an HTML page."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Literal, get_args

from sixthsense.config.section import shown
from sixthsense.config.suggestion import allowed_names, nearest
from sixthsense.evaluation.measured_run import MeasuredRun, ReportError, numbered_names
from sixthsense.evaluation.tables import text_table
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


def table(runs: Sequence[MeasuredRun]) -> list[list[str]]:
    """A heading, and a row per metric with a column per run, in full precision; empty where a run lacks the metric."""
    keys = list(dict.fromkeys(key for run in runs for key in run.metrics))
    rows = [[key, *(str(run.metrics.get(key, "")) for run in runs)] for key in keys]
    return [["metric", *numbered_names(runs)], *rows]


def compact(rows: Sequence[Sequence[str]]) -> str:
    """The rows of a table as aligned text, with four significant digits."""
    short = [[row[0], *map(_four_digits, row[1:])] for row in rows]
    return text_table(short)


def _four_digits(cell: str) -> str:
    try:
        return cell if cell.lstrip("-").isdigit() else f"{float(cell):.4g}"
    except ValueError:
        return cell
