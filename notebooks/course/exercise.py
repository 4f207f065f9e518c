"""An exercise, and what is off in an answer to it."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.testing.laws import Failures

Draw = Callable[[np.random.Generator], tuple[Any, ...]]
"""arguments of an answer, drawn anew for each case"""

CASES = 5
"""on which an answer is called"""
_TOLERANCE = 1e-6
"""of a number, by the largest number of the same result"""
UNANSWERED = "no answer yet: fill in the cell above"


@dataclass(frozen=True, slots=True)
class Mistake:
    """A wrong answer, and what is said of it."""

    hint: str
    answer: Callable[..., Any]


@dataclass(frozen=True, slots=True)
class Exercise:
    """A function to be written, which is compared with a reference on drawn arguments."""

    name: str
    results: tuple[str, ...]
    """what the function returns, by name"""
    draw: Draw
    reference: Callable[..., Any]
    mistakes: tuple[Mistake, ...]


@dataclass(frozen=True, slots=True)
class Judged:
    """A part to be written, which the checker of its seam judges."""

    name: str
    judge: Callable[[Any], str]
    """what is off, in a sentence; empty if nothing"""


def verdict(failures: Failures) -> str:
    """What a checker of a seam has found, in a sentence; empty if all laws hold but those that are optional.

    Raises NotImplementedError if that is all that the part does.
    """
    if failures.kept:
        return ""
    if all("NotImplementedError" in found for found in failures.values()):
        raise NotImplementedError
    law, found = next(iter(failures.items()))
    return f"it breaks {len(failures)} of {failures.tested} laws, first: {law}: {found}"


def _cases(exercise: Exercise) -> Iterator[tuple[Any, ...]]:
    for seed in range(CASES):
        yield exercise.draw(np.random.default_rng(seed))


def compared(exercise: Exercise, answer: Callable[..., Any]) -> str:
    """What is off in an answer, by the reference; empty if nothing. Raises NotImplementedError as the answer does."""
    cases, found = list(_cases(exercise)), []
    for given in cases:
        kept = copy.deepcopy(given)
        try:
            found.append(_as_results(answer(*kept), len(exercise.results)))
        except NotImplementedError:
            raise
        except Exception as error:  # whatever an answer raises is said
            return f"it raises {type(error).__name__}: {error}"
        if found[-1] is None:
            return UNANSWERED
        if not _same(_as_arrays(kept), _as_arrays(given)):
            return "it changes one of its arguments: work on a copy"
    right = [_as_results(exercise.reference(*given), len(exercise.results)) or [] for given in cases]
    wrong = [k for k in range(CASES) if not _same(found[k] or [], right[k])]
    if not wrong:
        return ""
    first = wrong[0]
    off = _difference(exercise.results, found[first] or [], right[first])
    for mistake in exercise.mistakes:
        as_wrong = [_as_results(mistake.answer(*given), len(exercise.results)) or [] for given in cases]
        if all(_same(found[k] or [], as_wrong[k]) for k in range(CASES)):
            return f"{mistake.hint} ({off})"
    return off


def _as_results(returned: Any, count: int) -> list[Array] | None:
    """The results as arrays; None for no answer."""
    if returned is None or returned is Ellipsis:
        return None
    return _as_arrays((returned,) if count == 1 else returned)


def _as_arrays(values: Any) -> list[Array]:
    """Each value as an array of floats; what has no numbers, such as a pose, by its own `array`."""
    made = []
    for value in values:
        if isinstance(value, list | tuple) and len({np.shape(part) for part in value}) > 1:
            made += _as_arrays(value)  # of parts of different sizes
        else:
            made.append(np.asarray(value.array() if hasattr(value, "array") else value, dtype=np.float64))
    return made


def _same(one: list[Array], other: list[Array]) -> bool:
    return len(one) == len(other) and all(
        a.shape == b.shape and bool(_near(a, b).all()) for a, b in zip(one, other, strict=True)
    )


def _near(found: Array, right: Array) -> NDArray[np.bool_]:
    scale = float(np.abs(right[np.isfinite(right)]).max(initial=0.0))
    return np.isclose(found, right, rtol=0.0, atol=_TOLERANCE * scale, equal_nan=True)


def _difference(names: tuple[str, ...], found: list[Array], right: list[Array]) -> str:
    """What is off in the first result that differs."""
    if len(found) != len(right):
        return f"it returns {len(found)} results, and {len(right)} are asked for: {', '.join(names)}"
    name, a, b = next(
        (n, a, b) for n, a, b in zip(names, found, right, strict=True) if a.shape != b.shape or not _near(a, b).all()
    )
    if a.shape != b.shape:
        return f"{name} has the shape {a.shape}, and {b.shape} is asked for"
    if not np.isfinite(a[np.isfinite(b)]).all():
        return f"{name} has {np.count_nonzero(~np.isfinite(a))} of {a.size} numbers that are not finite"
    entry = np.unravel_index(int(np.argmax(np.nan_to_num(np.abs(a - b), nan=0.0))), a.shape)
    where = f"{name} [{', '.join(map(str, entry))}]" if a.shape else name
    off = f"{where} is {a[entry]:.6g}, off by {abs(a[entry] - b[entry]):.3g}"
    if a.size > 1:
        off += f"; {np.count_nonzero(_near(a, b))} of {a.size} numbers are right"
    return f"{_pattern(name, a, b)}{off}"


def _pattern(name: str, a: Array, b: Array) -> str:
    """What is off in all numbers alike, if anything."""
    turns = (a - b) / (2.0 * math.pi)
    ratio = float(np.vdot(a, b) / np.vdot(b, b)) if np.any(b) else 0.0
    if _near(a, -b).all():
        return f"{name} has the wrong sign: "
    if a.ndim == 2 and a.shape[0] == a.shape[1] and _near(a, b.T).all():
        return f"{name} is transposed: "
    if np.allclose(turns, np.round(turns), atol=_TOLERANCE):
        return f"{name} is off by whole turns, an angle is not wrapped: "
    if a.size > 1 and ratio and _near(a, ratio * b).all():
        return f"{name} is {ratio:.3g} times what is right: "
    return ""
