"""The docstrings under the fields of a dataclass: the texts of its options in the help and in the reference."""

from __future__ import annotations

import ast
import dataclasses
import inspect
import itertools


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
