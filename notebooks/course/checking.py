"""Whether an answer to an exercise is right, and if not, what is off."""

from __future__ import annotations

import os
from functools import cache
from typing import Any

from course import exploring, filtering, graphs, measuring, scanning
from course.exercise import UNANSWERED, Exercise, Judged, compared
from sixthsense.config.errors import InputError, nearest


class NotRightError(AssertionError):
    """An answer that is not right, where nbgrader marks: a cell that raises has no points."""


def check(name: str, answer: Any) -> None:
    """Print whether the answer to an exercise is right, and if not, what is off. The solution is never shown.

    Raises InputError for the name of no exercise. Where nbgrader runs the notebook it raises `NotRightError` for an
    answer that is not right, which nbgrader reads as no points.
    """
    fault = examine(name, answer)
    print(f"{name}: {fault or 'right'}")
    if fault and "NBGRADER_EXECUTION" in os.environ:
        raise NotRightError(fault)


def examine(name: str, answer: Any) -> str:
    """What is off in an answer; empty if it is right."""
    known = exercises()
    if name not in known:
        raise InputError("name", f"found {name!r}", ", ".join(known), nearest(name, known))
    if answer is None or answer is Ellipsis:
        return UNANSWERED
    if not callable(answer):
        return f"this is a {type(answer).__name__}: give `check` the function itself, without a call"
    exercise = known[name]
    try:
        return exercise.judge(answer) if isinstance(exercise, Judged) else compared(exercise, answer)
    except NotImplementedError:
        return UNANSWERED


@cache
def exercises() -> dict[str, Exercise | Judged]:
    """All exercises, by name."""
    rooms = (measuring, scanning, filtering, graphs, exploring)
    return {exercise.name: exercise for room in rooms for exercise in room.EXERCISES}
