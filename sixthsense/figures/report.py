"""Reports on finished or killed runs: their figures, a table of their metrics, and an HTML page."""

from __future__ import annotations

import base64
import csv
import html
import json
import platform
import shlex
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from sixthsense.config import Config
from sixthsense.config.files import NOTES, parse_toml
from sixthsense.config.section import as_table
from sixthsense.config.version import __version__
from sixthsense.evaluation.groups import differing, flat
from sixthsense.evaluation.measured_run import MeasuredRun, numbered_names
from sixthsense.evaluation.results import QUANTITIES, in_groups, unit
from sixthsense.evaluation.tables import digits, html_table, text_table
from sixthsense.figures.panels import KINDS, figure_if_any
from sixthsense.figures.plot import Form, save_forms


def report(runs: Sequence[MeasuredRun], out: Path | str, form: Form = "png") -> list[Path]:
    """Write the figures and `report.html` into the folder `out`, for several runs also `metrics.csv`.

    The folder is created if missing. `form` "svg" or "pdf" adds each figure as vector graphics. A figure whose data all
    runs lack, such as errors without truth, is left out. Returns the written files. Raises InputError for no run and
    for more than 12 runs.
    """
    out = Path(out)
    pictures: dict[Path, str] = {}
    files: list[Path] = []
    for name, kind in KINDS.items():
        figure = figure_if_any(name, runs)
        if figure is not None:
            pictures[out / f"{name}.png"] = kind.caption
            files += save_forms(figure, out / f"{name}.png", form)
    if len(runs) > 1:
        files.append(out / "metrics.csv")
        with files[-1].open("w", newline="", encoding="utf-8") as stream:
            csv.writer(stream).writerows(table_of(runs))
    files.append(out / "report.html")
    files[-1].write_text(page(runs, pictures), encoding="utf-8")
    return [*pictures, *files]


def table_of(runs: Sequence[MeasuredRun], text: Callable[[Any], str] = str) -> list[list[str]]:
    """A heading, and a row per metric with a column per run, by default in full precision; empty without the metric."""
    keys = list(dict.fromkeys(key for run in runs for key in run.metrics))
    rows = [[key, *(text(run.metrics.get(key, "")) for run in runs)] for key in keys]
    return [["metric", *numbered_names(runs)], *rows]


