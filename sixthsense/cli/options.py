"""The parser of command lines: a command's own options, and every field of the Config tree as a flag.

A command's options are the fields of a dataclass. The parser converts values; the validator of `config` checks them, so
that flags and files give the same messages.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
import typing
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, TypeVar, Union

from sixthsense.config import Config, Section
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.section import checked, is_one_line, shown, shown_name

T = TypeVar("T")
Table = dict[str, Any]

_BOOLEANS = {"true": True, "false": False}


@dataclass(frozen=True, slots=True)
class Shown:
    """How the help shows an option, an annotation of its type."""

    metavar: str = ""
    """name of its value"""
    is_positional: bool = False
    """an argument without a flag"""


def arg(metavar: str) -> Shown:
    """The annotation of an option whose value the help calls `metavar`."""
    return Shown(metavar)


def positional(metavar: str) -> Shown:
    """The annotation of the positional argument, or of all of them where its type is a list."""
    return Shown(metavar, is_positional=True)


@dataclass(frozen=True, slots=True)
class OptionalValue:
    """The annotation of an option with an optional value: the next argument is its value if `is_value` accepts it."""

    default: str | None
    """value of the option when none is given"""
    is_value: Callable[[str], bool]
    """whether the next argument is the option's value"""
    allowed: str
    """allowed values, for messages"""


@dataclass(frozen=True)
class Options:
    """The options of a command: a field each, whose docstring is its text in the help."""

    takes_fields: ClassVar[bool] = False
    """whether every field of the configuration is an option as well"""
    base: ClassVar[str] = "default"
    """the preset whose values the help shows"""
    refused: ClassVar[tuple[str, ...]] = ()
    """options, and fields and sections of the configuration, that the help leaves out"""


def option_types(command: type[Options]) -> dict[str, Any]:
    """The annotated type of each of a command's own options, by name."""
    hints = typing.get_type_hints(command, include_extras=True)
    return {field.name: hints[field.name] for field in dataclasses.fields(command) if field.name != "settings"}


def positional_of(command: type[Options]) -> str:
    """The name of a command's positional option, empty if there is none."""
    hints = option_types(command).items()
    return next((name for name, hint in hints if any(note.is_positional for note in notes_of(hint, Shown))), "")


def unwrapped(hint: Any) -> tuple[Any, bool]:
    """A type without its annotations and None, and whether it may be None."""
    is_optional = False
    while typing.get_origin(hint) in (Annotated, Union, UnionType):
        is_optional |= typing.get_origin(hint) is not Annotated
        hint = typing.get_args(hint)[0]
    return hint, is_optional


def notes_of(hint: Any, kind: type[T]) -> list[T]:
    """The annotations of one kind of a type, the outermost first."""
    found: list[T] = []
    while typing.get_origin(hint) in (Annotated, Union, UnionType, tuple):
        found += [note for note in getattr(hint, "__metadata__", ()) if isinstance(note, kind)]
        hint = typing.get_args(hint)[0]
    return found


def parse(args: Sequence[str], command: type[Options]) -> tuple[Table, Table]:
    """Parse a command's arguments into its own options, checked, and the nested table of the Config fields.

    Raises InputError with the allowed values for an unknown option, a flag without a value and a positional argument
    too many; InputError for a value of an own option that is not allowed.
    """
    own, positional = option_types(command), positional_of(command)
    rest = own.pop(positional, None)
    takes_many = typing.get_origin(unwrapped(rest)[0]) is tuple
    hints = dict(config_flags(Config)) if command.takes_fields else {}
    hints |= {flag_of(name): hint for name, hint in own.items()}
    given: Table = {}
    table: Table = {}
    without_value: tuple[str, OptionalValue] | None = None  # the previous argument, if an option that took no value
    stack = list(reversed(args))  # the next word is the last element
    while stack:
        word = stack.pop()
        if not word.startswith("-"):
            if not positional:
                raise InputError("arguments", f"found {shown(word)}", "options alone")
            if takes_many:
                given[positional] = (*given.get(positional, ()), _checked_name(positional, word))
                continue
            if positional in given:
                if without_value is not None:
                    raise InputError(without_value[0], f"found {shown(word)}", f"{without_value[1].allowed}")
                raise InputError(positional, f"found {shown(given[positional])} and {shown(word)}", "one")
            given[positional] = _checked_name(positional, word)
            continue
        flag, value = _option(word, stack, hints)
        may_lack = notes_of(hints[flag], OptionalValue)
        without_value = (flag, may_lack[0]) if may_lack and word == flag else None
        *sections, name = flag.removeprefix("--").replace("-", "_").split(".")
        if not sections and name in own:
            if name in given and isinstance(value, list):
                raise InputError(flag, "found twice", "once, with all its values")
            given[name] = value
            continue
        target = table
        for section in sections:
            target = target.setdefault(section, {})
        target[name] = value
    for name, hint in own.items():
        if name in given:
            given[name] = checked(name, hint, given[name])
    return given, table


def as_options(text: str) -> str:
    """A line for the terminal: names of fields and arguments, which are in backquotes, as options."""
    return re.sub(r"`([a-z_.]+)`", lambda found: flag_of(found[1]), text)


def flag_of(name: str) -> str:
    """The option that sets a field, by its dotted name."""
    return f"--{name.replace('_', '-')}"


