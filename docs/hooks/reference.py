"""Pages of the reference that the package itself tells: every field of the configuration, every option."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import io
import itertools
import re
import typing
from collections.abc import Iterator
from contextlib import redirect_stdout
from typing import Annotated, Any, Literal, Union

from sixthsense.cli import COMMANDS, main
from sixthsense.config import PRESETS, Config, Section, preset
from sixthsense.evaluation.results import QUANTITIES

_UNITS = {"m": "m", "m2": "m²", "rad": "rad", "s": "s"}
_IN_TEXT = re.compile(r"(?:,| in) (m/s\^2|m/s|rad/s|m and rad|m|rad|s)[,.;:]")

_ABOUT_METRICS = """\
Flat keys: `run.metrics`, `metrics.json`, the table at the end of a run, the columns of a campaign. What cannot be
measured is left out: no errors without truth, no relations without a file of them. The error of an estimate is
estimate minus truth. `run.metrics.frame()` is a pandas frame with units and meanings.

This page is made from the package when the site is built.
""".splitlines()
_MORE = {
    "Outcome": [
        "The outcome is [in words](../concepts/index.md#how-a-run-ends), and judged by what the robot believes: a goal",
        "reached by the estimate may truly be `goal_error_m` away. Coverage is measured against [what can be",
        "seen](../concepts/exploration.md#coverage). `places_left.csv` has each place left and its reason.",
    ],
    "Accuracy": [
        "Trajectories are not aligned: the start is known. `ate_rmse_m` is of `estimate.tum`, one pose a scan, as it",
        "was believed then; relations (Kümmerle et al. 2009) judge the final trajectory.",
    ],
    "Consistency": ["See [Consistency](../concepts/consistency.md) for what they mean and how to read them."],
    "Map and way": [
        "Paths keep a [margin](../concepts/planning.md#how-far-to-keep-away) where there is room;",
        "the [guard](../concepts/planning.md#the-guard) watches every command.",
    ],
    "Time": [
        "A key scan's processing leaves sensing out. A stage's mean is all its time in the run over the key scans.",
    ],
}
_SHARED = ("config", "out", "overwrite")
_ABOUT_FIELDS = """\
A `Config` is a tree of frozen sections that check themselves. Every field is an option of `sixthsense run`
(`--laser.beams 181`), a line of a TOML file (`[laser]`, `beams = 181`) and an argument of `ss.preset`
(`laser={"beams": 181}`). A value comes from, each over the last: defaults, preset, file, options. What is
not allowed is refused in one line that names the field, what was found and what is allowed.

This page is made from the classes when the site is built.
""".splitlines()
_ABOUT_COMMANDS = """\
Exit codes: 0 done (an exploration in part, too); 1 the robot failed (stuck, collided, goal unreachable, out of time);
2 bad input, named in one line; 130 interrupted. `run`, `replay`, `calibrate` and `campaign` take every field of the
[configuration](configuration.md) as an option beside those below.
""".splitlines()


def on_files(files: Any, config: Any, **_: Any) -> Any:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    for name, text in (("configuration", configuration()), ("cli", command_line()), ("metrics", metrics())):
        files.append(File.generated(config, f"reference/{name}.md", content=text))
    return files


def configuration() -> str:
    """The page of all fields, section by section."""
    lines = ["# Configuration", "", *_ABOUT_FIELDS, ""]
    lines += _section(Config, "", 2)
    lines += ["## Presets", "", "What a preset sets over the defaults; `default` sets nothing.", ""]
    for name in PRESETS:
        changes = list(_changes(preset(name), Config(preset=name)))
        if changes:
            lines += [f"### {name}", "", "| field | value |", "| --- | --- |"]
            lines += [f"| `{field}` | {_shown(value)} |" for field, value in changes] + [""]
    return "\n".join(lines)


def command_line() -> str:
    """The page of the commands and of the options that are not the configuration's."""
    from sixthsense.cli.calibrate import Calibrate
    from sixthsense.cli.replay import Replay
    from sixthsense.cli.run import Run

    lines = ["# Command line", "", "```text", _printed("--help"), "```", ""]
    lines += [*_ABOUT_COMMANDS, ""]
    own = {"run": Run, "replay": Replay, "calibrate": Calibrate}
    for name in COMMANDS:
        lines += [f"## {name}", ""]
        if name in own:
            lines += [(inspect.getdoc(own[name]) or "").strip(), "", "| option | what |", "| --- | --- |"]
            lines += [f"| `{option}` | {_cell(text)} |" for option, text in _options(own[name])] + [""]
        else:
            lines += ["```text", _printed(name, "--help"), "```", ""]
    return "\n".join(lines)


