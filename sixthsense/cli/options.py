"""The options of commands, from which parser, help and completion follow: a command's own, and every field of Config.

A command's own options are the fields of a dataclass. The parser converts values; the validator of `config` checks
them, so that flags and files give the same messages.
"""

from __future__ import annotations

import contextlib
import dataclasses
import re
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union

from sixthsense.config import Config, Range, Section
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import KINDS, PartOptions, Parts, options_class
from sixthsense.config.section import checked, field_texts, hints_of, is_one_line, shown, shown_name

T = TypeVar("T")
Table = dict[str, Any]

_BOOLEANS = {"true": True, "false": False}
_POINTS = {2: "X Y", 3: "X Y THETA", 4: "X0 Y0 X1 Y1"}
_METAVARS = {int: "N", float: "X", str: "NAME", Path: "FILE"}


@dataclass(frozen=True, slots=True)
class Arg:
    """How an option appears on the command line, an annotation of its type."""

    metavar: str = ""
    """name of its value"""
    is_positional: bool = False
    """an argument without a flag"""


def arg(metavar: str) -> Arg:
    """The annotation of an option whose value the help calls `metavar`."""
    return Arg(metavar)


def positional(metavar: str) -> Arg:
    """The annotation of the positional argument, or of all of them where its type is a list."""
    return Arg(metavar, is_positional=True)


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

    @classmethod
    def main(cls, args: list[str]) -> int:
        """Run the command; returns the exit code."""
        raise NotImplementedError


@dataclass(frozen=True)
class Option:
    """One option, or the positional argument, of a command."""

    name: str
    """of its field, dotted within sections"""
    hint: Any
    """annotated type of the field"""
    default: Any
    """value without the option"""
    owner: type
    """the dataclass that has the field"""

    @property
    def flag(self) -> str:
        """What begins it on the command line; the name of a positional argument."""
        return self.name if self.is_positional else flag_of(self.name)

    @cached_property
    def arg(self) -> Arg:
        """How it appears on the command line."""
        return self.note(Arg) or Arg()

    @property
    def is_positional(self) -> bool:
        """Whether it is an argument without a flag."""
        return self.arg.is_positional

    @cached_property
    def kind(self) -> Any:
        """Its type without annotations and None."""
        hint = self.hint
        while typing.get_origin(hint) in (Annotated, Union, UnionType):
            hint = typing.get_args(hint)[0]
        return hint

    @property
    def items(self) -> tuple[Any, ...]:
        """The types of its values: of one, of several, or of any number where the last is an ellipsis."""
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is tuple else (self.kind,)

    def note(self, kind: type[T]) -> T | None:
        """The outermost annotation of one kind."""
        hint = self.hint
        while typing.get_origin(hint) in (Annotated, Union, UnionType, tuple):
            for note in getattr(hint, "__metadata__", ()):
                if isinstance(note, kind):
                    return note
            hint = typing.get_args(hint)[0]
        return None

    @property
    def choices(self) -> tuple[str, ...]:
        """The values, if they can be listed."""
        if (names := self.note(Parts)) is not None:
            return tuple(names)
        if self.kind is bool:
            return ("true", "false") if self.default is True else ()
        return typing.get_args(self.kind) if typing.get_origin(self.kind) is Literal else ()

    @property
    def allowed(self) -> str:
        """Allowed values, empty if the kind of the value says it all."""
        bounds = self.note(Range)
        return str(bounds) if bounds is not None else "" if self.kind is bool else ", ".join(self.choices)

    @property
    def metavar(self) -> str:
        """What the help calls its value; empty for a switch."""
        if self.arg.metavar or self.kind is bool:
            return self.arg.metavar or "|".join(self.choices)
        if self.items[-1] is Ellipsis:
            return "X Y ..."
        return _METAVARS.get(self.kind, "NAME") if len(self.items) == 1 else _POINTS[len(self.items)]

    @property
    def text(self) -> str:
        """The docstring under its field."""
        return field_texts(self.owner).get(self.name.rpartition(".")[2], "")


def options_of(command: type[Options], settings: Config | None = None) -> list[Option]:
    """A command's own options, then those of the configuration, whose defaults are in `settings`, if it takes them."""
    fields: dict[str, Any] = {field.name: field.default for field in dataclasses.fields(command)}
    hints = typing.get_type_hints(command, include_extras=True)
    own = [Option(name, hints[name], default, command) for name, default in fields.items() if name != "settings"]
    taken = {option.flag for option in own}
    others = of_section(settings or Config()) if command.takes_fields else ()
    return [*own, *(option for option in others if option.flag not in taken)]


