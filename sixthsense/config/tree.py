"""What becomes of a tree of settings: the parts that it names, with their options; and of fields that are given."""

from __future__ import annotations

import contextlib
import inspect
import logging
import traceback
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter, ValidationError

from sixthsense.config.errors import InputError, PartError, nearest, reason_of
from sixthsense.config.files import absolute
from sixthsense.config.parts import KINDS, Parts, options_class
from sixthsense.config.section import input_error, merge, shown_name
from sixthsense.config.sections import Config

_log = logging.getLogger(__name__)


class Part(NamedTuple):
    """What a run is made with in one place."""

    name: str
    """kind and name"""
    factory: Any
    """the class or function that makes it"""
    options: Any = None
    """an object of its `Options`"""
    members: tuple[str, ...] = ()
    """what its protocol has, and it must have; empty for a shipped one"""

    def make(self, *args: Any) -> Any:
        """Make it; its options are the last argument, if it has any. Raises PartError for one that cannot be made."""
        options = () if options_class(self.factory) is None else (self.options,)
        try:
            made = self.factory(*args, *options)
            missing = [name for name in self.members if not hasattr(made, name)]
        except Exception as error:
            if not self.members or isinstance(error, InputError):
                raise
            found = f"cannot be made, it raised {type(error).__name__} ({reason_of(error)})"
            raise PartError(self.name, found) from error
        if missing:
            raise PartError(self.name, f"has no {', '.join(missing)}")
        return made


def check_returned(part: str, method: str, found: Any, kind: type, **shapes: tuple[int | None, ...]) -> None:
    """Raise PartError unless what a method of a part has returned is of a kind, and finite.

    `shapes` are of its arrays, by the attribute's name, and `itself` of what is one; None is any length.
    """
    import numpy as np

    if not isinstance(found, kind):
        raise PartError(part, f"{method}: found a {type(found).__name__}, allowed: a {kind.__name__}")
    for name, shape in shapes.items():
        array = np.asarray(found if name == "itself" else getattr(found, name))
        where = method if name == "itself" else f"{method}: {name}"
        if array.ndim != len(shape) or any(n not in (None, m) for n, m in zip(shape, array.shape, strict=True)):
            raise PartError(part, f"{where} has shape {array.shape}, allowed {shape}")
        if not np.isfinite(array).all():
            raise PartError(part, f"{where} is not finite")


@contextlib.contextmanager
def naming_parts(config: Config, when: str, check: Callable[[], None]) -> Iterator[None]:
    """Raise PartError in place of an exception that began in the code of a part of a user's own.

    Any other may follow from what one has returned, which `check` looks at.
    """
    try:
        yield
    except PartError as error:
        raise PartError(error.part, error.found, error.when or when) from error
    except InputError:
        raise
    except Exception as error:
        own = own_parts(config)
        modules = {parts.load(name).__module__: f"{parts.kind} {name}" for parts, name in own.items()}
        for frame, line in reversed([*traceback.walk_tb(error.__traceback__)]):
            if (part := modules.get(frame.f_globals.get("__name__", ""))) is not None:
                found = f"{frame.f_code.co_name} raised {type(error).__name__} in line {line} ({reason_of(error)})"
                raise PartError(part, found, when) from error
        if own:
            with naming_parts(Config(), when, check):
                check()
        raise


def own_parts(config: Config) -> dict[Parts, str]:
    """The names of the configured parts that are not shipped."""
    return {parts: name for parts in KINDS if (name := getattr(config, parts.kind)) not in parts.shipped}


def part_of(config: Config, parts: Parts) -> Part:
    """The configured part of a kind; InputError for one that cannot be imported, and for options that it has not."""
    name, given = getattr(config, parts.kind), getattr(config, f"{parts.kind}_options")
    label, factory, section = f"{parts.kind} {name}", parts.load(name), parts.sections.get(name)
    if section is None:
        options = part_options(parts.kind, factory, given)
        return Part(label, factory, options, () if name in parts.shipped else parts.members())
    if given:
        raise InputError(f"{parts.kind}_options", f"found {', '.join(given)} for {name}", f"the section {section}")
    return Part(label, factory, getattr(config, section))


def with_checked_parts(config: Config) -> Config:
    """The configuration with the options of parts as these take them: texts of a command line become numbers.

    Raises InputError for a part that cannot be imported, and for options that it does not have.
    """
    for parts in KINDS:
        given = getattr(config, f"{parts.kind}_options")
        if given or getattr(config, parts.kind) not in parts.shipped:
            options = part_of(config, parts).options
            config = config.replaced(**{f"{parts.kind}_options": {name: getattr(options, name) for name in given}})
    return config


def applied(base: Config, given: Mapping[str, Any]) -> Config:
    """`base` with the `given` fields, a goal or a tour of which sets the task; its parts have their options checked.

    The path of a scene's file is made absolute, so that the run can be repeated from any working folder. A part that
    follows from the fields and is not among them is logged.
    """
    found = merge(base, {**given, **task_of(given)})
    if Path(found.scene).suffix:
        found = found.replaced(scene=str(absolute(found.scene)))
    for name in ("estimator", "front_end"):
        old, new = getattr(base, name), getattr(found, name)
        if name not in given and new != old:
            _log.warning(f"note: {name} is {new} in place of {old}, which does not go with {', '.join(given)}")
    return with_checked_parts(found)


def make_part(parts: Parts, part: Any, *args: Any, options: Any = None) -> Any:
    """A part of a kind, by its name or its class, made with arguments; `options` are by default its own.

    Raises InputError that lists the known names for any other.
    """
    factory = parts.load(part) if isinstance(part, str) else part
    cls = options_class(factory)
    return Part(parts.kind, factory, options or (cls and cls())).make(*args)


def part_options(kind: str, factory: Any, given: Mapping[str, Any]) -> Any:
    """The options of a part with the values that are given, validated by the annotations of its dataclass."""
    cls, where = options_class(factory), f"{kind}_options"
    names = () if cls is None else tuple(inspect.signature(cls).parameters)
    for name in given:
        if name not in names:
            raise InputError(f"{where}.{name}", "no such field", ", ".join(names) or "none", nearest(name, names))
    try:
        return None if cls is None else TypeAdapter(cls).validate_python(given)
    except ValidationError as error:
        found = input_error(error)
        raise found.at(f"{where}.{found.where}") from None


def task_of(given: Mapping[str, Any]) -> dict[str, str]:
    """The task that a goal or a tour among the `given` fields sets, as a table; empty without one.

    Raises InputError for a goal or a tour with another task.
    """
    for task in ("goal", "tour"):
        if given.get(task) is not None:
            if given.get("task", task) != task:
                raise InputError(task, f"found with `task` {shown_name(given['task'])}", f"with `task` {task}")
            return {"task": task}
    return {}
