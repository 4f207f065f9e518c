"""The help of commands that accept every field of the configuration: on one page, of one section, or complete."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
import typing
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from sixthsense.cli.options import Options, Shown, notes_of, option_types, unwrapped
from sixthsense.config import Section, preset
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.names import Names
from sixthsense.config.section import Range, field_texts, shown

EVERYTHING = "all"
"""the topic that is the complete help"""

_WIDTH = 80
_TEXT_COLUMN = 26
_POINTS = {2: "X Y", 3: "X Y THETA", 4: "X0 Y0 X1 Y1"}
_METAVARS = {int: "N", float: "X", str: "NAME", Path: "FILE"}


@dataclass(frozen=True, slots=True)
class Option:
    """An option as the help shows it."""

    name: str
    """dotted name of the field, with dashes"""
    usage: str
    """flag and value"""
    text: str
    """meaning; its first sentence stands alone in the short help"""
    default: str
    """value without the option, empty if that is none or false"""
    allowed: str
    """allowed values, empty if the kind of the value says it all"""
    choices: tuple[str, ...] = ()
    """the values, if they can be listed"""
    is_path: bool = False
    """whether the value is a file or folder"""
    takes_value: bool = True
    """whether a value follows the flag"""
    is_positional: bool = False
    """an argument without a flag"""

    @property
    def brief(self) -> str:
        """The first sentence of its text, without the full stop."""
        return re.split(r"(?<=\.) ", self.text)[0].removesuffix(".")


def help_topic(args: Sequence[str]) -> str | None:
    """What help is asked for: "" for the short one, a section or field, "all"; None if it is not asked for."""
    for word, following in zip(args, [*args[1:], ""], strict=False):
        if word in ("-h", "--help"):
            return "" if following.startswith("-") else following
        if word.startswith("--help="):
            return word.removeprefix("--help=")
    return None


def command_class(name: str) -> type[Options]:
    """The dataclass of a command's options."""
    found: type[Options] = getattr(import_module(f"sixthsense.cli.{name}"), name.capitalize())
    return found


def help_text(name: str, topic: str = "") -> str:
    """The help of a command on a topic, at most 80 columns wide; InputError for an unknown topic."""
    command = command_class(name)
    own = sorted(own_options(command), key=lambda option: not option.is_positional)
    words = [f"usage: sixthsense {name}", *(option.usage for option in own if option.is_positional)]
    words += ["[options]"] if any(not option.is_positional for option in own) else []
    head = [" ".join(words), ""]
    for paragraph in (inspect.getdoc(command) or "").split("\n\n"):
        head += [*_wrapped(paragraph), ""]
    if "settings" not in {field.name for field in dataclasses.fields(command)}:
        return "\n".join([*head, *_rows(own)]).rstrip()
    sections = {
        path: (section, list(_section_options(section, path, value)))
        for path, section, value in _sections(preset(command.base))
        if path.split(".")[0] not in command.refused
    }
    taken = {*(name.replace("_", "-") for name in command.refused), *(option.name for option in own)}
    top = [option for option in sections[""][1] if option.name not in taken]
    within = {path: found for path, found in sections.items() if path}
    if topic == "":
        rows = [*head, "options:", *_rows(own, brief=True), "", "settings:", *_rows(top, brief=True), ""]
        return "\n".join([*rows, *_section_list(within)])
    if topic == EVERYTHING:
        rows = [*head, "options:", *_rows(own), "", "settings:", *_rows(top)]
        return "\n".join([*rows, *(line for path, found in within.items() for line in _section_page(path, *found))])
    wanted = topic.removeprefix("--").replace("_", "-")
    pages = [_section_page(path, *found) for path, found in within.items() if f"{path}.".startswith(f"{wanted}.")]
    if pages:
        return "\n".join(line for page in pages for line in page).strip()
    known = [*own, *(option for _, options in sections.values() for option in options)]
    found_options = [option for option in known if wanted in (option.name, option.name.rpartition(".")[2])]
    if not found_options:
        names = [path for path in within if "." not in path]
        near = nearest(wanted, [*names, EVERYTHING, *(option.name for option in known)])
        raise InputError("help", f"found {shown(topic)}", ", ".join([*names, EVERYTHING]) + ", or an option", near)
    return "\n".join(_rows(found_options))


def own_options(command: type[Options]) -> Iterator[Option]:
    """The options of a command's dataclass that it does not refuse, without the configuration."""
    texts, defaults = field_texts(command), {field.name: field.default for field in dataclasses.fields(command)}
    for name, hint in option_types(command).items():
        if name not in command.refused:
            default = defaults[name]
            yield option_of(name, hint, None if default == () else default, texts.get(name, ""))


