"""The help of a command: on one page, of one section, or complete."""

from __future__ import annotations

import dataclasses
import inspect
import re
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

from sixthsense.cli.options import Option, Options, options_of
from sixthsense.config import preset
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.section import shown

EVERYTHING = "all"
"""the topic that is the complete help"""

_WIDTH = 80
_TEXT_COLUMN = 26


def help_topic(args: Sequence[str]) -> str | None:
    """What help is asked for: "" for the short one, a section or field, "all"; None if it is not asked for."""
    for word, following in zip(args, [*args[1:], ""], strict=False):
        if word in ("-h", "--help"):
            return "" if following.startswith("-") else following
        if word.startswith("--help="):
            return word.removeprefix("--help=")
    return None


def help_text(name: str, command: type[Options], topic: str = "") -> str:
    """The help of a command on a topic, at most 80 columns wide; InputError for an unknown topic."""
    known = [option for option in options_of(command, preset(command.base)) if _root(option) not in command.refused]
    own = sorted((option for option in known if option.owner is command), key=lambda option: not option.is_positional)
    words = [f"usage: sixthsense {name}", *(usage(option) for option in own if option.is_positional)]
    words += ["[options]"] if any(not option.is_positional for option in own) else []
    head = [" ".join(words), ""]
    for paragraph in (inspect.getdoc(command) or "").split("\n\n"):
        head += [*_wrapped(paragraph), ""]
    if "settings" not in {field.name for field in dataclasses.fields(command)}:
        return "\n".join([*head, *_rows(own)]).rstrip()
    taken = {option.name for option in own}
    fields = [option for option in known if option.owner is not command and option.name not in taken]
    sections = {path: list(found) for path, found in groupby(fields, lambda option: option.name.rpartition(".")[0])}
    top = sections.pop("")
    if topic in ("", EVERYTHING):
        is_brief = not topic
        lines = [*head, "options:", *_rows(own, is_brief), "", "settings:", *_rows(top, is_brief)]
        return "\n".join([*lines, *(_section_list(sections) if is_brief else _pages(sections))])
    wanted = topic.removeprefix("--").replace("-", "_")
    pages = {path: found for path, found in sections.items() if f"{path}.".startswith(f"{wanted}.")}
    if pages:
        return "\n".join(_pages(pages)).strip()
    found = [option for option in known if wanted in (option.name, option.name.rpartition(".")[2])]
    if not found:
        names = [path for path in sections if "." not in path]
        near = nearest(wanted, [*names, EVERYTHING, *(option.name for option in known)])
        raise InputError("help", f"found {shown(topic)}", ", ".join([*names, EVERYTHING]) + ", or an option", near)
    return "\n".join(_rows(found))


def usage(option: Option) -> str:
    """Flag and value of an option."""
    return option.metavar if option.is_positional else f"{option.flag} {option.metavar}".rstrip()


def brief(option: Option) -> str:
    """The first sentence of an option's text, without the full stop."""
    return re.split(r"(?<=\.) ", option.text)[0].removesuffix(".")


def default_text(value: Any) -> str:
    """The default of an option, empty if that is none or false."""
    if value is None or value is False:
        return ""
    if isinstance(value, tuple):
        return " ".join(map(default_text, value))
    return f"{value:.4g}" if isinstance(value, float) else "true" if value is True else str(value)


def _root(option: Option) -> str:
    return option.name.partition(".")[0]


def _rows(options: Sequence[Option], is_brief: bool = False) -> Iterator[str]:
    """The lines of options; in brief the first sentence and the default, else the whole text and the allowed values."""
    for option in options:
        default = default_text(option.default)
        notes = [f"default {default}" if default not in ("", "default") else ""]
        if not is_brief:
            notes.append(f"allowed: {option.allowed}" if option.allowed else "")
        text, note = brief(option) if is_brief else option.text, "; ".join(filter(None, notes))
        yield from _columns(usage(option), f"{text} ({note})" if note else text)


def _columns(left: str, text: str) -> list[str]:
    left = f"  {left}"
    indent = " " * _TEXT_COLUMN
    if len(left) >= _TEXT_COLUMN:
        return [left, *_wrapped(text, indent)]
    return _wrapped(text, indent, left.ljust(_TEXT_COLUMN)) or [left]


def _wrapped(text: str, indent: str = "", first: str | None = None) -> list[str]:
    first = indent if first is None else first
    text = " ".join(text.split())
    return textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)


def _section_list(sections: dict[str, list[Option]]) -> Iterator[str]:
    """The sections of the configuration, a line each."""
    yield from ("", "sections of further settings:")
    for path, (option, *_) in sections.items():
        if "." not in path:
            text = " ".join((inspect.getdoc(option.owner) or "").split())
            title = re.split(r"[.:;] ", re.sub(r" \(.*\)", "", text))[0].removesuffix(".")
            line = f"  {path}".ljust(_TEXT_COLUMN) + title
            yield line if len(line) <= _WIDTH else line[: _WIDTH - 4].rpartition(" ")[0] + " ..."
    yield from ("", f"`--help SECTION` lists a section's settings, `--help {EVERYTHING}` lists everything.")


def _pages(sections: dict[str, list[Option]]) -> Iterator[str]:
    """All that is known of sections."""
    for path, options in sections.items():
        yield from ("", f"{path.replace('_', '-')}:", *_wrapped(inspect.getdoc(options[0].owner) or "", "  "))
        yield from _rows(options)
