"""The page of a report: one HTML file with embedded figures, without scripts and external resources."""

from __future__ import annotations

import base64
import html
import platform
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from sixthsense.config import Config
from sixthsense.config.files import NOTES
from sixthsense.config.section import as_table
from sixthsense.config.toml import parse_toml
from sixthsense.config.version import __version__
from sixthsense.evaluation.groups import differing, flat
from sixthsense.evaluation.measured_run import MeasuredRun, numbered_names
from sixthsense.evaluation.results import QUANTITIES, in_groups, unit
from sixthsense.evaluation.tables import digits, html_table

_CAPTIONS = {
    "map": "Map: true walls, detected walls, landmarks with 95 % ellipses, planned and driven paths.",
    "error": "Error of the pose at keyframes, and the three-sigma bounds of the estimator.",
    "rpe": "Relative pose error: that of the motion over every piece of path of a length, root mean square.",
    "nees": "Consistency of the pose: normalised estimation error squared (NEES), 3 on average if consistent.",
    "nis": "Consistency of the matches: normalised innovation squared (NIS) per dof, 1 on average if consistent.",
    "stages": "Computing time of the stages of a keyframe.",
    "coverage": "Seen share of the visible area, over time.",
    "exploration": "Exploration: seen area, remaining frontiers, and planned paths, pale to dark over time.",
}

_STYLE = """
:root { color-scheme: light; }
* { box-sizing: border-box; }
body { margin: 0 auto; padding: 1rem 1rem 3rem; max-width: 66rem; background: #fff; color: #1a1a1a;
  font: 1rem/1.5 system-ui, sans-serif; overflow-wrap: anywhere; }
h1 { font-size: 1.5rem; line-height: 1.25; margin: .5rem 0; }
h2 { font-size: 1.15rem; margin: 2rem 0 .5rem; padding-bottom: .2rem; border-bottom: 1px solid #ddd; }
.outcome { font-size: 1.1rem; margin: .2rem 0; }
.note { padding: .5rem .8rem; background: #fff4e5; border-left: .25rem solid #e69f00; }
.quiet { color: #595959; }
nav ul { display: flex; flex-wrap: wrap; gap: .2rem 1rem; margin: .8rem 0; padding: 0; list-style: none; }
figure { margin: 1.2rem 0; }
figure img { display: block; max-width: 100%; height: auto; }
figcaption { color: #595959; font-size: .9rem; }
.wide { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: left; vertical-align: top; padding: .2rem 1rem .2rem 0; border-bottom: 1px solid #eee;
  overflow-wrap: normal; }
.value { text-align: right; white-space: nowrap; }
th.group { padding-top: .9rem; color: #0072b2; }
code, pre { font: .875rem/1.45 ui-monospace, monospace; }
pre { background: #f6f6f6; padding: .6rem .8rem; overflow-x: auto; }
summary { cursor: pointer; margin: .6rem 0; }
@media (max-width: 30rem) {
  h1 { font-size: 1.25rem; }
  th, td { padding-right: .6rem; font-size: .9rem; white-space: nowrap; }
  figure img { max-width: none; width: 40rem; }
}
"""


def page(runs: Sequence[MeasuredRun], figures: Sequence[Path]) -> str:
    """The HTML of a report on one or several runs, with the PNG `figures` embedded; every value is escaped."""
    described = [_DescribedRun(run, name, len(runs) > 1) for run, name in zip(runs, numbered_names(runs), strict=True)]
    title = runs[0].title if len(runs) == 1 else f"Runs compared: {', '.join(run.name for run in described)}"
    first, rest = figures[:1], figures[1:]
    captioned = {file: _CAPTIONS.get(file.stem, file.stem) for file in figures}
    sections = {"Metrics": _metrics(described)}
    if rest:
        sections["Figures"] = "\n".join(figure_block(file, captioned[file], title) for file in rest)
    sections["Configuration"] = _configuration(described)
    sections["Reproduction"] = "\n".join(map(_reproduction, described))
    top = [figure_block(file, captioned[file], title) for file in first]
    return document(title, [*map(_outcome, described), contents(figures, list(sections)), *top], sections)


