"""Sections of a configuration, which validate themselves."""

from __future__ import annotations

import ast
import copy
import dataclasses
import functools
import inspect
import itertools
import math
import numbers
import reprlib
import sys
import types
import typing
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self, TypeVar

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import PartOptions, Parts

C = TypeVar("C", bound="Section")

_LARGEST = sys.float_info.max
_LARGEST_WHOLE = (1 << 63) - 1  # TOML's integers have 64 bits


class _Short(reprlib.Repr):
    """Any value in one line of bounded length."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 80

    def repr_int(self, x: int, level: int) -> str:
        # Python limits the digits of a decimal text, but not of a hexadecimal one that is read.
        return super().repr_int(x, level) if x.bit_length() < 14_000 else f"an integer of {x.bit_length()} bits"


_short = _Short()


def shown(value: Any) -> str:
    """A value for an error message: one line, shortened."""
    return _short.repr(value)


def shown_name(name: Any) -> str:
    """A name for an error message: as it is, or quoted and shortened if it is not one short line."""
    return str(name) if isinstance(name, str) and len(name) <= 80 and is_one_line(name) else shown(name)


def is_one_line(text: str) -> bool:
    """Whether a text can be printed in one line: no line break, control character or lone surrogate."""
    return not any(unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") for c in text)


@dataclass(frozen=True)
class Range:
    """The interval that a number must lie in; `open_low` excludes `low` itself."""

    low: float = -math.inf
    high: float = math.inf
    open_low: bool = False
    unit: str = ""
    """unit of an angle, such as rad or rad/m: a message about a number in degrees converts it"""

    def __contains__(self, value: float) -> bool:
        above = value > self.low if self.open_low else value >= self.low
        return above and value <= self.high

    def __str__(self) -> str:
        if self.high < math.inf:
            return f"{'above ' if self.open_low else ''}{self.low:g} to {self.high:g}"
        return f"above {self.low:g}" if self.open_low else f"at least {self.low:g}"

    def near(self, value: float) -> str:
        """What a number outside may mean: the radians of one in degrees; "" if they are not allowed either."""
        radians = math.radians(value)
        degrees = f"{value:g} {self.unit.replace('rad', 'degrees', 1)}"
        return f"{radians:.4g} {self.unit} ({degrees})" if self.unit and radians in self else ""


Positive = Annotated[float, Range(0.0, open_low=True)]
NonNegative = Annotated[float, Range(0.0)]
Noise = Annotated[float, Range(0.0, 100.0)]
AngularNoise = Annotated[float, Range(0.0, 100.0, unit="rad")]
PositiveCount = Annotated[int, Range(1)]
Count = Annotated[int, Range(0)]
Distribution = Literal["gaussian", "uniform"]


class Section:
    """A node of the tree, which knows what was stated; creation checks each field by its annotation and coerces it."""

    _explicit = frozenset[str]()  # of an instance its own

    def __new__(cls, *args: Any, **given: Any) -> Self:
        """A section whose `explicit_fields` are the arguments."""
        section = super().__new__(cls)
        positional = (field.name for field in dataclasses.fields(typing.cast(Any, cls))[: len(args)])
        object.__setattr__(section, "_explicit", frozenset((*positional, *given)))
        return section

    @property
    def explicit_fields(self) -> frozenset[str]:
        """Names of the fields that a caller, a file or an option has stated; all others are defaults or of a preset."""
        return self._explicit

    def explicit_table(self) -> dict[str, Any]:
        """The fields that were stated, nested as in a file."""
        table = {name: getattr(self, name) for name in vars(self) if name in self._explicit}
        return {name: value.explicit_table() if isinstance(value, Section) else value for name, value in table.items()}

    def as_implied(self) -> Self:
        """The same values, of which none counts as stated."""
        same = copy.copy(self)
        for name, value in vars(self).items():
            if isinstance(value, Section):
                object.__setattr__(same, name, value.as_implied())
        object.__setattr__(same, "_explicit", frozenset())
        return same

    def __post_init__(self) -> None:
        for name, hint in hints_of(type(self)).items():
            object.__setattr__(self, name, checked(name, hint, getattr(self, name)))

    def with_implied(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """The fields that are to be replaced, with those that follow from them."""
        return table


def hints_of(cls: type) -> dict[str, Any]:
    """The annotated types of a class's fields, by name."""
    if cls not in _known_hints:
        _known_hints[cls] = typing.get_type_hints(cls, include_extras=True)
    return _known_hints[cls]


_known_hints: dict[type, dict[str, Any]] = {}  # reading them takes most of a section's creation


