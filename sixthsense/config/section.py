"""Sections of a configuration: models of pydantic, whose errors are `InputError`s with place, found and allowed."""

from __future__ import annotations

import math
import types
import typing
import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self, TypeVar, cast

from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model, field_validator
from pydantic.fields import FieldInfo

from sixthsense.config.errors import InputError, nearest
from sixthsense.config.parts import Parts

S = TypeVar("S", bound="Section")

_LARGEST_WHOLE = (1 << 63) - 1  # TOML's integers have 64 bits


def shown(value: Any) -> str:
    """A value for an error message: one line of at most 80 letters."""
    try:
        text = " ".join(repr(value).split())
    except ValueError:  # Python limits the digits of an integer's text
        text = f"an integer of {value.bit_length()} bits"
    return text if len(text) <= 80 else f"{text[:38]}...{text[-38:]}"


def shown_name(name: Any) -> str:
    """A name for an error message: as it is, or quoted and shortened if it is not one short line."""
    return str(name) if isinstance(name, str) and len(name) <= 80 and is_one_line(name) else shown(name)


def is_one_line(text: str) -> bool:
    """Whether a text can be printed in one line: no line break, control character or lone surrogate."""
    return not any(unicodedata.category(c) in ("Cc", "Cs", "Zl", "Zp") for c in text)


Positive = Annotated[float, Field(gt=0.0)]
NonNegative = Annotated[float, Field(ge=0.0)]
Noise = Annotated[float, Field(ge=0.0, le=100.0)]
PositiveCount = Annotated[int, Field(ge=1, le=_LARGEST_WHOLE)]
Count = Annotated[int, Field(ge=0, le=_LARGEST_WHOLE)]
Distribution = Literal["gaussian", "uniform"]


def _plain(value: Any) -> Any:
    value = value.tolist() if hasattr(value, "tolist") else value
    return tuple(map(_plain, value)) if isinstance(value, list | tuple) else value


class Section(BaseModel):
    """A node of the tree of settings: frozen, validated when it is made, and `model_fields_set` is what was stated.

    Raises InputError with the dotted name of a field that does not exist or whose value is not allowed.
    """

    model_config = ConfigDict(
        frozen=True, extra="forbid", strict=True, allow_inf_nan=False, use_attribute_docstrings=True, defer_build=True
    )

    if not TYPE_CHECKING:  # a type checker reads the fields

        def __init__(self, **values: Any) -> None:
            try:
                if values or any(field.is_required() for field in type(self).model_fields.values()):
                    super().__init__(**values)
                else:  # defaults are allowed: no schema is built to check them
                    self.__setstate__(self.model_construct().__getstate__())
            except ValidationError as error:
                raise input_error(error, type(self).model_fields) from None

    @field_validator("*", mode="before")
    @classmethod
    def _read(cls, value: Any) -> Any:
        """Lists as tuples, values of NumPy as plain ones; InputError for a text that could not be printed."""
        if isinstance(value, str | Path) and not is_one_line(str(value)):
            raise InputError("", f"found {shown(str(value))}", "a text without line breaks or control characters")
        return _plain(value)

    def as_implied(self) -> Self:
        """The same values, of which none counts as stated."""
        values = {name: value.as_implied() if isinstance(value, Section) else value for name, value in self}
        return self.model_construct(_fields_set=set(), **values)

    def replaced(self, **changes: Any) -> Self:
        """The same section with other values of some fields, which count as stated."""
        made = type(self)(**{**dict(self), **changes}) if changes else self
        return self.model_copy(update={name: getattr(made, name) for name in changes})

    def with_implied(self, table: Mapping[str, Any]) -> Mapping[str, Any]:
        """The fields that are to be replaced, with those that follow from them."""
        return table


def merge(base: S, table: Mapping[str, Any]) -> S:
    """`base` with the fields that `table` (nested, as a TOML file is) names replaced; they count as stated then.

    A section in it replaces those fields of its own that were stated. Raises InputError as a section does.
    """
    changes: dict[str, Any] = {}
    for name, value in base.with_implied({str(key).replace("-", "_"): value for key, value in table.items()}).items():
        stated = value.model_dump(exclude_unset=True) if isinstance(value, Section) else value
        current = getattr(base, name, None) if name in type(base).model_fields else None
        if isinstance(current, Section) and isinstance(stated, Mapping):
            try:
                stated = merge(current, stated)
            except InputError as error:
                raise error.at(f"{name}.{error.where}") from None
        changes[name] = stated
    return base.replaced(**changes)