def document(title: str, top: Sequence[str], sections: Mapping[str, str]) -> str:
    """A page of HTML with a title, what stands at its top, and sections by their headings."""
    parts = [f"<h1>{escaped(title)}</h1>", *top]
    parts += [f'<h2 id="{anchor(name)}">{escaped(name)}</h2>\n{content}' for name, content in sections.items()]
    body = "\n".join(part for part in parts if part)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escaped(title)}</title>
<style>{_STYLE}</style>
</head>
<body>
{body}
</body>
</html>
"""


class _DescribedRun:
    """The data of a run that the page shows."""

    def __init__(self, run: MeasuredRun, name: str, is_one_of_several: bool) -> None:
        self.name, self.is_named = name, is_one_of_several
        self.outcome, self.metrics, self.config, self.folder = run.outcome, run.metrics, run.trace.config, run.folder
        self.missing = run.missing
        self.is_killed = run.folder is not None and not (run.folder / "metrics.json").is_file()
        self.notes = {} if run.folder is None else _notes(run.folder)


def _notes(folder: Path) -> dict[str, dict[str, Any]]:
    """The tables of config.toml that are not settings, such as versions; {} for a missing or invalid file."""
    try:
        table = parse_toml((folder / "config.toml").read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return {}
    return {name: table[name] for name in NOTES if isinstance(table.get(name), dict)}


def escaped(value: Any) -> str:
    """A value as text for HTML."""
    return html.escape(str(value))


def _outcome(run: _DescribedRun) -> str:
    name = f"{escaped(run.name)}: " if run.is_named else ""
    line = f'<p class="outcome">{name}<strong>{escaped(run.outcome)}</strong></p>'
    if run.is_killed:
        line += f'\n<p class="note">{name}the run was stopped before its end. The page shows the record up to then.</p>'
    if run.missing:
        line += f'\n<p class="note">{name}the folder has no record of {escaped("; ".join(run.missing))}.</p>'
    return line


def contents(figures: Sequence[Path], sections: Sequence[str]) -> str:
    """Links to the figures and sections of a page."""
    links = [(f"figure-{file.stem}", f"{file.stem} (figure)") for file in figures]
    links += [(anchor(name), name) for name in sections]
    items = "".join(f'<li><a href="#{escaped(at)}">{escaped(name)}</a></li>' for at, name in links)
    return f'<nav aria-label="Contents"><ul>{items}</ul></nav>'


def anchor(name: str) -> str:
    """The identifier of a section."""
    return name.lower().replace(" ", "-")


def figure_block(file: Path, caption: str, title: str) -> str:
    """A PNG with its caption; the text for those who do not see it has the page's title, too."""
    data = base64.b64encode(file.read_bytes()).decode("ascii")
    return (
        f'<figure id="figure-{escaped(file.stem)}"><div class="wide">'
        f'<img alt="{escaped(f"{caption} {title}")}" src="data:image/png;base64,{data}"></div>'
        f"<figcaption>{escaped(caption)}</figcaption></figure>"
    )


def table(head: Sequence[str], rows: Sequence[Sequence[str]], numbers: int = 0) -> str:
    """A table that scrolls horizontally if it is too wide; `numbers` as in `html_table`."""
    return f'<div class="wide">{html_table(head, rows, numbers)}</div>'


def metrics_rows(runs: Sequence[Mapping[str, str]]) -> list[list[str]]:
    """Metrics by key, as texts, in groups: a column per run or group of runs, the unit and the meaning."""

    def cells(key: str) -> list[str]:
        meaning = QUANTITIES[key].meaning if key in QUANTITIES else ""
        return [key, *(run.get(key, "") for run in runs), unit(key), meaning]

    return in_groups(runs, cells)


