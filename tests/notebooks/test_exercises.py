"""The exercises of the notebooks: right answers pass, wrong ones are refused with the hint that they call for."""

import ast
import copy
import functools
import json
import pickle
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

import sixthsense as ss
from course import check, checking, reference
from course.checking import CHECKED, EXERCISES, FOLDED, examine
from course.exercise import CASES, Exercise, wrong_answers

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
UNANSWERED = "no answer yet"


class Task(NamedTuple):
    """An exercise as a notebook has it."""

    name: str
    function: str
    notebook: str
    stub: dict[str, Any]
    grade: dict[str, Any]
    solution: str


def tasks_of(notebook: Path) -> Iterator[Task]:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    for stub, grade, folded in zip(cells, cells[1:], cells[2:], strict=False):
        if stub["metadata"].get("nbgrader", {}).get("solution"):
            ((name, function),) = CHECKED.findall("".join(grade["source"]))
            (solution,) = FOLDED.findall("".join(folded["source"]))
            yield Task(name, function, notebook.stem, stub, grade, solution)


TASKS = [task for notebook in NOTEBOOKS for task in tasks_of(notebook)]
of_each_task = pytest.mark.parametrize("task", TASKS, ids=lambda task: task.name)


def answer_of(source: str, task: Task) -> Any:
    """What a solution defines under the name that the notebook checks; earlier solutions of the notebook are known."""
    known: dict[str, Any] = {"np": np, "ss": ss}
    for other in TASKS[: TASKS.index(task)]:
        if other.notebook == task.notebook:
            exec(other.solution, known)
    exec(source, known)
    return known[task.function]


def test_every_exercise_of_the_table_stands_in_one_notebook_and_every_notebook_has_some() -> None:
    assert sorted(task.name for task in TASKS) == sorted(EXERCISES)
    assert all(sum(task.notebook == file.stem for task in TASKS) >= 2 for file in NOTEBOOKS)


@of_each_task
def test_the_solution_of_a_notebook_is_right_and_a_cell_that_is_not_filled_in_is_no_answer(task: Task) -> None:
    assert examine(task.name, answer_of(task.solution, task)) == ""
    assert examine(task.name, answer_of("".join(task.stub["source"]), task)).startswith(UNANSWERED)


def played(exercise: Exercise, wrong: Callable[[int], list[Any]]) -> Callable[..., Any]:
    """An answer that returns the results of a wrong one, case by case."""
    results = (wrong(k) for k in range(CASES))
    return lambda *given: next(results) if len(exercise.results) > 1 else next(results)[0]


def remembered(function: Callable[..., Any]) -> Callable[..., Any]:
    """The same function, which computes a result once."""
    known: dict[bytes, Any] = {}

    @functools.wraps(function)
    def again(*given: Any) -> Any:
        key = pickle.dumps(given)
        if key not in known:
            known[key] = function(*given)
        return copy.deepcopy(known[key])

    return again


