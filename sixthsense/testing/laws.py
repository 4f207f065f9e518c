"""Laws of a contract: named checks, each called with an implementation; what they find, and how it is said."""

from __future__ import annotations

import ast
import contextlib
import inspect
import re
import textwrap
import traceback
from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from types import TracebackType
from typing import Any, Literal, get_args

import numpy as np

from sixthsense.evaluation.tables import html_table

Check = Callable[..., None]
Group = Literal["statistics", "interface", "validation"]
"""what a law is about: mean and covariance; calls and what they return; what is done with invalid input"""


@dataclass(frozen=True, slots=True)
class Law:
    """One law with its check."""

    name: str
    """a sentence, with _ between its words"""
    check: Callable[[Any], None]
    """called with an implementation, or its name; raises an exception if it violates the law"""
    needs_walls: bool = False
    """whether the check uses walls, which an estimator may refuse"""
    group: Group = "interface"


class Laws(list[Law]):
    """Laws of one group, in the order of their definition; their checks may use walls."""

    def __init__(self, group: Group = "interface", needs_walls: bool = False) -> None:
        super().__init__()
        self._group, self._needs_walls = group, needs_walls

    def law(self, check: Check) -> Check:
        """Decorate a check, which is called with the name of an implementation."""
        self.append(Law(check.__name__, check, self._needs_walls, self._group))
        return check

    def law_for(self, cases: Collection[Any]) -> Callable[[Check], Check]:
        """Decorate a check, which is called with the name of an implementation and each of the cases.

        A case may have the attributes `label`, for the law's name, and `needs_walls`.
        """

        def add(check: Check) -> Check:
            for k, case in enumerate(cases):
                label = case if isinstance(case, str | float) else getattr(case, "label", k)
                walls = self._needs_walls or bool(getattr(case, "needs_walls", False))
                self.append(Law(f"{check.__name__} [{label}]", partial(_check_case, check, case), walls, self._group))
            return check

        return add


def _check_case(check: Check, case: Any, name: Any) -> None:
    check(name, case)


class Verdicts(dict[str, str]):
    """The violation of each tested law, by the name of the law; empty if the law holds."""

    def __init__(self) -> None:
        super().__init__()
        self.skipped: dict[str, str] = {}
        """the laws that were not tested, with the reason"""
        self.groups: dict[str, Group] = {}
        """what each tested law is about"""

    @property
    def kept(self) -> bool:
        """Whether all tested laws hold but those of validation, which a part may leave to its users."""
        return not any(found for law, found in self.items() if self.groups[law] != "validation")

    def __repr__(self) -> str:
        lines = []
        for group in get_args(Group):
            of_group = {law: found for law, found in self.items() if self.groups[law] == group}
            broken = [f"  {law.replace('_', ' ')}: {found}" for law, found in of_group.items() if found]
            if of_group:
                verdict = f"breaks {len(broken)} of {len(of_group)}" if broken else f"keeps all {len(of_group)}"
                optional = " (optional)" if group == "validation" else ""
                lines += [f"{group}{optional}: {verdict} laws", *broken]
        if self.skipped:
            lines.append(f"not tested: {len(self.skipped)} laws, {next(iter(self.skipped.values()))}")
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        rows = [
            [self.groups[law], law.replace("_", " "), "broken" if found else "kept", found]
            for law, found in self.items()
        ]
        rows += [["", law.replace("_", " "), "not tested", reason] for law, reason in self.skipped.items()]
        return html_table(["group", "law", "verdict", "violation"], rows)


def verdicts_of(laws: Iterable[Law], part: Any, refusal_of_walls: str = "", validation: bool = True) -> Verdicts:
    """Test a part against laws, group by group; those of walls are skipped where it refuses them.

    Without `validation` the laws of invalid input are left out.
    """
    verdicts = Verdicts()
    for law in sorted(laws, key=lambda law: get_args(Group).index(law.group)):
        if law.group == "validation" and not validation:
            continue
        if law.needs_walls and refusal_of_walls:
            verdicts.skipped[law.name] = refusal_of_walls
            continue
        verdicts.groups[law.name], verdicts[law.name] = law.group, ""
        try:
            law.check(part)
        except Exception as error:  # raised by the law or by the part: the law is violated either way
            verdicts[law.name] = violation(error)
    return verdicts