def with_options(error: InputError, command: type[Options]) -> str:
    """What an error says, with the option in place of the field where that is one of the command's."""
    flags = {flag_of(name) for name in option_types(command) if name != positional_of(command)}
    if command.takes_fields:
        flags |= {flag for flag, _ in config_flags(Config)} - {flag_of(positional_of(command))}
    name, *rest = re.split(r"(?=[, ])", error.where, maxsplit=1)
    is_option = any(f"{flag}.".startswith(f"{flag_of(name)}.") for flag in flags)  # a section of options, too
    where = "".join([flag_of(name), *rest]) if is_option else error.where
    return as_options(str(error.at(where)))


def config_flags(section: type[Section], path: str = "--") -> Iterator[tuple[str, Any]]:
    """The flag and the type of every field of the Config tree."""
    for name, hint in typing.get_type_hints(section, include_extras=True).items():
        flag = path + name.replace("_", "-")
        if isinstance(hint, type) and issubclass(hint, Section):
            yield from config_flags(hint, flag + ".")
        else:
            yield flag, hint


def _option(word: str, stack: list[str], hints: Mapping[str, Any]) -> tuple[str, Any]:
    """The flag and its value, taken from `word` or from `stack`; InputError for a flag not in `hints`."""
    flag, equals, text = word.partition("=")
    flag = flag.replace("_", "-")
    if flag not in hints:
        positive = re.sub(r"^(--|.*[.])no-", r"\1", flag)
        if hints.get(positive) is bool and not equals:
            return positive, False
        raise InputError(
            shown_name(flag), "no such option", ", ".join(_suggestions(flag, hints)), _nearest(flag, hints)
        )
    hint, optional = unwrapped(hints[flag])
    for may_lack in notes_of(hints[flag], OptionalValue):
        found = text if equals else stack.pop() if stack and may_lack.is_value(stack[-1]) else may_lack.default
        return flag, None if found is None else _convert(flag, hint, found)
    if hint is bool:
        if not equals:
            text = stack.pop() if stack and stack[-1].lower() in _BOOLEANS else "true"
        if text.lower() not in _BOOLEANS:
            raise InputError(flag, f"found {shown(text)}", "true or false")
        return flag, _BOOLEANS[text.lower()]
    is_tuple = typing.get_origin(hint) is tuple
    kinds = typing.get_args(hint) if is_tuple else (hint,)
    is_list = kinds[-1] is Ellipsis
    texts = [text] if equals else []
    while stack and (is_list or len(texts) < len(kinds)) and not stack[-1].startswith("--"):
        texts.append(stack.pop())
        if optional and texts == ["None"]:
            return flag, None
    if is_list:
        return flag, _list(flag, kinds[0], texts)
    if not texts:
        raise InputError(flag, "found nothing", f"{len(kinds)} value{'s' * is_tuple}")
    values = [_convert(flag, kind, text) for kind, text in zip(kinds, texts, strict=False)]
    return flag, values if is_tuple else values[0]


def _list(flag: str, kind: Any, texts: list[str]) -> list[Any]:
    """The texts as values of `kind`, or in rows of them where it is a tuple; InputError for none, and for a cut row."""
    if typing.get_origin(kind) is not tuple:
        if not texts:
            raise InputError(flag, "found nothing", "one or more values")
        return [_convert(flag, unwrapped(kind)[0], text) for text in texts]
    kinds = typing.get_args(kind)
    if not texts or len(texts) % len(kinds):
        raise InputError(flag, f"found {len(texts) or 'no'} values", f"{len(kinds)} of each entry")
    rows = [texts[k : k + len(kinds)] for k in range(0, len(texts), len(kinds))]
    return [[_convert(flag, kind, text) for kind, text in zip(kinds, row, strict=True)] for row in rows]


def _suggestions(flag: str, hints: Mapping[str, Any]) -> list[str]:
    """The flags to suggest: those in the section named `flag`, else in the same section, else those without section."""
    path = flag.rpartition(".")[0]
    within = [known for known in hints if known.startswith(flag + ".")]
    siblings = [known for known in hints if known.rpartition(".")[0] == path]
    return within or siblings or [known for known in hints if "." not in known]


def _nearest(flag: str, hints: Mapping[str, Any]) -> str:
    """The option which a misspelt one, or one without its section, may mean; "" if none is near."""
    if any(known.startswith(flag + ".") for known in hints):
        return ""  # the name of a section, whose options the message lists
    path, _, name = flag.rpartition(".")
    name = name.lstrip("-")
    of_sections = [known for known in hints if "." in known and known.rpartition(".")[2] == name]
    siblings = {known.rpartition(".")[2].lstrip("-"): known for known in hints if known.rpartition(".")[0] == path}
    if of_sections or not siblings:
        return " or ".join(of_sections) or nearest(flag, hints)
    return siblings.get(nearest(name, siblings), "")


def _convert(flag: str, kind: Any, text: str) -> Any:
    """The text converted to `kind`; unchanged if that fails, so that the validator reports it."""
    if kind is Path:
        return Path(_checked_name(flag, text))
    if kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _checked_name(where: str, text: str) -> str:
    """The name of a file or scene; InputError if it could not be printed or written into the configuration."""
    if not is_one_line(text):
        raise InputError(where, f"found {shown(text)}", "a name without line breaks or control characters")
    return text
