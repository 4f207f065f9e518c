"""The command line on argparse: options are the fields of models, a command's own and those of the configuration.

The parser converts texts; the models check values, so that flags and files give the same messages.
"""

from __future__ import annotations

import argparse
import contextlib
import re
import typing
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, NoReturn

from pydantic.fields import FieldInfo

from sixthsense.config import Section, preset
from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import KINDS
from sixthsense.config.section import kind_of, shown, shown_name

Table = dict[str, Any]

_POINTS = {2: "X Y", 3: "X Y THETA", 4: "X0 Y0 X1 Y1"}
_LISTS = {float: "X Y ...", str: "NAME ..."}
_METAVARS = {int: "N", float: "X", str: "NAME", Path: "FILE"}
_SWITCHED = ("true", "false")


class Arg(NamedTuple):
    """How an option appears on the command line, an annotation of its type."""

    metavar: str
    """name of its value"""
    is_positional: bool = False
    """an argument without a flag"""
    without: Any = None
    """value of an option that is given without one, if it may be"""
    flag: str = ""
    """its name on the command line, where that is not the field's"""


class Options(Section):
    """The options of a command: a field each, whose docstring is its text in the help."""

    takes_fields: ClassVar[bool] = False
    """whether every field of the configuration is an option as well"""
    base: ClassVar[str] = "default"
    """the preset whose values the help shows"""
    refused: ClassVar[tuple[str, ...]] = ()
    """options, and fields and sections of the configuration, that the help leaves out"""
    several: ClassVar[tuple[str, ...]] = ()
    """fields of the configuration that take several values"""

    def run(self, flags: Table) -> int:
        """Run the command; returns the exit code. `flags` has the fields of the configuration that options have set."""
        raise NotImplementedError


class Option(argparse.Action):
    """An option, or a positional argument, that sets a field of a model."""

    def __init__(self, option_strings: Sequence[str], field: FieldInfo, owner: type[Section], value: Any, **rest: Any):
        """Of a `field` of the model `owner`, whose `value` is the default that the help shows."""
        super().__init__(option_strings, default=argparse.SUPPRESS, **rest)
        self.field, self.owner, self.value = field, owner, value
        self.kind, self.arg = _kind_of(field)

    def __call__(
        self, parser: argparse.ArgumentParser, namespace: argparse.Namespace, values: Any, flag: str | None = None
    ) -> None:
        """Set the value: of a switch it follows from the flag, of a list of points it is in rows."""
        if self.kind is bool:
            values = flag == self.option_strings[0]
        elif (width := len(_items(_items(self.kind)[0]))) > 1:
            values = [values[k : k + width] for k in range(0, len(values), width)]
        setattr(namespace, self.dest, values)

    @property
    def default_text(self) -> str:
        """The default in the help, empty if that is none or false."""
        numbers = self.value if isinstance(self.value, tuple) else (self.value,)
        text = " ".join(f"{one:.4g}" if isinstance(one, float) else str(one) for one in numbers)
        return {"None": "", "False": "", "True": "true"}.get(text, text)

    @property
    def usage(self) -> str:
        """Flag and value in the help."""
        value = self.arg.metavar or " ".join([self.metavar] if isinstance(self.metavar, str) else self.metavar or ())
        if self.kind is bool:
            value = "true|false" if self.value is True else ""
        return " ".join(filter(None, [*self.option_strings[:1], value]))


class Parser(argparse.ArgumentParser):
    """A parser whose errors are InputErrors. The values are checked by the models."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**{**options, "add_help": False, "allow_abbrev": False})
        self._negative_number_matcher = re.compile(r"-\.?\d")  # 1e-3, too

    @property
    def options(self) -> list[Option]:
        """Those that set a field."""
        return [action for action in self._actions if isinstance(action, Option)]

    def add_options(self, command: type[Options]) -> None:
        """Add a command's own options, then those of the configuration, if it takes them."""
        for name, field in command.model_fields.items():
            if name != "settings":
                self._add(name, field, command, field.get_default())
        for name, field, owner, value in _leaves(preset(command.base)) if command.takes_fields else ():
            if name not in command.model_fields:
                self._add(name, field, owner, value, name in command.several)

    def _add(self, name: str, field: FieldInfo, owner: type[Section], value: Any, takes_several: bool = False) -> None:
        """Add the option of a field."""
        kind, arg = _kind_of(field)
        items = _items(kind)
        is_list, inner = items[-1] is Ellipsis or takes_several, _items(items[0])[0]
        usual = _METAVARS.get(kind, _POINTS.get(len(items), "NAME"))
        metavar = arg.metavar or (_LISTS[inner] if is_list else usual)
        options: Table = {"field": field, "owner": owner, "value": value}
        options |= {"metavar": metavar, "type": _number if inner in (int, float) else Path if inner is Path else str}
        if arg.is_positional:
            self.add_argument(name, action=Option, nargs="*" if is_list else "?", **options)
            return
        flags, options["dest"] = [f"--{arg.flag or flag_name(name)}"], name
        if kind is bool:
            flags += [re.sub(r"^(.*\.|--)", r"\1no-", flags[0])]
            options["nargs"] = 0
        elif arg.without is not None:
            options |= {"nargs": "?", "const": arg.without}
        elif is_list:
            options["nargs"] = "+"
        elif len(items) > 1:
            options |= {"nargs": len(items), "metavar": tuple(metavar.split())}
        self.add_argument(*flags, action=Option, **options)

    def error(self, message: str) -> NoReturn:
        """Raise InputError for an option with too few values, or a command line that is wrong in another way."""
        flag, _, expected = message.removeprefix("argument ").partition(": expected ")
        raise InputError(flag.split("/")[0], "found too few values", expected.replace("argument", "value"))


