"""The help of a command: on one page, of one section, or complete."""

from __future__ import annotations

import argparse
import inspect
import re
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any

from sixthsense.cli.options import Option, Options
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.section import allowed, shown

_WIDTH, _TEXT_COLUMN = 80, 26


class Help(argparse.Action):
    """`--help [TOPIC]`: print the help of a command on a topic, and end."""

    command: type[Options]

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, topic: Any, flag: str | None = None) -> None:
        """Print the short help, that of a section or an option, or for `all` the complete one."""
        print("\n".join(_lines(parser, self.command, topic or "")).rstrip())
        raise SystemExit(0)


def brief(text: str | None) -> str:
    """The first sentence of a text, without the full stop."""
    return re.split(r"(?<=\.) ", " ".join((text or "").split()))[0].removesuffix(".")


def _lines(parser: argparse.ArgumentParser, command: type[Options], topic: str) -> Iterator[str]:
    """The lines of a help, at most 80 columns wide; InputError for an unknown topic."""
    known = [option for option in parser._actions if isinstance(option, Option)]
    known = [option for option in known if option.dest.partition(".")[0] not in command.refused]
    own = sorted((o for o in known if issubclass(o.owner, Options)), key=lambda option: bool(option.option_strings))
    fields = groupby((o for o in known if not issubclass(o.owner, Options)), lambda o: o.dest.rpartition(".")[0])
    sections = {path: list(options) for path, options in fields} if "settings" in command.model_fields else {}
    wanted = topic.removeprefix("--").replace("-", "_")
    if topic in ("", "all"):
        words = [parser.prog, *(o.usage for o in own if not o.option_strings)]
        yield from (f"usage: {' '.join(words)}{' [options]' if own and own[-1].option_strings else ''}", "")
        for paragraph in (inspect.getdoc(command) or "").split("\n\n"):
            yield from (*_wrapped(paragraph), "")
        is_brief = not topic and bool(sections)
        yield from ("options:", *_rows(own, is_brief)) if sections else _rows(own)
        yield from ("", "settings:", *_rows(sections.pop(""), is_brief)) if sections else ()
        yield from _titles(sections) if is_brief else _pages(sections)
    elif pages := {path: page for path, page in sections.items() if f"{path}.".startswith(f"{wanted}.")}:
        yield from list(_pages(pages))[1:]
    elif found := [option for option in known if wanted in (option.dest, option.dest.rpartition(".")[2])]:
        yield from _rows(found)
    else:
        names = [*(path for path in sections if path and "." not in path), "all"]
        near = nearest(wanted, [*names, *(option.dest for option in known)])
        raise InputError("help", f"found {shown(topic)}", f"{', '.join(names)}, or an option", near)


def _rows(options: Sequence[Option], is_brief: bool = False) -> Iterator[str]:
    """The lines of options; in brief the first sentence and the default, else the whole text and the allowed values."""
    for option in options:
        default = _default(option.value)
        notes = [f"default {default}" if default not in ("", "default") else ""]
        bounds = "" if is_brief or "numbers" in (text := allowed(option.field)) or text == "a list" else text
        note = "; ".join(filter(None, [*notes, f"allowed: {bounds}" if bounds else ""]))
        text = brief(option.field.description) if is_brief else option.field.description or ""
        left, text = f"  {option.usage}", f"{text} ({note})" if note else text
        if len(left) >= _TEXT_COLUMN:
            yield from (left, *_wrapped(text, " " * _TEXT_COLUMN))
        else:
            yield from _wrapped(text, " " * _TEXT_COLUMN, left.ljust(_TEXT_COLUMN)) or [left]


def _default(value: Any) -> str:
    """The default of an option, empty if that is none or false."""
    if value is None or value is False:
        return ""
    if isinstance(value, tuple):
        return " ".join(map(_default, value))
    return f"{value:.4g}" if isinstance(value, float) else "true" if value is True else str(value)


def _wrapped(text: str, indent: str = "", first: str | None = None) -> list[str]:
    first = indent if first is None else first
    text = " ".join(text.split())
    return textwrap.wrap(text, _WIDTH, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)


def _titles(sections: dict[str, list[Option]]) -> Iterator[str]:
    """The sections of the configuration, a line each."""
    yield from ("", "sections of further settings:")
    for path, (option, *_) in sections.items():
        if "." not in path:
            text = re.sub(r" \(.*\)", "", " ".join((inspect.getdoc(option.owner) or "").split()))
            line = f"  {path}".ljust(_TEXT_COLUMN) + re.split(r"[.:;] ", text)[0].removesuffix(".")
            yield line if len(line) <= _WIDTH else line[: _WIDTH - 4].rpartition(" ")[0] + " ..."
    yield from ("", "`--help SECTION` lists a section's settings, `--help all` lists everything.")


def _pages(sections: dict[str, list[Option]]) -> Iterator[str]:
    """All that is known of sections."""
    for path, options in sections.items():
        yield from ("", f"{path.replace('_', '-')}:", *_wrapped(inspect.getdoc(options[0].owner) or "", "  "))
        yield from _rows(options)