def test_wrong_answers_are_refused_with_what_explains_them(monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the exercises with their own hint, unless a pattern of the results explains them."""
    right = {name: remembered(reference(name)) for name in EXERCISES if reference(name)}
    monkeypatch.setattr(checking, "reference", right.get)
    count, by_pattern = 0, 0
    for name, exercise in EXERCISES.items():
        if not isinstance(exercise, Exercise):
            continue
        for hint, wrong in wrong_answers(exercise, right[name], lambda *given: None):
            try:
                with np.errstate(all="ignore"):
                    fault = examine(name, played(exercise, wrong))
            except Exception:  # the results of the pattern do not exist, such as the root of a negative number
                continue
            if hint in exercise.mistakes:
                assert fault.startswith(hint), (name, hint, fault)
            if fault.startswith(hint):
                assert re.search(r"\d", fault.removeprefix(hint)), "a hint has numbers, too"
                count, by_pattern = count + 1, by_pattern + (hint not in exercise.mistakes)
    assert count >= 150 and by_pattern >= 100, (count, by_pattern)


def changed(source: str) -> Iterator[str]:
    """The source with one sign turned, one product exchanged or one transpose left out, for each of them."""
    for k in range(len(list(ast.walk(ast.parse(source))))):
        tree = ast.parse(source)
        match list(ast.walk(tree))[k]:
            case ast.BinOp(op=ast.Add() | ast.Sub()) as node:
                node.op = ast.Sub() if isinstance(node.op, ast.Add) else ast.Add()
            case ast.BinOp(op=ast.Div()) as node:
                node.op = ast.Mult()
            case ast.UnaryOp(op=ast.USub(), operand=operand) as unary if not isinstance(operand, ast.Constant):
                unary.op = ast.UAdd()
            case ast.Attribute(attr="T") as attribute:
                attribute.attr = "real"  # the array as it is
            case _:
                continue
        yield ast.unparse(tree)


MOST_LINES = 100_000
"""of an answer: one with a wrong sign may never end"""


@contextmanager
def lines_limited() -> Iterator[None]:
    """Raises RuntimeError in an answer that goes on and on."""
    count = 0

    def line(frame: Any, event: str, _: Any) -> Any:
        nonlocal count
        count += 1
        if count > MOST_LINES:
            raise RuntimeError("no end")
        return line

    before = sys.gettrace()
    sys.settrace(lambda frame, event, _: line if frame.f_code.co_filename == "<string>" else None)
    try:
        yield
    finally:
        sys.settrace(before)


EQUIVALENT = {
    "rigid": 2,  # one of the two middles may stay: sums of products with the other, centred set do not change
    "pose graph": 1,  # pi or -pi before the modulo
    "shortest": 2,  # the eight neighbours in another order
}
"""how many of the changes leave a solution right"""


@of_each_task
def test_a_solution_with_one_sign_or_one_transpose_wrong_is_refused(task: Task) -> None:
    accepted = []
    for source in changed(task.solution) if isinstance(EXERCISES[task.name], Exercise) else ():
        try:
            answer = answer_of(source, task)
        except Exception:  # it does not even define
            continue
        with lines_limited():
            fault = examine(task.name, answer)
        if not fault:
            accepted.append(source)
    assert len(accepted) == EQUIVALENT.get(task.name, 0), accepted


# Of a part that is to be written: what stands in the solution, what takes its place, and what is said of it.
WRONG_PARTS = [
    ("EKF-SLAM", "turn @ odometry.cov @ turn.T", "odometry.cov", "predicting in pieces is predicting at once"),
    ("EKF-SLAM", "self.cov[:3, :3].copy()", "self.cov[:3, :3]", "returned arrays are copies"),
    ("explorer", "return targets[int(np.argmin(ways))]", "return None", "the other room is looked at"),
]


@pytest.mark.parametrize(("name", "right", "wrong", "said"), WRONG_PARTS)
def test_a_part_with_a_mistake_is_refused_by_its_law(name: str, right: str, wrong: str, said: str) -> None:
    (task,) = (task for task in TASKS if task.name == name)
    assert right in task.solution
    fault = examine(name, answer_of(task.solution.replace(right, wrong), task))
    assert said in fault and re.match(r"it breaks \d+ of \d+ laws", fault)


def answers(name: str, change: Callable[..., Any]) -> Callable[..., Any]:
    """The reference with its results changed."""
    right = reference(name)
    return lambda *given: change(right(*given))


ANSWERS = {
    "an angle that is not wrapped": (
        "residual", answers("residual", lambda r: r + 2 * np.pi * np.eye(3)[2]), "not wrapped",
    ),
    "a sign": ("to lines", answers("to lines", lambda r: -r), "wrong sign"),
    "a transposed matrix": ("motion jacobian", answers("motion jacobian", lambda r: r.T), "transposed"),
    "a factor": ("rigid", answers("rigid", lambda r: 1.5 * r), "1.5 times"),
    "degrees": (
        "stopping", lambda v, delay, a: reference("stopping")(v, np.degrees(delay), a), "delay is converted to degrees",
    ),
    "a turn in the wrong direction": (
        "body axes", lambda P, theta: reference("body axes")(P, -theta), "theta has the wrong sign",
    ),
    "a heading in the wrong direction": (
        "carried", lambda at, *r: reference("carried")(ss.Pose(at.x, at.y, -at.theta), *r), "a sign of an angle",
    ),
    "a difference of poses by numbers": (
        "residual", lambda a, b, m: ss.Pose(*(b.array() - a.array() - m.array())), "subtracted number by number",
    ),
    "an argument that is left out": ("gate", lambda v, H, P, R: reference("gate")(v, H, P, 0 * R), "R is left out"),
    "another shape": ("nees", answers("nees", lambda r: r[:, None]), "the shape (4, 1), and (4,) is asked for"),
    "too few results": ("update", answers("update", lambda r: r[:1]), "it returns 1 results, and 2 are asked for"),
    "an error": ("octile", lambda rows, cols: rows[0], "it raises TypeError"),
    "no number": ("inflate", lambda cells, _: np.full(cells.shape, np.nan), "numbers that are not finite"),
    "one number of many": (
        "probability", answers("probability", lambda r: np.append(r[:-1], 0.3)), "5 of 6 numbers are right",
    ),
    "an argument that is changed": ("predict", lambda P, *_: np.add(P, 1.0, out=P), "changes one of its arguments"),
    "a value": ("nees", np.array([2.7, 3.4]), "this is a ndarray"),
    "nothing": ("nees", lambda errors, covs: None, UNANSWERED),
    "dots": ("EKF-SLAM", ..., UNANSWERED),
    "no exercise": ("neees", lambda: 0, "there is no such exercise, did you mean nees?"),
}  # fmt: skip


@pytest.mark.parametrize("what", ANSWERS)
def test_what_is_off_in_any_answer_is_said_in_words_and_numbers(what: str) -> None:
    name, answer, said = ANSWERS[what]
    assert said in examine(name, answer)


def test_marks_are_as_nbgrader_reads_them() -> None:
    """Schema 3 of its metadata: what its validator asks of a solution cell and of a test cell."""
    ids = []
    for task in TASKS:
        stub, grade = (cell["metadata"]["nbgrader"] for cell in (task.stub, task.grade))
        assert (stub["solution"], stub["grade"], stub["locked"]) == (True, False, False)
        assert (grade["solution"], grade["grade"], grade["locked"]) == (False, True, True)
        assert grade["points"] > 0
        assert {one["schema_version"] for one in (stub, grade)} == {3}
        assert {one["cell_type"] for one in (stub, grade)} == {task.stub["cell_type"]} == {task.grade["cell_type"]}
        ids += [stub["grade_id"], grade["grade_id"]]
    assert len(set(ids)) == len(ids)


def test_check_prints_for_a_student_and_raises_where_nbgrader_marks(monkeypatch, capsys) -> None:
    monkeypatch.delenv("NBGRADER_EXECUTION", raising=False)
    own = reference("octile")
    assert check("octile", own) is own
    assert check("octile", lambda rows, cols: rows + cols) is own, "the cells that follow go on with a reference"
    right, wrong = capsys.readouterr().out.splitlines()
    assert right == "octile: right" and wrong.startswith("octile: a step to a diagonal neighbour")
    monkeypatch.setenv("NBGRADER_EXECUTION", "autograde")
    check("octile", reference("octile"))
    for answer in (lambda rows, cols: rows + cols, lambda rows, cols: None):
        with pytest.raises(AssertionError):
            check("octile", answer)