def checked(name: str, hint: Any, value: Any) -> Any:
    """`value` coerced to the annotated type `hint`; InputError naming the field otherwise."""
    origin = typing.get_origin(hint)
    if origin is Annotated:
        base, *notes = typing.get_args(hint)
        for parts in (note for note in notes if isinstance(note, Parts)):
            if (found := parts.name_of(value)) not in parts:
                raise InputError(name, f"found {shown(value)}", str(parts), nearest(value, parts))
            return found
        value = checked(name, base, value)
        for bounds in (note for note in notes if isinstance(note, Range)):
            if value not in bounds:
                raise InputError(name, f"found {shown(value)}", f"{bounds} {bounds.unit}".rstrip(), bounds.near(value))
        return value
    if origin is Literal:
        choices = typing.get_args(hint)
        if value not in choices:
            raise InputError(name, f"found {shown(value)}", ", ".join(choices), nearest(value, choices))
        return value
    if origin in (typing.Union, types.UnionType):
        inner = next(a for a in typing.get_args(hint) if a is not type(None))
        return None if value is None else checked(name, inner, value)
    if origin is tuple:
        args = typing.get_args(hint)
        if args[-1] is Ellipsis:
            if not isinstance(value, (tuple, list)) or not value:
                raise InputError(name, f"found {shown(value)}", "a list")
            return tuple(checked(f"{name}, entry {k}", args[0], v) for k, v in enumerate(value, 1))
        if not isinstance(value, (tuple, list)) or len(value) != len(args):
            raise InputError(name, f"found {shown(value)}", f"{len(args)} numbers")
        return tuple(checked(name, a, v) for a, v in zip(args, value, strict=True))
    if hint is PartOptions:
        return _part_options(name, value)
    if hint is float:
        real = isinstance(value, numbers.Real) and not isinstance(value, bool)
        if not real or not abs(typing.cast(float, value)) <= _LARGEST:  # false for NaN
            raise InputError(name, f"found {shown(value)}", "a finite number")
        return float(value)
    if hint is int:
        if isinstance(value, bool) or not isinstance(value, numbers.Integral):
            raise InputError(name, f"found {shown(value)}", "a whole number")
        if abs(int(value)) > _LARGEST_WHOLE:
            raise InputError(name, f"found {shown(value)}", "a whole number of 64 bits")
        return int(value)
    if not isinstance(value, hint):
        kind = {bool: "true or false", str: "a text"}.get(hint, f"a table of {hint.__name__}")
        raise InputError(name, f"found {shown(value)}", kind)
    if hint is str and not is_one_line(value):
        raise InputError(name, f"found {shown(value)}", "a text without line breaks or control characters")
    return value


def _part_options(name: str, value: Any) -> PartOptions:
    """Options of a part from a table, or from an object of the part's own dataclass."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        value = dataclasses.asdict(value)
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        raise InputError(name, f"found {shown(value)}", "a table")
    return PartOptions({key.replace("-", "_"): one for key, one in value.items()})


def merge(base: C, table: Mapping[str, Any], path: str = "") -> C:
    """`base` with the fields that `table` (nested, as a TOML file is) names replaced; they count as stated then.

    A section in it replaces those fields of its own that were stated. Raises InputError with the dotted name of a field
    that does not exist or whose value is not allowed.
    """
    known = {f.name: f for f in dataclasses.fields(typing.cast(Any, base))}
    changes: dict[str, Any] = {}
    for name, value in base.with_implied({key.replace("-", "_"): value for key, value in table.items()}).items():
        if name not in known:
            raise InputError(f"{path}{shown_name(name)}", "no such field", ", ".join(known), nearest(name, known))
        current = getattr(base, name)
        if isinstance(value, Section):
            value = value.explicit_table()
        if isinstance(current, Section):
            if not isinstance(value, Mapping):
                raise InputError(f"{path}{name}", f"found {shown(value)}", "a table")
            changes[name] = merge(current, value, f"{path}{name}.")
        else:
            try:
                changes[name] = checked(name, hints_of(type(base))[name], value)
            except InputError as error:
                raise error.at(f"{path}{error.where}") from None
    try:
        merged = typing.cast(C, dataclasses.replace(typing.cast(Any, base), **changes))
    except InputError as error:  # fields that are inconsistent with each other
        raise error.at(f"{path}{error.where}") from None
    object.__setattr__(merged, "_explicit", base.explicit_fields | changes.keys())
    return merged


def as_table(section: Section) -> dict[str, Any]:
    """The tree as nested plain values, absent (None) fields left out, ready for TOML."""
    table: dict[str, Any] = {}
    for f in dataclasses.fields(typing.cast(Any, section)):
        value = getattr(section, f.name)
        if isinstance(value, PartOptions):
            table |= {f.name: dict(value)} if value else {}
        elif value is not None:
            table[f.name] = as_table(value) if isinstance(value, Section) else value
    return table


@functools.cache  # reading the source takes some milliseconds, and the help asks for each field
def field_texts(cls: type) -> dict[str, str]:
    """The docstring under each field of a dataclass, by the field's name; those of its base classes included."""
    found: dict[str, str] = {}
    for one in reversed(cls.__mro__):
        if not dataclasses.is_dataclass(one):
            continue
        (definition,) = ast.parse(inspect.cleandoc("\n" + inspect.getsource(one))).body
        assert isinstance(definition, ast.ClassDef)
        for field, text in itertools.pairwise(definition.body):
            if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
                continue
            if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
                found[field.target.id] = " ".join(str(text.value.value).split())
    return found
