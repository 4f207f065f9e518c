"""Laws of a contract: named checks of its clauses, what a part breaks of them, and the assertions that they make."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Check = Callable[..., None]


@dataclass(frozen=True, slots=True)
class Law:
    """One law of a contract."""

    name: str
    """a sentence, behind the number of its clause if the contract has numbers"""
    check: Callable[[Any], None]
    """called with a part, or its name; raises an exception if the part breaks the law"""
    needs_walls: bool = False
    """whether the check uses walls, which an estimator may refuse"""
    is_optional: bool = False
    """whether a part may leave it to its users, as the validation of input"""


class Laws(list[Law]):
    """Laws in the order of their definition."""

    def law(
        self, clause: int | None = None, cases: Collection[Any] = (), *, is_optional: bool = False
    ) -> Callable[[Check], Check]:
        """Decorate a check, which is called with a part, and with each of the `cases` if there are any.

        A case may have the attributes `label`, for the law's name, and `needs_walls`; or it is a tuple of such cases.
        """

        def add(check: Check) -> Check:
            name = check.__name__.replace("_", " ")
            name = name if clause is None else f"clause {clause}: {name}"
            if not cases:
                self.append(Law(name, check, is_optional=is_optional))
            for case in cases:
                of_case = case if isinstance(case, tuple) else (case,)
                label = ", ".join(str(getattr(one, "label", one)) for one in of_case)
                needs_walls = any(getattr(one, "needs_walls", False) for one in of_case)
                self.append(Law(f"{name} [{label}]", _with_case(check, case), needs_walls, is_optional))
            return check

        return add

    def named(self, name: str) -> Law:
        """The law with that name, with or without its clause; KeyError for another."""
        return {key: law for law in self for key in (law.name, law.name.partition(": ")[2])}[name]


def _with_case(check: Check, case: Any) -> Callable[[Any], None]:
    return lambda part: check(part, case)


class Failures(dict[str, str]):
    """What a part was found to do, by the name of the law that it breaks; empty if it keeps all that were tested."""

    def __init__(self, part: Any, laws: Iterable[Law], skipped: dict[str, str]) -> None:
        """Check the part against laws; `skipped` are those that are not tested, with the reason."""
        super().__init__()
        self.skipped = skipped
        """laws that were not tested, with the reason"""
        self.tested = 0
        """number of laws that were tested"""
        self.kept = True
        """whether all tested laws hold but those that a part may leave to its users"""
        for law in laws:
            self.tested += 1
            try:
                law.check(part)
            except Exception as error:  # raised by the law or by the part: the law is broken either way
                self[law.name] = message_of(error)
                self.kept = self.kept and law.is_optional

    def __repr__(self) -> str:
        verdict = f"breaks {len(self)} of {self.tested} laws" if self else f"keeps all {self.tested} laws"
        lines = [verdict, *(f"  {name}: {found}" for name, found in self.items())]
        if self.skipped:
            lines.append(f"not tested: {len(self.skipped)} laws, {next(iter(self.skipped.values()))}")
        return "\n".join(lines)


def message_of(error: Exception) -> str:
    """An error in one line, with its type unless an assertion of a law raised it."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    text = " ".join(lines[:1])
    return text if isinstance(error, AssertionError) and text else f"{type(error).__name__}: {text}"


def agree(what: str, found: ArrayLike, allowed: ArrayLike, atol: float = 0.0, rtol: float = 0.0) -> None:
    """Raise AssertionError unless arrays have one shape and differ by no more than `atol + rtol * abs(allowed)`."""
    one, other = np.asarray(found, dtype=np.float64), np.asarray(allowed, dtype=np.float64)
    assert one.shape == other.shape, f"{what}: found shape {one.shape}, allowed {other.shape}"
    off, most = np.nan_to_num(np.abs(one - other), nan=np.inf), atol + rtol * np.abs(other)
    beyond = ~(off <= most)
    if beyond.any():
        at = np.unravel_index(int(np.argmax(np.where(beyond, off, -1.0))), off.shape)
        place = f" at {[int(k) for k in at]}" if at else ""
        raise AssertionError(f"{what}: found a difference of {off[at]:.3g}{place}, allowed {most[at]:.3g}")


def refuse(message: str) -> None:
    """Raise AssertionError if there is a message."""
    assert not message, message


def at_most(what: str, found: float, allowed: float) -> None:
    """Raise AssertionError for a number that is larger than allowed, or no number."""
    assert found <= allowed, f"{what}: found {found:.4g}, allowed at most {allowed:.4g}"


def equal(what: str, found: object, allowed: object) -> None:
    """Raise AssertionError for two values that differ."""
    assert found == allowed, f"{what}: found {found}, allowed {allowed}"


@contextmanager
def raises(kind: type[Exception], match: str = "") -> Iterator[None]:
    """A context that must raise an exception of that kind whose message matches; AssertionError otherwise."""
    wanted = f"{kind.__name__} that names {match.replace(': .*', ', ')!r}" if match else kind.__name__
    try:
        yield
    except kind as error:
        assert re.search(match, str(error)), f"found {message_of(error)}, allowed: {wanted}"
    except Exception as error:
        raise AssertionError(f"found {message_of(error)}, allowed: {wanted}") from error
    else:
        raise AssertionError(f"found no error, allowed: {wanted}")
