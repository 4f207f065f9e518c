"""Words of a command line as values: a command's own options, and every field of the Config tree as a flag.

Values are only read here; whether they are allowed is for the validator of `config` to say, as it does for a file, so
that both complain alike. The parser is our own because tyro, which prints the help, answers a mistake with a framed
page and exits, where our commands print one line that names what is allowed.
"""

from __future__ import annotations

import contextlib
import re
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Union

from sixthsense.config import Config, Section
from sixthsense.config.errors import InputError
from sixthsense.config.section import is_one_line, shown, shown_name

Table = dict[str, Any]

_TRUTHS = {"true": True, "false": False}


@dataclass(frozen=True, slots=True)
class OrAlone:
    """The type of an option that may stand alone: the word after it is its value only if it looks like one."""

    alone: str | None
    """its value where it does"""
    is_value: Callable[[str], bool]
    """whether a word after it is its value"""
    allowed: str
    """what its value may be, in words"""


class UsageError(InputError):
    """One line for a command line that will not do."""


def parse(args: Sequence[str], own: Mapping[str, Any], place: str) -> tuple[Table, Table]:
    """Read a command's words: its own options, and the nested table of the Config fields that the others set.

    `own` gives the type of each own option by name, `place` names the one that stands by itself. Raises UsageError,
    listing what is allowed, for an option that does not exist, a flag without a value and a second word for `place`.
    """
    hints = {f"--{name}": hint for name, hint in own.items()} | dict(_flags(Config))
    given: Table = {}
    table: Table = {}
    alone: tuple[str, OrAlone] | None = None  # an option that the word before has left without a value
    words = list(reversed(args))  # the next one last
    while words:
        word = words.pop()
        if not word.startswith("-"):
            if place in given:
                if alone is not None:
                    raise UsageError(f"{alone[0]}: found {shown(word)}, allowed: {alone[1].allowed}")
                raise UsageError(f"{place}: found {shown(given[place])} and {shown(word)}, allowed: one")
            given[place] = _name(place, word)
            continue
        flag, value = _option(word, words, hints)
        hint = hints[flag]
        alone = (flag, hint) if isinstance(hint, OrAlone) and word == flag else None
        *sections, name = flag.removeprefix("--").split(".")
        target = given if not sections and name in own else table
        for section in sections:
            target = target.setdefault(section, {})
        target[name] = value
    return given, table


def words(args: Sequence[str], own: Mapping[str, Any]) -> tuple[list[str], Table]:
    """Read the words of a command that takes any number of them, and no field of the Config tree.

    `own` gives the type of each option by name. Returns the words that stand by themselves, and the options given.
    Raises UsageError, listing what is allowed, for an option that does not exist and a flag without a value.
    """
    hints = {f"--{name}": hint for name, hint in own.items()}
    rest = list(reversed(args))  # the next one last
    plain: list[str] = []
    given: Table = {}
    while rest:
        word = rest.pop()
        if word.startswith("-"):
            flag, value = _option(word, rest, hints)
            given[flag.removeprefix("--")] = value
        else:
            plain.append(_name("run", word))
    return plain, given


def _flags(section: type[Section], path: str = "--") -> Iterator[tuple[str, Any]]:
    """Every field of the Config tree as a flag, and its type."""
    for name, hint in typing.get_type_hints(section, include_extras=True).items():
        flag = path + name.replace("_", "-")
        if isinstance(hint, type) and issubclass(hint, Section):
            yield from _flags(hint, flag + ".")
        else:
            yield flag, hint


def _option(word: str, words: list[str], hints: Mapping[str, Any]) -> tuple[str, Any]:
    """The flag that `word` is, and its value, taken from it or from `words`; UsageError for no flag of `hints`."""
    flag, equals, text = word.partition("=")
    flag = flag.replace("_", "-")
    if flag not in hints:
        positive = re.sub(r"^(--|.*[.])no-", r"\1", flag)
        if hints.get(positive) is bool and not equals:
            return positive, False
        raise UsageError(f"{shown_name(flag)}: no such option, allowed: {', '.join(_near(flag, hints))}")
    hint, optional = hints[flag], False
    if isinstance(hint, OrAlone):
        if equals:
            return flag, _name(flag, text)
        return flag, _name(flag, words.pop()) if words and hint.is_value(words[-1]) else hint.alone
    while typing.get_origin(hint) in (Annotated, Union, UnionType):
        optional |= typing.get_origin(hint) is not Annotated
        hint = typing.get_args(hint)[0]
    if hint is bool:
        if not equals:
            text = words.pop() if words and words[-1].lower() in _TRUTHS else "true"
        if text.lower() not in _TRUTHS:
            raise UsageError(f"{flag}: found {shown(text)}, allowed: true or false")
        return flag, _TRUTHS[text.lower()]
    is_tuple = typing.get_origin(hint) is tuple
    kinds = typing.get_args(hint) if is_tuple else (hint,)
    texts = [text] if equals else []
    while words and len(texts) < len(kinds) and not words[-1].startswith("--"):
        texts.append(words.pop())
        if optional and texts == ["None"]:
            return flag, None
    if not texts:
        raise UsageError(f"{flag}: found nothing, allowed: {len(kinds)} value{'s' * is_tuple}")
    values = [_value(flag, kind, text) for kind, text in zip(kinds, texts, strict=False)]
    return flag, values if is_tuple else values[0]


def _near(flag: str, hints: Mapping[str, Any]) -> list[str]:
    """The flags within the section that `flag` names, or else beside it, or else at the top."""
    path = flag.rpartition(".")[0]
    within = [known for known in hints if known.startswith(flag + ".")]
    beside = [known for known in hints if known.rpartition(".")[0] == path]
    return within or beside or [known for known in hints if "." not in known]


def _value(flag: str, kind: Any, text: str) -> Any:
    """A word as what it stands for; where it is no such thing, as it is, for the validator to show."""
    if kind is Path:
        return Path(_name(flag, text))
    if kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _name(where: str, text: str) -> str:
    """A word that names a file or a scene, if it can be printed, and be written into the run's configuration."""
    if not is_one_line(text):
        raise UsageError(f"{where}: found {shown(text)}, allowed: a name without line breaks or control characters")
    return text