def of_parts(config: Config) -> Iterator[Option]:
    """The options of the configured parts that are not shipped; InputError for one that cannot be imported."""
    for parts in KINDS:
        name = getattr(config, parts.kind)
        cls = None if name in parts.shipped else options_class(parts.load(name))
        if cls is not None:
            for field, hint in hints_of(cls).items():
                yield Option(f"{parts.kind}_options.{field}", hint, getattr(cls(), field), cls)


def of_section(section: Section, path: str = "") -> Iterator[Option]:
    """The options of all fields of a section, and of the sections in it, behind its own."""
    values = {name: getattr(section, name) for name in hints_of(type(section))}
    for name, value in values.items():
        if not isinstance(value, Section | PartOptions):
            yield Option(path + name, hints_of(type(section))[name], value, type(section))
    for name, value in values.items():
        if isinstance(value, Section):
            yield from of_section(value, f"{path}{name}.")


def parse(args: list[str], command: type[Options], parts: Iterable[Option] | None = None) -> tuple[Table, Table]:
    """Parse a command's arguments into its own options, checked, and the nested table of the Config fields.

    `parts` are the options of parts; None as long as they are not known: then these are passed over.
    Raises InputError with the allowed values for an unknown option, a flag without a value and a positional argument
    too many; InputError for a value of an own option that is not allowed.
    """
    options = {option.flag: option for option in (*options_of(command), *(parts or ()))}
    argument = next((option for option in options.values() if option.is_positional), None)
    own: dict[str, Option] = {}
    given: Table = {}
    table: Table = {}
    before: OptionalValue | None = None  # of the previous option, if it can be without a value
    words = args[::-1]  # the next word is the last element
    while words:
        word = words.pop()
        if parts is None and command.takes_fields and is_of_part(word):
            if "=" not in word and words and not words[-1].startswith("--"):
                words.pop()
            continue
        if word.startswith("-"):
            option, value = _read(word, words, options)
            before = option.note(OptionalValue) if word == option.flag else None
            if option.name in given and isinstance(value, list):
                raise InputError(option.name, "found twice", "once, with all its values")
        elif argument is None:
            raise InputError("arguments", f"found {shown(word)}", "options alone")
        else:
            option, value = argument, _checked_name(argument.name, word)
            if option.items[-1] is Ellipsis:
                value = (*given.get(option.name, ()), value)
            elif option.name in given:
                if before is not None:
                    raise InputError(next(reversed(own)), f"found {shown(word)}", before.allowed)
                raise InputError(option.name, f"found {shown(given[option.name])} and {shown(word)}", "one")
        if option.owner is command:
            given[option.name], own[option.name] = value, option
        else:
            *sections, name = option.name.split(".")
            target = table
            for section in sections:
                target = target.setdefault(section, {})
            target[name] = value
    return {name: checked(name, own[name].hint, value) for name, value in given.items()}, table


def is_of_part(word: str) -> bool:
    """Whether a word is an option of a part: `--estimator-options.gain`."""
    return any(word.startswith(f"--{flag_name(parts.kind)}-options.") for parts in KINDS)


def as_options(text: str) -> str:
    """A line for the terminal: names of fields and arguments, which are in backquotes, as options."""
    return re.sub(r"`([a-z_.]+)`", lambda found: flag_of(found[1]), text)


def flag_of(name: str) -> str:
    """The option that sets a field, by its dotted name."""
    return f"--{flag_name(name)}"


def flag_name(name: str) -> str:
    """A field's name as the command line has it."""
    return name.replace("_", "-")


def with_options(error: InputError, command: type[Options]) -> str:
    """What an error says, with the option in place of the field where that is one of the command's."""
    name, *rest = re.split(r"(?=[, ])", error.where, maxsplit=1)
    known = options_of(command)
    is_positional = any(option.is_positional and option.name == name for option in known)
    is_option = any(f"{option.flag}.".startswith(f"{flag_of(name)}.") for option in known)  # a section of options, too
    is_option |= command.takes_fields and is_of_part(f"{flag_of(name)}.")
    where = "".join([flag_of(name), *rest]) if is_option and not is_positional else error.where
    return as_options(str(error.at(where)))


