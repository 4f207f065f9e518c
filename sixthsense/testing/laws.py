"""Laws of a contract: named checks, each called with the name of an implementation."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

Check = Callable[..., None]


@dataclass(frozen=True, slots=True)
class Law:
    """One law with its check."""

    name: str
    """a sentence, with _ between its words"""
    check: Callable[[str], None]
    """called with the name of an implementation; raises an exception if it violates the law"""
    needs_walls: bool = False
    """whether the check uses walls, which an estimator may refuse"""


class Laws(list[Law]):
    """Laws in the order of their definition."""

    def law(self, check: Check) -> Check:
        """Decorate a check, which is called with the name of an implementation."""
        self.append(Law(check.__name__, check))
        return check

    def wall_law(self, check: Check) -> Check:
        """Decorate a check that uses walls."""
        self.append(Law(check.__name__, check, needs_walls=True))
        return check

    def wall_law_for(self, cases: Collection[Any]) -> Callable[[Check], Check]:
        """Decorate a check that uses walls in each of the cases."""
        return self.law_for(cases, needs_walls=True)

    def law_for(self, cases: Collection[Any], needs_walls: bool = False) -> Callable[[Check], Check]:
        """Decorate a check, which is called with the name of an implementation and each of the cases.

        A case may have the attributes `label`, for the law's name, and `needs_walls`.
        """

        def add(check: Check) -> Check:
            for k, case in enumerate(cases):
                label = case if isinstance(case, str | float) else getattr(case, "label", k)
                walls = needs_walls or bool(getattr(case, "needs_walls", False))
                self.append(Law(f"{check.__name__} [{label}]", partial(_check_case, check, case), walls))
            return check

        return add


def _check_case(check: Check, case: Any, name: str) -> None:
    check(name, case)


@contextlib.contextmanager
def raises(kind: type[Exception], match: str = "") -> Iterator[None]:
    """A context that must raise an exception of that kind whose message matches; AssertionError otherwise."""
    try:
        yield
    except kind as error:
        assert re.search(match, str(error)), f"found {error}, expected {match}"
    else:
        raise AssertionError(f"nothing was raised, expected {kind.__name__} {match}")
