"""The parts that can be replaced, and what their names stand for: shipped ones, and any import path."""

from __future__ import annotations

import contextlib
import dataclasses
import re
import sys
import tomllib
from collections.abc import Iterator, Mapping
from functools import reduce
from importlib import import_module
from pathlib import Path
from types import MappingProxyType
from typing import Any

from sixthsense.config.errors import InputError, nearest, reason_of

_PATH = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*(\.[A-Za-z_]\w*)*")


class Parts:
    """The names of one kind of part, such as estimators.

    Shipped ones have short names. Any other part is named by its import path, `MODULE:NAME`.
    """

    def __init__(
        self, kind: str, seam: str, shipped: Mapping[str, str], sections: Mapping[str, str] = MappingProxyType({})
    ) -> None:
        """Hold the import path of each of the `shipped` names, and that of the protocol, the `seam`.

        `sections` are those of the configuration that hold the options of shipped ones, by name.
        """
        self.kind, self.seam, self.shipped, self.sections = kind, seam, shipped, sections

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and (name in self.shipped or _PATH.fullmatch(name) is not None)

    def __iter__(self) -> Iterator[str]:
        return iter(self.shipped)

    def __str__(self) -> str:
        return ", ".join((*self.shipped, "MODULE:NAME"))

    def name_of(self, part: Any) -> Any:
        """The import path of a class or function; any other value is returned as it is.

        Raises InputError for one that no import path leads to, as one that is made within a function.
        """
        if not callable(part):
            return part
        path = f"{getattr(part, '__module__', '')}:{getattr(part, '__qualname__', '')}"
        with contextlib.suppress(ImportError, AttributeError):
            if _PATH.fullmatch(path) and _imported(path) is part:
                return path
        raise InputError(self.kind, f"found {path}", "a class or function at the top level of a module")

    def checked(self, part: Any) -> Any:
        """The name of a part, which may be given as a class or function; InputError for one that cannot be a name."""
        found = self.name_of(part)
        if found not in self:
            raise InputError("", f"found {found!r:.80}", str(self), nearest(found, self))
        return found

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """As the annotation of a field: its value is a name of this kind, or a class or function."""
        from pydantic_core.core_schema import no_info_before_validator_function

        return no_info_before_validator_function(self.checked, handler(source))

    def members(self) -> tuple[str, ...]:
        """The names of what a part of this kind has."""
        return tuple(name for name in vars(_imported(self.seam)) if not name.startswith("_"))

    def load(self, name: str, folder: str | Path | None = None) -> Any:
        """The class or function that a name stands for; InputError for one that is not known or cannot be imported.

        Its module may lie in `folder`, which is searched last, and for this import alone.
        """
        path = self.shipped.get(name, name)
        if ":" not in path:
            raise InputError(self.kind, f"found {name!r}", str(self), nearest(name, self.shipped))
        try:
            part = _imported(path, folder)
        except Exception as error:  # a module of a user's may raise anything
            reason = f"{type(error).__name__}: {reason_of(error)}"
            allowed = f"a name in an installed module, or in one of a folder: `{self.kind}` {name}, `parts` DIR"
            raise InputError(self.kind, f"found {name}, which cannot be imported ({reason})", allowed) from error
        if folder is not None:
            searched[self.kind, name] = str(folder)
        if not callable(part):
            raise InputError(self.kind, f"found {name}, which is a {type(part).__name__}", "a class or function")
        return part


def options_class(part: Any) -> type | None:
    """The dataclass or section of a part's own options, its attribute `Options`; None of a part without."""
    found = getattr(part, "Options", None)
    is_model = dataclasses.is_dataclass(found) or hasattr(found, "model_fields")
    return found if isinstance(found, type) and is_model else None


def _imported(path: str, folder: str | Path | None = None) -> Any:
    module, _, name = path.partition(":")
    before, sys.path = sys.path, sys.path if folder is None else [*sys.path, str(folder)]
    try:
        return reduce(getattr, name.split("."), import_module(module))
    finally:
        sys.path = before


_TABLES = tomllib.loads(Path(__file__).with_name("parts.toml").read_text("utf-8"))
KINDS = tuple(Parts(kind, **table) for kind, table in _TABLES.items())
"""all kinds of parts, in the order of their use"""
ESTIMATORS, FRONT_ENDS, EXTRACTORS, PLACE_SEARCHES, PLANNERS, EXPLORERS = KINDS

searched: dict[tuple[str, str], str] = {}
"""folders that were searched for parts, by kind and name: other processes import the same ones by `import_again`"""


def import_named(given: Mapping[str, Any], folder: str | Path | None = None) -> None:
    """Import the parts whose import paths are among the `given` fields of a configuration.

    Their modules may lie in `folder`, by default the working folder: for fields that the user has stated.
    """
    for parts in KINDS:
        names = given.get(parts.kind)
        for name in names if isinstance(names, list | tuple) else (names,):
            if isinstance(name, str) and _PATH.fullmatch(name):
                parts.load(name, Path(folder or ".").absolute())


def import_again(found: Mapping[tuple[str, str], str]) -> None:
    """Import in another process what `searched` has."""
    kinds = {parts.kind: parts for parts in KINDS}
    for (kind, name), folder in found.items():
        kinds[kind].load(name, folder)


FILTERS = ("ekf", "ekf-invariant")
"""shipped estimators that do not keep the poses of all keyframes"""
KEEP_POSES = "with isam2, which keeps the poses of all keyframes"
"""of messages about the front end of scans"""
NEEDS_FILTER = "ekf-invariant, ekf, or one with the methods of Filter"
"""of messages about parameters that are estimated with the pose"""

OF_THE_ROBOT = (
    *("scene", "task", "goal", "tour", "start", "region", "rrtstar", "follow", "explore", "world"),
    *("planner", "planner_options", "explorer", "explorer_options"),
)
"""fields and sections of the configuration that a replay refuses: they are of a robot that is driven or simulated"""
