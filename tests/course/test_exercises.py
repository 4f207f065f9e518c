"""The exercises of the notebooks: right answers pass, wrong ones are refused with the hint that they call for."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import sixthsense as ss
from sixthsense.course.checking import examine, exercises
from sixthsense.course.exercise import Exercise

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
FOLDED = re.compile(r"<summary>Solution</summary>\n\n```python\n(.*?)\n```\n\n</details>", re.DOTALL)
UNANSWERED = "no answer yet"

MISTAKES = [
    (name, k) for name, one in exercises().items() if isinstance(one, Exercise) for k in range(len(one.mistakes))
]


class Task(NamedTuple):
    """An exercise as a notebook has it."""

    name: str
    notebook: str
    stub: dict[str, Any]
    grade: dict[str, Any]
    solution: str


def tasks_of(notebook: Path) -> Iterator[Task]:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    for stub, grade, folded in zip(cells, cells[1:], cells[2:], strict=False):
        if stub["metadata"].get("nbgrader", {}).get("solution"):
            (name,) = re.findall(r'^check\("(.+)", \w+\)$', "".join(grade["source"]), re.MULTILINE)
            (solution,) = FOLDED.findall("".join(folded["source"]))
            yield Task(name, notebook.stem, stub, grade, solution)


TASKS = {task.name: task for notebook in NOTEBOOKS for task in tasks_of(notebook)}


def answer_of(source: str, task: Task) -> Any:
    """What a solution defines under the name that the notebook checks; earlier solutions of the notebook are known."""
    known: dict[str, Any] = {"np": np, "ss": ss}
    for other in tasks_of(next(file for file in NOTEBOOKS if file.stem == task.notebook)):
        if other.name == task.name:
            break
        exec(other.solution, known)
    exec(source, known)
    (name,) = re.findall(r"^check\(.*, (\w+)\)$", "".join(task.grade["source"]), re.MULTILINE)
    return known[name]


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_the_solution_of_a_notebook_is_right(task: Task) -> None:
    assert examine(task.name, answer_of(task.solution, task)) == ""


@pytest.mark.parametrize("task", TASKS.values(), ids=lambda task: task.name)
def test_a_cell_that_is_not_filled_in_is_no_answer(task: Task) -> None:
    assert examine(task.name, answer_of("".join(task.stub["source"]), task)).startswith(UNANSWERED)


@pytest.mark.parametrize(("name", "k"), MISTAKES)
def test_a_wrong_answer_is_refused_with_its_hint(name: str, k: int) -> None:
    exercise = exercises()[name]
    assert isinstance(exercise, Exercise)
    mistake = exercise.mistakes[k]
    said = examine(name, mistake.answer)
    assert said.startswith(mistake.hint)
    assert re.search(r"\d", said.removeprefix(mistake.hint)), "a hint has numbers, too"


def changed(source: str) -> Iterator[str]:
    """The source with one sign turned, one product exchanged or one transpose left out, for each of them."""
    count = len(list(ast.walk(ast.parse(source))))
    for k in range(count):
        tree = ast.parse(source)
        node = list(ast.walk(tree))[k]
        if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Sub):
            node.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Div):
            node.op = ast.Mult()
        elif (
            isinstance(node, ast.UnaryOp)
            and isinstance(node.op, ast.USub)
            and not isinstance(node.operand, ast.Constant)
        ):
            node.op = ast.UAdd()
        elif isinstance(node, ast.Attribute) and node.attr == "T":
            node.attr = "real"  # the array as it is
        else:
            continue
        yield ast.unparse(tree)


EQUIVALENT = {
    "rigid": 2,  # one of the two middles may stay: sums of products with the other, centred set do not change
    "pose graph": 1,  # pi or -pi before the modulo
}
"""how many of the changes leave a solution right"""


@pytest.mark.parametrize(
    "task",
    [task for task in TASKS.values() if isinstance(exercises()[task.name], Exercise)],
    ids=lambda task: task.name,
)
def test_a_solution_with_one_sign_or_one_transpose_wrong_is_refused(task: Task) -> None:
    accepted = []
    for source in changed(task.solution):
        try:
            answer = answer_of(source, task)
        except Exception:  # it does not even define
            continue
        if not examine(task.name, answer):
            accepted.append(source)
    assert len(accepted) == EQUIVALENT.get(task.name, 0), accepted
