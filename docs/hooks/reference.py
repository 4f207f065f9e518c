"""Reference pages generated from the package: configuration, commands and metrics."""

from __future__ import annotations

import ast
import inspect
import io
import itertools
import re
import typing
from collections.abc import Iterator
from contextlib import redirect_stdout
from typing import Any

from pydantic.fields import FieldInfo

from sixthsense.cli import COMMANDS, command_class, main
from sixthsense.cli.listing import parser_of
from sixthsense.cli.options import Option, Options
from sixthsense.config import PRESETS, Config, Section, preset
from sixthsense.config.section import allowed, kind_of
from sixthsense.evaluation.results import QUANTITIES
from sixthsense.logs.finding import KINDS

_UNITS = {"m": "m", "m2": "m²", "rad": "rad", "s": "s"}
_UNIT_IN_TEXT = re.compile(r"(?:,| in) (m/s\^2|m/s|rad/s|m and rad|m|rad|s)[,.;:]")

_GROUP_NOTES = {
    "Outcome": [
        "The [outcome](../concepts/index.md#how-a-run-ends) is decided by the estimate: the true distance to a goal",
        "that is reached is `goal_error_m`. Coverage is measured against [what can be",
        "seen](../concepts/exploration.md#coverage). `run.trace.left` has each place and its reason.",
    ],
    "Accuracy": [
        "Trajectories are not aligned, because the start is known. `ate_rmse_m` is computed from `estimate.tum`, the",
        "causal estimate at each scan, and so are the relative pose errors `rpe_*`: those of the motion over every",
        "sub-trajectory of that length (KITTI; `evo_rpe` with `--delta_unit m --all_pairs --pairs_from_reference`).",
        "The relation errors (Kümmerle et al. 2009) are those of the final trajectory.",
    ],
    "Consistency": ["See [Consistency](../concepts/consistency.md) for their meaning and interpretation."],
    "Map and path": [
        "Paths keep a [margin](../concepts/planning.md#clearance-and-cost) where there is room. Every command",
        "passes the [guard](../concepts/planning.md#the-guard).",
    ],
    "Time": [
        "The time of a keyframe excludes sensing. A stage's mean is its total time divided by the keyframes.",
    ],
}
_MARKER = re.compile(r"<!-- (findings|configuration|commands|metrics) -->")
_SHARED = ("config", "out", "overwrite")


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Put generated tables in the place of their markers, each alone on a line of its page."""
    made = {"findings": findings, "configuration": configuration, "commands": command_line, "metrics": metrics}
    return _MARKER.sub(lambda match: made[match[1]](), markdown)


def findings() -> str:
    """Return a row for each kind of finding of a log: what is found, what is done, and the option that sets it."""
    lines = ["| found | is | option |", "| --- | --- | --- |"]
    for kind in KINDS.values():
        name, _, value = kind.option.partition(" ")
        option = f"`{_flag(name)}{' ' * bool(value)}{value}`" if name else "-"
        text = re.sub(r"`([a-z_.]+)`", lambda match: f"`{_flag(match[1])}`", re.sub(r"\{[^}]*\}", "…", kind.text))
        if text.strip("… "):  # a note with a text of its own is described on the page
            lines.append(f"| {text} | {kind.action} | {option} |")
    return "\n".join(lines)


def _flag(name: str) -> str:
    return f"--{name.replace('_', '-')}"


def configuration() -> str:
    """Return all fields, section by section."""
    lines = _section(Config, "", 2)
    lines += ["## Presets", "", "The fields that each preset sets; `default` sets none.", ""]
    for name in PRESETS:
        changes = list(_changes(preset(name), Config(preset=name)))
        if changes:
            lines += [f"### {name}", "", "| field | value |", "| --- | --- |"]
            lines += [f"| `{field}` | {_shown(value)} |" for field, value in changes] + [""]
    return "\n".join(lines)


def command_line() -> str:
    """Return the commands and their options, without the fields of the configuration."""
    with redirect_stdout(io.StringIO()) as out:
        main(["--help"])
    lines = ["```text", out.getvalue().rstrip(), "```", ""]
    for name in COMMANDS:
        command = command_class(name)
        lines += [f"## {name}", "", inspect.getdoc(command) or "", ""]
        options = [option for option in parser_of(name, command)._actions if isinstance(option, Option)]
        own = [o for o in options if issubclass(o.owner, Options) and o.dest not in command.refused]
        own.sort(key=lambda option: option.dest in _SHARED)
        if own:
            lines += ["| option | meaning |", "| --- | --- |"]
            lines += [f"| `{_cell(option.usage)}` | {_cell(option.field.description or '')} |" for option in own] + [""]
    return "\n".join(lines)


def metrics() -> str:
    """Return the metrics, by group."""
    groups: dict[str, list[str]] = {quantity.group: [] for quantity in QUANTITIES.values()}
    for key, quantity in QUANTITIES.items():
        unit = "" if quantity.unit == "1" else quantity.unit
        groups[quantity.group].append(f"| `{key}` | {unit} | {_cell(quantity.meaning)} |")
    lines: list[str] = []
    for group, rows in groups.items():
        lines += [f"## {group}", "", "| key | unit | meaning |", "| --- | --- | --- |", *rows, ""]
        lines += [*_GROUP_NOTES[group], ""] if group in _GROUP_NOTES else []
    return "\n".join(lines)


def _section(section: type[Section], path: str, level: int) -> list[str]:
    """Return heading, text and table of a section, then those of its subsections."""
    title = path.rstrip(".") or "Top level"
    lines = ["#" * min(level, 4) + f" {title}", "", inspect.getdoc(section) or "", ""]
    inner: list[tuple[str, type[Section]]] = []
    rows = []
    for name, field in section.model_fields.items():
        default, text = field.get_default(call_default_factory=True), field.description or ""
        if isinstance(default, Section):
            inner.append((f"{path}{name}.", type(default)))
            continue
        rows.append(f"| `{path}{name}` | {_shown(default)} | {_unit(name, text)} | {_allowed(field)} | {_cell(text)} |")
    if rows:
        heads = ["| field | default | unit | allowed | meaning |", "| --- | --- | --- | --- | --- |"]
        lines += ['<div class="fields" markdown>', "", *heads, *rows, "", "</div>", ""]  # stacked on a phone
    for below, kind in inner:
        lines += _section(kind, below, level + bool(path))
    return lines


def _unit(name: str, text: str) -> str:
    """Return the unit given by the field's name, or otherwise by its docstring."""
    numerator, per, denominator = name.partition("_per_sqrt_")
    if per:
        return ("m" if numerator.endswith("position") else "rad") + f"/√{denominator}"
    if name.endswith("_rad_per_m"):
        return "rad/m"
    if (unit := _UNITS.get(name.rpartition("_")[2])) and "_" in name:
        return unit
    found = _UNIT_IN_TEXT.search(text)
    return found.group(1).replace("^2", "²") if found else ""


def _allowed(field: FieldInfo) -> str:
    kind, _ = kind_of(field)
    names = {float: "a number", int: "whole", bool: "true, false", str: "text"}
    found = allowed(field) or names.get(kind, "a table")
    whole = "whole, " if kind is int and found != "whole" else ""
    absent = ", or none" if type(None) in typing.get_args(field.annotation) else ""
    return f"{whole}{found}{absent}".replace("1e+09", "1e9")


def _shown(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return " ".join(_shown(entry) for entry in value)
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _changes(section: Section, base: Section, path: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in section:
        before = getattr(base, name)
        if isinstance(value, Section):
            yield from _changes(value, before, f"{path}{name}.")
        elif value != before:
            yield f"{path}{name}", value


def field_texts(cls: type) -> dict[str, str]:
    """Return the docstring under each field of a dataclass, by the field's name."""
    (definition,) = ast.parse(inspect.cleandoc("\n" + inspect.getsource(cls))).body
    assert isinstance(definition, ast.ClassDef)
    return {
        field.target.id: str(text.value.value)
        for field, text in itertools.pairwise(definition.body)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant)
    }


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