def violation(error: Exception) -> str:
    """What an error of a law's check says: for an assertion without a message what was found, allowed, and where."""
    frame = error.__traceback__
    while frame is not None and frame.tb_next is not None:
        frame = frame.tb_next
    message = str(error).partition("\n")[0]
    if isinstance(error, AssertionError) and not message and frame is not None:
        return _failed(frame) or f"AssertionError: {traceback.extract_tb(frame)[-1].line}"
    if isinstance(error, AssertionError) and message:
        return message
    if message or frame is None:
        return f"{type(error).__name__}: {message}"
    return f"{type(error).__name__}: {traceback.extract_tb(frame)[-1].line}"


def _failed(frame: TracebackType) -> str:
    """The numbers of the assertion that failed in a frame; "" if it cannot be evaluated once more."""
    lines, first = inspect.getsourcelines(frame.tb_frame.f_code)
    try:
        nodes = list(ast.walk(ast.parse(textwrap.dedent("".join(lines)))))
        line = frame.tb_lineno - max(first, 1) + 1
        failed = next(
            node for node in nodes if isinstance(node, ast.Assert) and node.lineno <= line <= (node.end_lineno or 0)
        )

        def value(node: ast.expr) -> Any:
            return eval(compile(ast.Expression(node), "law", "eval"), frame.tb_frame.f_globals, frame.tb_frame.f_locals)

        return _said(failed.test, value)
    except Exception:  # as of a comprehension, which sees no local names
        return ""


def _said(test: ast.expr, value: Callable[[ast.expr], Any]) -> str:
    """What an expression that is false found, and what it allows."""
    if isinstance(test, ast.BoolOp) and isinstance(test.op, ast.And):
        return _said(next(part for part in test.values if not value(part)), value)
    name = ast.unparse(test)
    if isinstance(test, ast.Call) and name.startswith(("np.allclose(", "np.array_equal(")):
        one, other = (np.asarray(value(argument), dtype=float) for argument in test.args[:2])
        if one.shape != other.shape and 0 not in (one.ndim, other.ndim):
            return f"found shape {one.shape}, allowed {other.shape} ({name})"
        off = np.abs(one - other)
        where = np.unravel_index(int(np.argmax(np.nan_to_num(off, nan=np.inf))), off.shape)
        keywords = {keyword.arg: value(keyword.value) for keyword in test.keywords}
        tolerances = {"atol": 1e-8, "rtol": 1e-5} | keywords if "allclose" in name else {"atol": 0.0, "rtol": 0.0}
        allowed = tolerances["atol"] + tolerances["rtol"] * np.abs(np.broadcast_to(other, off.shape)[where])
        at = f" at {[int(k) for k in where]}" if where else ""
        return f"found a difference of {off[where]:.3g}{at}, allowed {allowed:.3g} ({name})"
    if isinstance(test, ast.Compare) and len(test.ops) == 1:
        found, allowed = (np.array2string(np.asarray(value(n)), precision=4) for n in (test.left, test.comparators[0]))
        sign = ast.unparse(ast.Compare(ast.Name(""), test.ops, [ast.Name("")])).strip()
        return f"found {found}, allowed {sign} {allowed} ({name})".replace("\n", "")
    return ""


@contextlib.contextmanager
def raises(kind: type[Exception], match: str = "") -> Iterator[None]:
    """A context that must raise an exception of that kind whose message matches; AssertionError otherwise."""
    try:
        yield
    except kind as error:
        assert re.search(match, str(error)), f"found {error}, expected {match}"
    else:
        raise AssertionError(f"nothing was raised, expected {kind.__name__} {match}")
