"""The help of a command: on one page, of one section, or complete."""

from __future__ import annotations

import argparse
import inspect
import re
import textwrap
from collections.abc import Iterator, Sequence
from itertools import groupby
from typing import Any, cast

from sixthsense.cli.options import Option, Options, Parser
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.section import allowed, shown

_WIDTH, _TEXT_COLUMN = 80, 26


class Help(argparse.Action):
    """`--help [TOPIC]`: print the help of a command on a topic, and end."""

    command: type[Options]

    def __call__(self, parser: argparse.ArgumentParser, namespace: Any, topic: Any, flag: str | None = None) -> None:
        """Print the short help, that of a section, or for `all` the complete one."""
        print("\n".join(_lines(cast(Parser, parser), self.command, topic or "")).rstrip())
        raise SystemExit(0)


def brief(text: str | None) -> str:
    """The first sentence of a text, without the full stop."""
    return re.split(r"(?<=\.) ", " ".join((text or "").split()))[0].removesuffix(".")


def _lines(parser: Parser, command: type[Options], topic: str) -> Iterator[str]:
    """The lines of a help, at most 80 columns wide; InputError for an unknown topic."""
    known = [option for option in parser.options if option.dest.partition(".")[0] not in command.refused]
    own = sorted((o for o in known if issubclass(o.owner, Options)), key=lambda option: bool(option.option_strings))
    fields = groupby((o for o in known if not issubclass(o.owner, Options)), lambda o: o.dest.rpartition(".")[0])
    sections = {path: list(options) for path, options in fields} if "settings" in command.model_fields else {}
    wanted, is_brief = topic.replace("-", "_"), not topic and bool(sections)
    if topic in ("", "all"):
        usage = [f"usage: {parser.prog}", *(o.usage for o in own if not o.option_strings), "[options]" * bool(own)]
        for paragraph in (" ".join(usage), *(inspect.getdoc(command) or "").split("\n\n")):
            yield from (*_wrapped(paragraph), "")
        yield from _rows(own, is_brief)
        if sections:
            yield from ("", "settings:", *_rows(sections.pop(""), is_brief), "")
        yield from _titles(sections) if is_brief else _pages(sections)
    elif pages := {path: page for path, page in sections.items() if f"{path}.".startswith(f"{wanted}.")}:
        yield from _pages(pages)
    else:
        names = [*(path for path in sections if path and "." not in path), "all"]
        raise InputError("help", f"found {shown(topic)}", ", ".join(names), nearest(wanted, names))


def _rows(options: Sequence[Option], is_brief: bool = False) -> Iterator[str]:
    """The lines of options; in brief the first sentence and the default, else the whole text and the allowed values."""
    for option in options:
        text = brief(option.field.description) if is_brief else option.field.description or ""
        notes = {"default ": option.default_text, "allowed: ": "" if is_brief else allowed(option.field)}
        note = "; ".join(name + value for name, value in notes.items() if value)
        yield from _row(option.usage, f"{text} ({note})" if note else text)


def _row(left: str, text: str) -> Iterator[str]:
    """The lines of a text in the right column, beside or below what is `left` of it."""
    first, indent = f"  {left}".ljust(_TEXT_COLUMN), " " * _TEXT_COLUMN
    is_long = len(first) > _TEXT_COLUMN
    yield from [first.rstrip()] * (is_long or not text) + _wrapped(text, indent, indent if is_long else first)


def _wrapped(text: str, indent: str = "", first: str = "") -> list[str]:
    wrapper = textwrap.TextWrapper(_WIDTH, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)
    return wrapper.wrap(" ".join(text.split()))


def _titles(sections: dict[str, list[Option]]) -> Iterator[str]:
    """The sections of the configuration and what each is about."""
    yield "sections of further settings:"
    for path, (option, *_) in sections.items():
        yield from _row(path, re.split("[.:;(]", inspect.getdoc(option.owner) or "")[0]) if "." not in path else ()
    yield from ("", "`--help SECTION` lists a section's settings, `--help all` lists everything.")


def _pages(sections: dict[str, list[Option]]) -> Iterator[str]:
    """All that is known of sections."""
    for path, options in sections.items():
        yield f"{path.replace('_', '-')}:"
        yield from (*_wrapped(inspect.getdoc(options[0].owner) or "", "  ", "  "), *_rows(options), "")
