"""An exercise, and what is off in an answer: first by patterns of results and arguments, then by its own hints."""

from __future__ import annotations

import copy
import inspect
import itertools
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.testing.laws import Failures

Draw = Callable[[np.random.Generator], tuple[Any, ...]]
"""arguments of an answer, drawn anew for each case"""
Wrong = tuple[str, Callable[[int], list[Array]]]
"""a hint, and the results of the wrong answer that it explains in a case"""
CASES = 5
"""on which an answer is called"""
_TOLERANCE = 1e-6
"""of a number, by the largest number of the same result"""
UNANSWERED = "no answer yet: fill in the cell above"


@dataclass(frozen=True, slots=True)
class Exercise:
    """A function to be written, which is compared with a reference on drawn arguments."""

    results: tuple[str, ...]
    """what the function returns, by name"""
    draw: Draw
    reference: Callable[..., Any] | None = None
    """the package's own function; None: the solution that is folded in the notebook"""
    mistakes: Mapping[str, Callable[..., Any]] = field(default_factory=dict)
    """wrong answers that no pattern explains, by their hint: functions of the right one and of its arguments"""


@dataclass(frozen=True, slots=True)
class Judged:
    """A part to be written, which the checker of its seam judges."""

    checker: Callable[[Any], Failures]


def judged(exercise: Judged, part: Any) -> str:
    """What the checker of a seam has found, in a sentence; empty if all laws hold but those that are optional.

    Raises NotImplementedError if that is all that the part does.
    """
    failures = exercise.checker(part)
    if failures.kept:
        return ""
    if all("NotImplementedError" in found for found in failures.values()):
        raise NotImplementedError
    law, found = next(iter(failures.items()))
    return f"it breaks {len(failures)} of {failures.tested} laws, first: {law}: {found}"


def cases(exercise: Exercise) -> list[tuple[Any, ...]]:
    """The arguments on which answers are compared."""
    return [exercise.draw(np.random.default_rng(seed)) for seed in range(CASES)]


def compared(exercise: Exercise, reference: Callable[..., Any], answer: Callable[..., Any]) -> str:
    """What is off in an answer, by a reference; empty if nothing. Raises NotImplementedError as the answer does."""
    given, found, count = cases(exercise), list[list[Array]](), len(exercise.results)
    for one in given:
        kept = copy.deepcopy(one)
        try:
            returned = answer(*kept)
            if returned is None or returned is Ellipsis:
                return UNANSWERED
            found.append(_as_results(returned, count))
        except NotImplementedError:
            raise
        except Exception as error:  # whatever an answer raises is printed
            return f"it raises {type(error).__name__}: {error}"
        if not _same(_as_arrays(kept), _as_arrays(one)):
            return "it changes one of its arguments: work on a copy"
    right = [_as_results(reference(*one), count) for one in given]
    first = next((k for k in range(CASES) if not _same(found[k], right[k])), None)
    if first is None:
        return ""
    off = _difference(exercise.results, found[first], right[first])
    hints = (hint for hint, wrong in wrong_answers(exercise, reference, answer) if _explains(wrong, found, right))
    hint = next(hints, None) or _factor(exercise.results, found, right)
    return f"{hint} ({off})" if hint else off


def wrong_answers(exercise: Exercise, reference: Callable[..., Any], answer: Callable[..., Any]) -> Iterator[Wrong]:
    """Wrong answers with their hints, which name arguments as the answer does."""
    given, count = cases(exercise), len(exercise.results)
    right = [_as_results(reference(*one), count) for one in given]
    for hint, change in _RESULTS:
        for n, name in enumerate(exercise.results):
            yield f"{name} {hint}", partial(_with_changed, right, change, n)
    yield "the results are in the wrong order", lambda k: right[k][::-1]
    for hint, wrong in exercise.mistakes.items():
        yield hint, partial(_results_of, partial(wrong, reference), given, count)
    names = [*inspect.signature(answer).parameters]
    if len(names) != len(given[0]):
        names = [*inspect.signature(reference).parameters][: len(given[0])]
    changed = [[*_changes(names, one)] for one in given]
    for n, (hint, _) in enumerate(changed[0]):
        yield hint, partial(_results_of, reference, [one[n][1] for one in changed], count)
    if all(isinstance(value, Pose) for value in given[0]):
        hint = "poses are subtracted number by number: see one from the other"
        yield hint, partial(_results_of, _subtracted, given, count)


def _with_changed(right: list[list[Array]], change: Callable[[Array], Array], n: int, k: int) -> list[Array]:
    return [change(part) if m == n else part for m, part in enumerate(right[k])]


def _results_of(function: Callable[..., Any], given: list[tuple[Any, ...]], count: int, k: int) -> list[Array]:
    return _as_results(function(*given[k]), count)