def _metrics(runs: Sequence[_DescribedRun]) -> str:
    """The metrics in groups, with a column per run."""
    rows = metrics_rows([{key: digits(value) for key, value in run.metrics.items()} for run in runs])
    head = ["metric", *([run.name for run in runs] if len(runs) > 1 else ["value"]), "unit", "meaning"]
    return table(head, rows, len(runs))


def _configuration(runs: Sequence[_DescribedRun]) -> str:
    """The fields that differ from the default, or between several runs, and the complete configurations, folded."""
    settings, default = [flat_texts(as_table(run.config)) for run in runs], flat_texts(as_table(Config()))
    if len(runs) > 1:
        columns, same = [run.name for run in runs], "All runs have the same configuration."
    else:
        settings, columns, same = [*settings, default], ["this run", "default"], "All fields have their default values."
    rows = [[name, *(fields.get(name, "none") for fields in settings)] for name in differing(settings)]
    parts = [table(["different field", *columns], rows) if rows else f"<p>{same}</p>"]
    for run in runs:
        of = f" of {escaped(run.name)}" if len(runs) > 1 else ""
        text = escaped(_toml(run))
        parts.append(f"<details><summary>Complete configuration{of} (config.toml)</summary><pre>{text}</pre></details>")
    return "\n".join(parts)


def _toml(run: _DescribedRun) -> str:
    import tomli_w

    return tomli_w.dumps({**as_table(run.config), **run.notes})


def flat_texts(table: Mapping[str, Any]) -> dict[str, str]:
    """Nested settings by dotted names, with values as on the command line."""
    return {name: _value_text(value) for name, value in flat(table).items()}


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return " ".join(map(_value_text, value)) if isinstance(value, (tuple, list)) else str(value)


def _reproduction(run: _DescribedRun) -> str:
    """The commands that repeat a run, and the versions that produced it."""
    parts = [f"<p><strong>{escaped(run.name)}</strong></p>" if run.is_named else ""]
    if run.folder is not None:
        config = shlex.quote(str(run.folder / "config.toml"))
        replayed = run.notes.get("replayed", {})
        command = f"sixthsense run --config {config}"
        if "log" in replayed:
            more = "".join(f" --{name} {shlex.quote(str(value))}" for name, value in replayed.items() if name != "log")
            command = f"sixthsense replay {shlex.quote(str(replayed['log']))} --config {config}{more}"
        if "scan" in replayed:
            topics = " ".join(f"--{name} {shlex.quote(str(value))}" for name, value in replayed.items())
            command = f"sixthsense live {topics} --config {config}"
        with_map = _prior_map_options(run.notes.get("prior_map", {}))
        command += with_map
        again = f"sixthsense replay {shlex.quote(str(run.folder))}{with_map}"
        parts.append(f"<pre>{escaped(command)}</pre>")
        parts.append(f"<p>Or from the recorded sensor data:</p>\n<pre>{escaped(again)}</pre>")
    versions = run.notes.get("versions") or {"sixthsense": __version__, "python": platform.python_version()}
    words = ", ".join(f"{name} {version}" for name, version in versions.items())
    parts.append(f'<p class="quiet">Run by {escaped(words)}.</p>')
    return "\n".join(part for part in parts if part)


def _prior_map_options(note: Any) -> str:
    """The options of a run that began with a prior map, whose folder is known by its name only."""
    if not isinstance(note, Mapping) or "name" not in note:
        return ""
    options = f" --prior-map {shlex.quote(str(note['name']))}"
    if note.get("lost") is True:
        options += " --lost"
    for name in ("pose", "pose_sigma"):
        value = note.get(name)
        if isinstance(value, list) and any(value):
            options += f" --{name.replace('_', '-')} {' '.join(shlex.quote(str(number)) for number in value)}"
    return options
