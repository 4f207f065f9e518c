"""Whether an answer to an exercise is right, and if not, what is off."""

from __future__ import annotations

import os
from typing import Any

from course import exploring, filtering, graphs, measuring, scanning
from course.exercise import UNANSWERED, Exercise, Judged, compared, judged
from sixthsense.config.errors import nearest

_TOPICS = (measuring, scanning, filtering, graphs, exploring)
EXERCISES: dict[str, Exercise | Judged] = {name: one for topic in _TOPICS for name, one in topic.EXERCISES.items()}
"""all exercises, by name"""
MISTAKES = {name: wrong for topic in _TOPICS for name, wrong in topic.MISTAKES.items()}
"""of exercises, wrong answers by their hint"""


class NotRightError(AssertionError):
    """An answer that is not right, where nbgrader marks: a cell that raises has no points."""


def check(name: str, answer: Any) -> Any:
    """Print whether the answer to an exercise is right, and if not, what is off. The solution is never shown.

    Returns the function for the cells that follow: the answer if it is right, a reference otherwise. Where nbgrader
    runs the notebook it raises `NotRightError` for an answer that is not right, which nbgrader reads as no points.
    """
    fault = examine(name, answer)
    print(f"{name}: {fault or 'right'}")
    if fault and "NBGRADER_EXECUTION" in os.environ:
        raise NotRightError(fault)
    return answer if not fault else reference(name)


def reference(name: str) -> Any:
    """The function that answers to an exercise are compared with; None for a part, and for no exercise."""
    exercise = EXERCISES.get(name)
    return exercise.reference if isinstance(exercise, Exercise) else None


def examine(name: str, answer: Any) -> str:
    """What is off in an answer; empty if it is right."""
    if name not in EXERCISES:
        near = nearest(name, EXERCISES)
        return f"there is no such exercise{f', did you mean {near}?' if near else ''}"
    if answer is None or answer is Ellipsis:
        return UNANSWERED
    if not callable(answer):
        return f"this is a {type(answer).__name__}: give `check` the function itself, without a call"
    exercise = EXERCISES[name]
    try:
        if isinstance(exercise, Judged):
            return judged(exercise, answer)
        return compared(exercise, MISTAKES.get(name, {}), answer)
    except NotImplementedError:
        return UNANSWERED
