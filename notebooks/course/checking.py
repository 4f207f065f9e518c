"""Whether an answer to an exercise is right, and if not, what is off."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import sixthsense as ss
from course import exploring, filtering, graphs, measuring, scanning
from course.exercise import UNANSWERED, Exercise, Judged, compared, judged
from sixthsense.config.errors import nearest

_TOPICS = (measuring, scanning, filtering, graphs, exploring)
EXERCISES: dict[str, Exercise | Judged] = {name: one for topic in _TOPICS for name, one in topic.EXERCISES.items()}
"""all exercises, by name"""

CHECKED = re.compile(r'^(?:[^=\n]+ = )?check\("(.+)", (\w+)\)$', re.MULTILINE)
"""in a cell: the exercise, and the name of the answer"""
FOLDED = re.compile(r"<summary>Solution</summary>\n\n```python\n(.*?)\n```\n\n</details>", re.DOTALL)
"""in the cell after it: the solution"""


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
    """The function that answers to an exercise are compared with; None for a part, and for no exercise.

    It is the package's own one where it has one, else the solution that is folded in a notebook.
    """
    exercise = EXERCISES.get(name)
    return (exercise.reference or solutions().get(name)) if isinstance(exercise, Exercise) else None


@cache
def solutions() -> dict[str, Callable[..., Any]]:
    """What the folded solutions of the notebooks beside this folder and in it define, by exercise."""
    found, folder = {}, Path(__file__).parent
    for notebook in sorted([*folder.parent.glob("*.ipynb"), *folder.glob("*.ipynb")]):
        known: dict[str, Any] = {"np": np, "ss": ss}
        checked = None
        for cell in json.loads(notebook.read_text(encoding="utf-8"))["cells"]:
            text = "".join(cell["source"])
            if (folded := FOLDED.search(text)) and checked:
                exec(folded[1], known)
                found[checked[1]] = known[checked[2]]
            checked = CHECKED.search(text) or checked
    return found


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
    if isinstance(exercise, Exercise) and reference(name) is None:
        return "there is no notebook with its solution, beside the folder `course` or in it"
    try:
        return judged(exercise, answer) if isinstance(exercise, Judged) else compared(exercise, reference(name), answer)
    except NotImplementedError:
        return UNANSWERED
