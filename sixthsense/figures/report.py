"""Reports on runs and audits: their figures, a table of their metrics, and one page of HTML."""

from __future__ import annotations

import base64
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sixthsense.config import Config
from sixthsense.config.errors import InputError
from sixthsense.config.files import NOTES, parse_toml
from sixthsense.config.section import as_table
from sixthsense.evaluation.groups import Sample, differing, flat
from sixthsense.evaluation.measured_run import MeasuredRun, numbered_names
from sixthsense.evaluation.results import as_text, html_of, side_by_side
from sixthsense.figures.kinds import KINDS, plot
from sixthsense.figures.plot import save

if TYPE_CHECKING:
    import pandas as pd

_TEMPLATE = Path(__file__).with_name("page.html.j2")
_VERDICTS = ("outcome", "map", "consistency")
"""lines of a run's summary that stand first; what they rest on follows"""
_GOOD = ("good", "consistent")


@dataclass(frozen=True, slots=True)
class Verdict:
    """A line at the top of a page."""

    name: str
    """what it is about"""
    text: str
    """the answer"""
    is_alarm: bool = False
    """whether it is marked"""


@dataclass(frozen=True, slots=True)
class Drawn:
    """A figure of a page."""

    file: Path
    """a PNG, which is embedded"""
    caption: str
    """below it"""

    @property
    def data(self) -> str:
        """The file in base64."""
        return base64.b64encode(self.file.read_bytes()).decode("ascii")


@dataclass(frozen=True, slots=True)
class Text:
    """A text of a page, as it is."""

    text: str
    """its lines"""
    folded: str = ""
    """what is shown of it before it is opened; empty: all"""


def page(title: str, verdicts: Sequence[Verdict], sections: Mapping[str, Sequence[Drawn | Text | pd.DataFrame]]) -> str:
    """A page of HTML that needs no other file: the verdicts, then sections by their headings; empty ones are left out.

    Every text is escaped.
    """
    from jinja2 import Environment

    template = Environment(autoescape=True, trim_blocks=True, lstrip_blocks=True).from_string(_TEMPLATE.read_text())
    shown = {name: blocks for name, blocks in sections.items() if blocks}
    return template.render(title=title, verdicts=verdicts, sections=shown, html_of=html_of)


def report(runs: Sequence[MeasuredRun], out: Path | str) -> list[Path]:
    """Write the figures and `report.html` into the folder `out`, for several runs also `metrics.csv`.

    The folder is created if missing. A figure whose data all runs lack, such as errors without truth, is left out.
    Returns the written files. Raises InputError for no run, for more than 12 runs, and for a damaged file of a run.
    """
    out = Path(out)
    names = numbered_names([run.name for run in runs])
    samples = [run.sample(name) for name, run in zip(names, runs, strict=True)]
    drawn = list(_drawn(samples, out))
    files, table = [one.file for one in drawn], side_by_side({one.name: one.metrics for one in samples})
    if len(runs) > 1:
        files.append(out / "metrics.csv")
        table[names].to_csv(files[-1])
    labelled_runs = [(name if len(runs) > 1 else "", run) for name, run in zip(names, runs, strict=True)]
    sections: dict[str, Any] = {
        "What it rests on": [_summaries(labelled_runs)],
        "Figures": drawn,
        "Metrics": [as_text(table)],
        "Configuration": list(_configuration(labelled_runs)),
    }
    title = f"Runs compared: {', '.join(names)}" if len(runs) > 1 else runs[0].title
    verdicts = [verdict for one in labelled_runs for verdict in _verdicts(*one)]
    return [*files, write_page(out / "report.html", page(title, verdicts, sections))]


def write_page(file: Path, text: str) -> Path:
    """Write a page and return its file; InputError if it cannot be written."""
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(file, f"cannot be written ({error.strerror})", "a file") from None
    return file


def _drawn(samples: Sequence[Sample], out: Path) -> Iterator[Drawn]:
    """Write the figures for which there are data."""
    for name, kind in KINDS.items():
        try:
            figure = plot(name, samples)
        except InputError as error:
            if error.where != name:
                raise
            continue
        save(figure, out / f"{name}.png")
        yield Drawn(out / f"{name}.png", kind.caption)


def _verdicts(name: str, run: MeasuredRun) -> Iterator[Verdict]:
    """The first lines of a run, and what is missing in its folder."""
    for label in _VERDICTS:
        if text := run.summary.get(label):
            is_alarm = label == "map" and text.split(":")[0].split()[0] not in _GOOD
            yield Verdict(f"{name} {label}".strip(), text, is_alarm or text.startswith("overconfident"))
    if any("the run's end" in part for part in run.missing):
        yield Verdict(name, "the run was stopped before its end; the page shows the record up to then", True)
    if run.missing:
        yield Verdict(name, f"the folder has no record of {'; '.join(run.missing)}", True)


def _summaries(runs: Sequence[tuple[str, MeasuredRun]]) -> pd.DataFrame:
    """The other lines of the summaries, a column per run."""
    import pandas as pd

    columns = {name: {k: text for k, text in run.summary.items() if k not in _VERDICTS} for name, run in runs}
    return pd.DataFrame(columns).fillna("")


def _configuration(runs: Sequence[tuple[str, MeasuredRun]]) -> Iterator[pd.DataFrame | Text]:
    """The fields that differ from the default, or between several runs, and the complete configurations, folded."""
    import pandas as pd
    import tomli_w

    tables = [as_table(run.trace.config) for _, run in runs]
    settings, columns = list(map(flat, tables)), [name for name, _ in runs]
    if len(runs) == 1:
        settings.append(flat(as_table(Config())))
        columns = ["this run", "default"]
    rows = {name: [fields.get(name, "none") for fields in settings] for name in differing(settings)}
    if rows:
        yield pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("different field")
    for complete, (name, run) in zip(tables, runs, strict=True):
        folded = " of ".join(filter(None, ("Complete configuration", name))) + " (config.toml)"
        yield Text(tomli_w.dumps({**complete, **_notes(run)}), folded)


def _notes(run: MeasuredRun) -> dict[str, dict[str, Any]]:
    """The tables of config.toml that are not settings, such as versions; {} without a file, or for an invalid one."""
    try:
        table = {} if run.folder is None else parse_toml((run.folder / "config.toml").read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return {}
    return {name: table[name] for name in NOTES if isinstance(table.get(name), dict)}