def _leaves(section: Section, path: str = "") -> Iterator[tuple[str, FieldInfo, type[Section], Any]]:
    """Dotted name, field, model and value of each setting, those of the sections in a section behind its own."""
    for name, value in section:
        if not isinstance(value, Section | dict):
            yield f"{path}{name}", type(section).model_fields[name], type(section), value
    for name, value in section:
        if isinstance(value, Section):
            yield from _leaves(value, f"{path}{name}.")


def parse(parser: Parser, args: Sequence[str]) -> tuple[Table, Table]:
    """The values that a command's arguments give its own options, and the nested table of those of the configuration.

    Raises InputError for an unknown option, with the nearest one, and for arguments too many or too few.
    """
    words = _words(parser, args)
    for flag in dict.fromkeys(word.partition("=")[0] for word in words if is_of_part(word)):
        parser.add_argument(flag, dest=flag[2:].replace("-", "_"), default=argparse.SUPPRESS, nargs="?", const="true")
    namespace, rest = parser.parse_known_intermixed_args(words)
    if rest:
        raise _too_many(rest[0], vars(namespace), parser.options)
    own = {option.dest for option in parser.options if issubclass(option.owner, Options)}
    given: Table = {}
    table: Table = {}
    for name, value in vars(namespace).items():
        *sections, last = [name] if name in own else name.split(".")
        target = given if name in own else table
        for section in sections:
            target = target.setdefault(section, {})
        target[last] = value
    return given, table


def _words(parser: Parser, args: Sequence[str]) -> list[str]:
    """The words that argparse reads: a switch with a value, `--guard=false` or `--guard false`, is the flag of that."""
    switches = {option.option_strings[0]: option.option_strings for option in parser.options if option.kind is bool}
    words, queue = list[str](), list(args)
    while queue:
        flag, equals, text = queue.pop(0).partition("=")
        flag = flag_name(flag) if flag.startswith("--") else flag
        if flag in switches and (equals or (queue and queue[0].lower() in _SWITCHED)):
            text = text if equals else queue.pop(0)
            if text.lower() not in _SWITCHED:
                raise InputError(flag, f"found {shown(text)}", "true or false")
            words.append(switches[flag][_SWITCHED.index(text.lower())])
        else:
            words.append(f"{flag}{equals}{text}")
    return words


def _too_many(word: str, given: Table, options: Sequence[Option]) -> InputError:
    """The error for a word that no option takes."""
    if not word.startswith("-"):
        name = next((option.dest for option in options if not option.option_strings), "arguments")
        found = " and ".join(shown(one) for one in (given.get(name), word) if one is not None)
        return InputError(name, f"found {found}", "one" if name in given else "options alone")
    flag = word.partition("=")[0]
    flags = [option.option_strings[0] for option in options if option.option_strings]
    within = [known for known in flags if known.startswith(f"{flag}.")]
    siblings = [known for known in flags if known.rpartition(".")[0] == flag.rpartition(".")[0]]
    namesakes = [known for known in flags if known.endswith(f".{flag.lstrip('-')}")]
    near = "" if within else " or ".join(namesakes) or nearest(flag, siblings or flags)
    return InputError(shown_name(flag), "no such option", ", ".join(within or siblings), near)


def is_of_part(word: str) -> bool:
    """Whether a word is an option of a part: `--estimator-options.gain`."""
    return any(word.startswith(f"--{flag_name(parts.kind)}-options.") for parts in KINDS)


def flag_name(name: str) -> str:
    """A field's name as the command line has it."""
    return name.replace("_", "-")


def as_options(text: str) -> str:
    """A line for the terminal: names of fields and arguments, which are in backquotes, as options."""
    return re.sub(r"`([a-z0-9_.]+)`", lambda found: f"--{flag_name(found[1])}", text)


def with_options(error: InputError, parser: Parser) -> str:
    """What an error says, with the option in place of the field where that is one of the parser's."""
    name, *rest = re.split(r"(?=[, ])", error.where, maxsplit=1)
    names = [option.dest for option in parser.options if option.option_strings]
    if any(f"{known}.".startswith(f"{name}.") for known in names) or is_of_part(f"--{flag_name(name)}."):
        error = error.at("".join([f"--{flag_name(name)}", *rest]))
    return as_options(str(error))


def _number(text: str) -> Any:
    """A text as a number or None; a text that is neither stays, so that the model reports it."""
    for kind in (int, float):
        with contextlib.suppress(ValueError):
            return kind(text)
    return None if text == "None" else text


def _kind_of(field: FieldInfo) -> tuple[Any, Arg]:
    """The type of a field's values, and how the command line shows them."""
    kind, notes = kind_of(field)
    return kind, next((note for note in notes if isinstance(note, Arg)), Arg(""))


def _items(kind: Any) -> tuple[Any, ...]:
    """The types of a field's values: of one, of several, or of any number where the last is an ellipsis."""
    return typing.get_args(kind) if typing.get_origin(kind) is tuple else (kind,)