def as_table(section: Section) -> dict[str, Any]:
    """The tree as nested plain values, ready for TOML, without absent (None) fields and empty tables."""
    return {name: value for name, value in section.model_dump(exclude_none=True).items() if value != {}}


_ALLOWED = {
    "float": "a finite number",
    "finite": "a finite number",
    "int": "a whole number",
    "bool": "true or false",
    "string": "a text",
    **dict.fromkeys(("dict", "model", "dataclass"), "a table"),
}
"""what is allowed in place of a value, by the first word of pydantic's type of error"""


def input_error(error: ValidationError, fields: Mapping[str, FieldInfo] = types.MappingProxyType({})) -> InputError:
    """The first error of a validation: the dotted name of the field, what was found and what is allowed."""
    first = error.errors(include_url=False)[0]
    names = [shown_name(part) for part in first["loc"] if isinstance(part, str)]
    cause = first.get("ctx", {}).get("error")
    if isinstance(cause, InputError):
        return cause.at(".".join(filter(None, [*names, cause.where])))
    where, found = ".".join(names), f"found {shown(first['input'])}"
    if first["type"] in ("extra_forbidden", "unexpected_keyword_argument"):
        return InputError(where, "no such field", ", ".join(fields), nearest(names[-1], fields))
    field = fields.get(names[0]) if names else None
    near = nearest(first["input"], () if field is None else choices_of(field))
    return InputError(
        where, found, _ALLOWED.get(first["type"].partition("_")[0]) or allowed(field) or first["msg"], near
    )


def checked(name: str, hint: Any, value: Any) -> Any:
    """`value` as a field with the annotated type `hint` takes it; InputError naming the field otherwise."""
    model = cast(Any, create_model)("Checked", __base__=Section, **{name: (hint, ...)})
    return getattr(model(**{name: value}), name)


def kind_of(field: FieldInfo) -> tuple[Any, list[Any]]:
    """The type of a field's values without None and annotations, and the annotations."""
    hint, notes = field.annotation, list(field.metadata)
    while typing.get_origin(hint) in (Annotated, typing.Union, types.UnionType):
        for note in getattr(hint, "__metadata__", ()):
            notes += note.metadata if isinstance(note, FieldInfo) else [note]
        hint = typing.get_args(hint)[0]
    return hint, notes


def choices_of(field: FieldInfo) -> tuple[str, ...]:
    """The values of a field, if they can be listed."""
    kind, notes = kind_of(field)
    names = [name for note in notes if isinstance(note, Parts) for name in note]
    return tuple(names) or (typing.get_args(kind) if typing.get_origin(kind) is Literal else ())


def allowed(field: FieldInfo | None) -> str:
    """The values that a field allows: an interval, a list of names, a number of numbers; empty if its type says all."""
    if field is None:
        return ""
    kind, notes = kind_of(field)
    if typing.get_origin(kind) is tuple and not choices_of(field):
        args = typing.get_args(kind)
        if args[-1] is not Ellipsis:
            return f"{len(args)} numbers"
        each = allowed(FieldInfo.from_annotation(args[0]))
        return f"a list, each {each}" if each else "a list"
    return interval(notes) or ", ".join(choices_of(field))


def interval(notes: Iterable[Any]) -> str:
    """The bounds among the annotations of a number, in words; empty without any."""
    bounds = {name: getattr(note, name) for note in notes for name in ("gt", "ge", "lt", "le") if hasattr(note, name)}
    low, high = bounds.get("gt", bounds.get("ge", -math.inf)), bounds.get("le", math.inf)
    above = "above " if "gt" in bounds else "" if high < _LARGEST_WHOLE else "at least "
    if low == -math.inf:
        return "" if high == math.inf else f"at most {high:g}"
    return f"{above}{low:g}" + (f" to {high:g}" if high < _LARGEST_WHOLE else "")