def compact(runs: Sequence[MeasuredRun]) -> str:
    """The table of the runs as aligned text, with four significant digits."""
    return text_table(table_of(runs, digits))


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
figure { margin: 1.2rem 0; overflow-x: auto; }
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
@media (max-width: 40rem) {
  h1 { font-size: 1.25rem; }
  th, td { padding-right: .6rem; font-size: .9rem; white-space: nowrap; }
  figure img { max-width: none; width: 40rem; }
}
"""


def page(runs: Sequence[MeasuredRun], figures: Mapping[Path, str]) -> str:
    """The HTML of a report on one or several runs, with PNG `figures` embedded, by captions; every value is escaped."""
    names = numbered_names(runs)
    several = len(runs) > 1
    title = f"Runs compared: {', '.join(names)}" if several else runs[0].title
    first, *rest = [figure_block(file, caption, title) for file, caption in figures.items()] or [""]
    labelled = [(name if several else "", run) for name, run in zip(names, runs, strict=True)]
    metrics = metrics_rows([{key: digits(value) for key, value in run.metrics.items()} for run in runs])
    head = ["metric", *(names if several else ["value"]), "unit", "meaning"]
    sections = {"Metrics": table(head, metrics, len(runs))}
    if rest:
        sections["Figures"] = "\n".join(rest)
    if audits := "\n".join(filter(None, (_audit(*one) for one in labelled))):
        sections["Beside the truth"] = audits
    sections["Configuration"] = _configuration(labelled)
    sections["Reproduction"] = "\n".join(_reproduction(*one) for one in labelled)
    outcomes = [_outcome(*one) for one in labelled]
    return document(title, [*outcomes, contents(list(figures), list(sections)), first], sections)


def _audit(name: str, run: MeasuredRun) -> str:
    """What the audit of a replay by a truth has left in its folder; empty without one."""
    if run.folder is None or not (file := run.folder / "audit.json").exists():
        return ""
    text = f"<pre>{escaped(json.loads(file.read_text(encoding='utf-8'))['text'])}</pre>"
    picture = run.folder / "figures" / "audit.png"
    caption = f"{name} Errors in their 3-sigma tubes, NEES over time, chi-square Q-Q.".strip()
    return text + (figure_block(picture, caption, run.title) if picture.exists() else "")


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


def _notes(run: MeasuredRun) -> dict[str, dict[str, Any]]:
    """The tables of config.toml that are not settings, such as versions; {} without a file, or for an invalid one."""
    try:
        table = {} if run.folder is None else parse_toml((run.folder / "config.toml").read_text(encoding="utf-8-sig"))
    except (OSError, ValueError):
        return {}
    return {name: table[name] for name in NOTES if isinstance(table.get(name), dict)}


def escaped(value: Any) -> str:
    """A value as text for HTML."""
    return html.escape(str(value))


def _outcome(label: str, run: MeasuredRun) -> str:
    name = f"{escaped(label)}: " if label else ""
    line = f'<p class="outcome">{name}<strong>{escaped(run.outcome)}</strong></p>'
    if run.folder is not None and not (run.folder / "metrics.json").is_file():
        line += f'\n<p class="note">{name}the run was stopped before its end. The page shows the record up to then.</p>'
    if run.verdict is not None:
        kind = "quiet" if run.verdict.level == "good" else "note"
        line += f'\n<p class="{kind}">{name}map {escaped(run.verdict)}</p>'
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


def _configuration(labelled: Sequence[tuple[str, MeasuredRun]]) -> str:
    """The fields that differ from the default, or between several runs, and the complete configurations, folded."""
    import tomli_w

    tables = [as_table(run.trace.config) for _, run in labelled]
    settings, columns = list(map(flat_texts, tables)), [name for name, _ in labelled]
    same = "All runs have the same configuration."
    if len(labelled) == 1:
        settings.append(flat_texts(as_table(Config())))
        columns, same = ["this run", "default"], "All fields have their default values."
    rows = [[name, *(fields.get(name, "none") for fields in settings)] for name in differing(settings)]
    parts = [table(["different field", *columns], rows) if rows else f"<p>{same}</p>"]
    for complete, (name, run) in zip(tables, labelled, strict=True):
        of = f" of {escaped(name)}" if name else ""
        text = escaped(tomli_w.dumps({**complete, **_notes(run)}))
        parts.append(f"<details><summary>Complete configuration{of} (config.toml)</summary><pre>{text}</pre></details>")
    return "\n".join(parts)


def flat_texts(table: Mapping[str, Any]) -> dict[str, str]:
    """Nested settings by dotted names, with values as on the command line."""
    return {name: _value_text(value) for name, value in flat(table).items()}


def _value_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    return " ".join(map(_value_text, value)) if isinstance(value, (tuple, list)) else str(value)


_LOGS = ("log", "merged_with")
"""inputs of a replay that are arguments of its command"""


def _reproduction(name: str, run: MeasuredRun) -> str:
    """The commands that repeat a run, and the versions that produced it."""
    parts, notes = [f"<p><strong>{escaped(name)}</strong></p>" if name else ""], _notes(run)
    if run.folder is not None:
        config = shlex.quote(str(run.folder / "config.toml"))
        replayed = notes.get("replayed", {})
        command = f"sixthsense run --config {config}"
        logs = " ".join(shlex.quote(str(replayed[name])) for name in _LOGS if name in replayed)
        more = "".join(
            f" --{name.replace('_', '-')} {shlex.quote(str(value))}"
            for name, value in replayed.items()
            if name not in _LOGS
        )
        if logs:
            command = f"sixthsense {'merge' if _LOGS[1] in replayed else 'replay'} {logs} --config {config}{more}"
        elif replayed:
            command = f"sixthsense live{more} --config {config}"
        with_map = _prior_map_options(notes.get("prior_map", {}))
        command += with_map
        again = f"sixthsense replay {shlex.quote(str(run.folder))}{with_map}"
        parts.append(f"<pre>{escaped(command)}</pre>")
        if with_map:
            note = notes["prior_map"]
            said = f"{note['name']} is the folder of the prior map, of which its name and digest alone are recorded"
            parts.append(f"<p>Here {escaped(said)} ({escaped(str(note.get('digest', ''))[:12])}).</p>")
        parts.append(f"<p>Or from the recorded sensor data:</p>\n<pre>{escaped(again)}</pre>")
    versions = notes.get("versions") or {"sixthsense": __version__, "python": platform.python_version()}
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
        if isinstance(value, list) and (name == "pose" or any(value)):  # sigmas are 0 by default
            options += f" --{name.replace('_', '-')} {' '.join(shlex.quote(str(number)) for number in value)}"
    return options