def metrics() -> str:
    """The page of what a run measures, by its headings."""
    groups: dict[str, list[str]] = {quantity.group: [] for quantity in QUANTITIES.values()}
    for key, quantity in QUANTITIES.items():
        unit = "" if quantity.unit == "1" else quantity.unit
        groups[quantity.group].append(f"| `{key}` | {unit} | {_cell(quantity.meaning)} |")
    lines = ["# Metrics", "", *_ABOUT_METRICS, ""]
    for group, rows in groups.items():
        lines += [f"## {group}", "", "| key | unit | what |", "| --- | --- | --- |", *rows, ""]
        lines += [*_MORE[group], ""] if group in _MORE else []
    return "\n".join(lines)


def _printed(*words: str) -> str:
    with redirect_stdout(io.StringIO()) as out:
        main(list(words))
    return out.getvalue().rstrip()


def _options(command: type) -> Iterator[tuple[str, str]]:
    texts = _texts(command)
    for field in sorted(dataclasses.fields(command), key=lambda field: field.name in _SHARED):
        hint = typing.get_type_hints(command, include_extras=True)[field.name]
        extras = [e for e in getattr(hint, "__metadata__", ()) if getattr(e, "metavar", None)]
        metavar = extras[0].metavar if extras else {int: "N", float: "X"}.get(hint, "")
        if field.name == "settings":
            continue
        positional = field.name == "scene" or field.name == "log"
        flag = "--" + field.name.replace("_", "-")
        yield (metavar if positional else f"{flag} {metavar}".strip()), texts.get(field.name, "")


def _section(section: type[Section], path: str, level: int) -> list[str]:
    """Heading, text and table of a section, then those of the sections in it."""
    hints, texts, default = typing.get_type_hints(section, include_extras=True), _texts(section), section()
    title = path.rstrip(".") or "Top level"
    lines = ["#" * min(level, 4) + f" {title}", "", inspect.getdoc(section) or "", ""]
    inner: list[tuple[str, type[Section]]] = []
    rows = []
    for field in dataclasses.fields(typing.cast(Any, section)):
        hint = hints[field.name]
        if isinstance(hint, type) and issubclass(hint, Section):
            inner.append((f"{path}{field.name}.", hint))
            continue
        text = texts[field.name]
        value = _shown(getattr(default, field.name))
        rows.append(
            f"| `{path}{field.name}` | {value} | {_unit(field.name, text)} | {_allowed(hint)} | {_cell(text)} |"
        )
    if rows:
        lines += ["| field | default | unit | allowed | meaning |", "| --- | --- | --- | --- | --- |", *rows, ""]
    for below, kind in inner:
        lines += _section(kind, below, level + bool(path))
    return lines


def _texts(cls: type) -> dict[str, str]:
    """The text under each field, as the sources of the class and of those above it have it."""
    found: dict[str, str] = {}
    for one in reversed(cls.__mro__):
        if not dataclasses.is_dataclass(one):
            continue
        body = typing.cast(ast.ClassDef, ast.parse(inspect.cleandoc("\n" + inspect.getsource(one))).body[0]).body
        for field, text in itertools.pairwise(body):
            is_field = isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)
            if is_field and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[field.target.id] = inspect.cleandoc(str(text.value.value))
    return found


def _unit(name: str, text: str) -> str:
    """By the field's name, or else by its text."""
    numerator, per, denominator = name.partition("_per_sqrt_")
    if per:
        return ("m" if numerator.endswith("position") else "rad") + f"/√{denominator}"
    if name.endswith("_rad_per_m"):
        return "rad/m"
    if (unit := _UNITS.get(name.rpartition("_")[2])) and "_" in name:
        return unit
    found = _IN_TEXT.search(text)
    return found.group(1).replace("^2", "²") if found else ""


def _allowed(hint: Any) -> str:
    origin, arguments = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        base, bounds = arguments
        return (f"{'whole, ' if base is int else ''}{bounds}").replace("1e+09", "1e9")
    if origin is Literal:
        return ", ".join(f"`{choice}`" for choice in arguments)
    if origin is Union or type(None) in arguments:
        return f"{_allowed(arguments[0])}, or none"
    if origin is tuple:
        kinds = {_allowed(argument) for argument in arguments}
        return f"{len(arguments)} numbers" + (f", each {kinds.pop()}" if kinds != {"a number"} else "")
    return {float: "a number", int: "whole", bool: "true, false", str: "text"}[hint]


def _shown(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, tuple):
        return " ".join(_shown(entry) for entry in value)
    if isinstance(value, bool):
        return str(value).lower()
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _changes(section: Section, base: Section, path: str = "") -> Iterator[tuple[str, Any]]:
    for field in dataclasses.fields(typing.cast(Any, section)):
        value, before = getattr(section, field.name), getattr(base, field.name)
        if isinstance(value, Section):
            yield from _changes(value, before, f"{path}{field.name}.")
        elif value != before:
            yield f"{path}{field.name}", value


def _cell(text: str) -> str:
    return " ".join(text.split()).replace("|", "\\|")