def config_options(settings: Section) -> Iterator[Option]:
    """The options of all fields of the configuration; `settings` has the default values."""
    for path, section, value in _sections(settings):
        yield from _section_options(section, path, value)


def _sections(section: Section, path: str = "") -> Iterator[tuple[str, type[Section], Section]]:
    """The dotted name, the class and the values of a section and of those in it."""
    yield path, type(section), section
    for field in dataclasses.fields(typing.cast(Any, section)):
        value = getattr(section, field.name)
        if isinstance(value, Section):
            yield from _sections(value, f"{path}.{field.name.replace('_', '-')}".lstrip("."))


def _section_options(section: type[Section], path: str, values: Section) -> Iterator[Option]:
    texts = field_texts(section)
    for name, hint in typing.get_type_hints(section, include_extras=True).items():
        if not isinstance(getattr(values, name), Section):
            yield option_of(f"{path}.{name}".lstrip("."), hint, getattr(values, name), texts.get(name, ""))


def option_of(name: str, hint: Any, default: Any = None, text: str = "") -> Option:
    """The option for a field: its name, its annotated type, its default value and its docstring."""
    name = name.replace("_", "-")
    shown_as = next(iter(notes_of(hint, Shown)), Shown())
    bounds: Any = next(iter([*notes_of(hint, Range), *notes_of(hint, Names)]), "")
    hint, _ = unwrapped(hint)
    choices = typing.get_args(hint) if typing.get_origin(hint) is Literal else ()
    choices = tuple(bounds) if isinstance(bounds, Names) else choices
    metavar = shown_as.metavar or _metavar(hint, default)
    return Option(
        name,
        metavar if shown_as.is_positional else f"--{name} {metavar}".rstrip(),
        text,
        _value(default),
        ", ".join(map(str, choices)) if choices else str(bounds),
        tuple(map(str, choices)) or (("true", "false") if hint is bool and default is True else ()),
        hint is Path or metavar in ("FILE", "DIR"),
        bool(metavar),
        shown_as.is_positional,
    )


def _metavar(hint: Any, default: Any) -> str:
    if hint is bool:
        return "true|false" if default is True else ""
    if typing.get_origin(hint) is tuple:
        kinds = typing.get_args(hint)
        return "X Y ..." if kinds[-1] is Ellipsis else _POINTS.get(len(kinds), " ".join("X" * len(kinds)))
    return _METAVARS.get(hint, "NAME")


def _value(value: Any) -> str:
    if value is None or value is False:
        return ""
    if isinstance(value, tuple):
        return " ".join(map(_value, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value).lower() if value is True else str(value)


def _rows(options: Sequence[Option], brief: bool = False) -> Iterator[str]:
    """The lines of options; in brief the first sentence and the default, else the whole text and the allowed values."""
    for option in options:
        default = f"default {option.default}" if option.default not in ("", "default") else ""
        if brief:
            text, note = option.brief, default
        else:
            text = option.text
            note = "; ".join(part for part in (default, f"allowed: {option.allowed}" if option.allowed else "") if part)
        yield from _columns(option.usage, f"{text} ({note})" if note else text)


def _columns(left: str, text: str) -> list[str]:
    left = f"  {left}"
    indent = " " * _TEXT_COLUMN
    if len(left) >= _TEXT_COLUMN:
        return [left, *_wrapped(text, indent)]
    return _wrapped(text, indent, left.ljust(_TEXT_COLUMN)) or [left]


def _wrapped(text: str, indent: str = "", first: str | None = None) -> list[str]:
    text = " ".join(text.split())
    return textwrap.wrap(
        text, _WIDTH, initial_indent=indent if first is None else first, subsequent_indent=indent,
        break_on_hyphens=False,
    )  # fmt: skip


def _section_list(sections: dict[str, tuple[type[Section], list[Option]]]) -> Iterator[str]:
    """The sections of the configuration, a line each."""
    yield "sections of further settings:"
    for path, (section, _) in sections.items():
        if "." not in path:
            text = " ".join((inspect.getdoc(section) or "").split())
            title = re.split(r"[.:;] ", re.sub(r" \(.*\)", "", text))[0].removesuffix(".")
            yield _one_line(path, title)
    yield ""
    yield f"`--help SECTION` lists a section's settings, `--help {EVERYTHING}` lists everything."


def _one_line(left: str, text: str) -> str:
    line = f"  {left}".ljust(_TEXT_COLUMN) + text
    return line if len(line) <= _WIDTH else line[: _WIDTH - 4].rpartition(" ")[0] + " ..."


def _section_page(path: str, section: type[Section], options: list[Option]) -> list[str]:
    return ["", f"{path}:", *_wrapped(inspect.getdoc(section) or "", "  "), *_rows(options)]