def _explains(wrong: Callable[[int], list[Array]], found: list[list[Array]], right: list[list[Array]]) -> bool:
    """Whether an answer is this wrong one in all cases, and not the right one."""
    try:
        with np.errstate(all="ignore"):
            return all(_same(found[k], wrong(k)) for k in range(CASES)) and not all(map(_same, found, right))
    except Exception:  # an argument that was changed is no argument any more
        return False


def _inverted(row: Array) -> Array:
    return Pose(*row).inverse().array()


_RESULTS: tuple[tuple[str, Callable[[Array], Array]], ...] = (
    ("has the wrong sign", lambda b: -b),
    ("is transposed", lambda b: b.swapaxes(-1, -2)),
    ("is the root of what is right", np.sqrt),
    ("is the square of what is right, a root is missing", np.square),
    ("is upside down", np.reciprocal),
    ("is in degrees", np.degrees),
    ("is in the wrong order, from the last to the first", lambda b: b[::-1]),
    ("has x and y exchanged", lambda b: b[:, ::-1]),
    ("is the motion back: from which frame is it seen?", _inverted),
    ("is the opposite, what is true is false", np.logical_not),
)
"""what an answer may have done to a result"""


def _changes(names: Sequence[str], given: tuple[Any, ...]) -> Iterator[tuple[str, tuple[Any, ...]]]:
    """Arguments that an answer may have mistaken the given ones for."""
    for n, name in enumerate(names):
        for hint, value in _variants(given[n]):
            yield hint.format(name), (*given[:n], value, *given[n + 1 :])
    for m, n in itertools.combinations(range(len(names)), 2):
        exchanged = [*given]
        exchanged[m], exchanged[n] = given[n], given[m]
        yield f"{names[m]} and {names[n]} are exchanged", tuple(exchanged)


def _variants(value: Any) -> Iterator[tuple[str, Any]]:
    """What an argument may be mistaken for, with a hint that has a place for its name."""
    if isinstance(value, Pose):
        x, y, theta = value.array().tolist()
        yield "the heading of {} is left out", Pose(x, y, 0.0)
        yield "the heading of {} turns the wrong way: a sign of an angle", Pose(x, y, -theta)
        yield "the position of {} is left out", Pose(0.0, 0.0, theta)
        yield "the position of {} has the wrong sign", Pose(-x, -y, theta)
        yield "{} is inverted, or is not: from which frame is it seen?", value.inverse()
        yield "{} is left out", Pose()
        return
    if isinstance(value, list):
        for each in zip(*map(_variants, value), strict=True):
            yield each[0][0], [one for _, one in each]
        return
    array = np.asarray(value)
    if array.dtype == np.float64:
        yield "{} is left out", 0.0 * array
        yield "{} has the wrong sign", -array
        yield "{} is rounded down", np.floor(array)
        is_angle = np.abs(array).max() < 2.0 * math.pi
        yield "{} is in radians already", np.radians(array) if is_angle else array
        yield "{} is converted to degrees, and is asked for in radians", np.degrees(array) if is_angle else array
    if array.ndim >= 2:
        yield "{} is transposed", array.swapaxes(-1, -2)
        yield "columns of {} are exchanged", array[..., ::-1]
    if array.ndim >= 2 and array.shape[-1] == array.shape[-2] and array.dtype == np.float64:
        yield "{} is inverted, or is not", np.linalg.inv(array)
        yield "the correlations within {} are left out", array * np.eye(array.shape[-1])


def _subtracted(*poses: Pose) -> Array:
    rows = [pose.array() for pose in poses]
    off = rows[-2 if len(rows) > 2 else -1] - rows[0] - (rows[2] if len(rows) > 2 else 0.0)
    off[2] = wrap_angle(off[2])
    return np.asarray(off)


def _factor(names: tuple[str, ...], found: list[list[Array]], right: list[list[Array]]) -> str:
    """What is off in all numbers of a result alike, in all cases; empty if nothing."""
    for n, name in enumerate(names):
        pairs = [
            (a[n], b[n]) for a, b in zip(found, right, strict=True) if len(a) == len(b) and a[n].shape == b[n].shape
        ]
        if len(pairs) < CASES or all(_near(a, b).all() for a, b in pairs):
            continue
        turns = np.concatenate([np.ravel(a - b) for a, b in pairs]) / (2.0 * math.pi)
        if np.allclose(turns, np.round(turns), atol=_TOLERANCE):
            return f"{name} is off by whole turns, an angle is not wrapped"
        ratios = [float(np.vdot(a, b) / np.vdot(b, b)) if np.any(b) else 0.0 for a, b in pairs]
        alike = all(_near(a, ratio * b).all() for ratio, (a, b) in zip(ratios, pairs, strict=True))
        if alike and all(ratios) and (pairs[0][0].size > 1 or np.ptp(ratios) < _TOLERANCE):
            return f"{name} is {ratios[0]:.3g} times what is right"
        return ""
    return ""


def _as_results(returned: Any, count: int) -> list[Array]:
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
    return f"{off}; {np.count_nonzero(_near(a, b))} of {a.size} numbers are right" if a.size > 1 else off