def _read(word: str, words: list[str], options: Mapping[str, Option]) -> tuple[Option, Any]:
    """The option and its value, taken from `word` or from `words`; InputError for a flag not in `options`."""
    flag, equals, text = word.partition("=")
    flag = flag.replace("_", "-")
    if flag not in options or not flag.startswith("-"):
        positive = options.get(re.sub(r"^(--|.*[.])no-", r"\1", flag))
        if positive is not None and positive.kind is bool and not equals:
            return positive, False
        flags = [known for known in options if known.startswith("-")]
        raise InputError(
            shown_name(flag), "no such option", ", ".join(_suggestions(flag, flags)), _nearest(flag, flags)
        )
    option = options[flag]
    if (may_lack := option.note(OptionalValue)) is not None:
        found = text if equals else words.pop() if words and may_lack.is_value(words[-1]) else may_lack.default
        return option, None if found is None else _convert(option, option.kind, found)
    if option.kind is bool:
        if not equals:
            text = words.pop() if words and words[-1].lower() in _BOOLEANS else "true"
        if text.lower() not in _BOOLEANS:
            raise InputError(option.name, f"found {shown(text)}", "true or false")
        return option, _BOOLEANS[text.lower()]
    is_list = option.items[-1] is Ellipsis
    texts = [text] if equals else []
    while words and (is_list or len(texts) < len(option.items)) and not words[-1].startswith("--"):
        texts.append(words.pop())
        if texts == ["None"] and type(None) in typing.get_args(option.hint):
            return option, None
    return option, _list(option, texts) if is_list else _values(option, texts)


def _values(option: Option, texts: list[str]) -> Any:
    """The value of an option, a list where it has several."""
    is_tuple = option.items != (option.kind,)
    if not texts:
        raise InputError(option.name, "found nothing", f"{len(option.items)} value{'s' * is_tuple}")
    values = [_convert(option, kind, text) for kind, text in zip(option.items, texts, strict=False)]
    return values if is_tuple else values[0]


def _list(option: Option, texts: list[str]) -> list[Any]:
    """The values of a list, in rows where it has such; InputError for none, and for a cut row."""
    kind = option.items[0]
    if typing.get_origin(kind) is not tuple:
        if not texts:
            raise InputError(option.name, "found nothing", "one or more values")
        return [_convert(option, kind, text) for text in texts]
    kinds = typing.get_args(kind)
    if not texts or len(texts) % len(kinds):
        raise InputError(option.name, f"found {len(texts) or 'no'} values", f"{len(kinds)} of each entry")
    rows = [texts[k : k + len(kinds)] for k in range(0, len(texts), len(kinds))]
    return [[_convert(option, kind, text) for kind, text in zip(kinds, row, strict=True)] for row in rows]


def _suggestions(flag: str, flags: list[str]) -> list[str]:
    """The flags to suggest: those in the section named `flag`, else in the same section, else those without section."""
    path = flag.rpartition(".")[0]
    within = [known for known in flags if known.startswith(flag + ".")]
    siblings = [known for known in flags if known.rpartition(".")[0] == path]
    return within or siblings or [known for known in flags if "." not in known]


def _nearest(flag: str, flags: list[str]) -> str:
    """The option which a misspelt one, or one without its section, may mean; "" if none is near."""
    if any(known.startswith(flag + ".") for known in flags):
        return ""  # the name of a section, whose options the message lists
    path, _, name = flag.rpartition(".")
    name = name.lstrip("-")
    of_sections = [known for known in flags if "." in known and known.rpartition(".")[2] == name]
    siblings = {known.rpartition(".")[2].lstrip("-"): known for known in flags if known.rpartition(".")[0] == path}
    if of_sections or not siblings:
        return " or ".join(of_sections) or nearest(flag, flags)
    return siblings.get(nearest(name, siblings), "")


def _convert(option: Option, kind: Any, text: str) -> Any:
    """The text converted to `kind`; unchanged if that fails, so that the validator reports it."""
    while typing.get_origin(kind) is Annotated:
        kind = typing.get_args(kind)[0]
    if kind is Path:
        return Path(_checked_name(option.name, text))
    if kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return text


def _checked_name(where: str, text: str) -> str:
    """The name of a file or scene; InputError if it could not be printed or written into the configuration."""
    if not is_one_line(text):
        raise InputError(where, f"found {shown(text)}", "a name without line breaks or control characters")
    return text
