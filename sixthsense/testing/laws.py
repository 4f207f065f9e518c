"""Laws that every back end keeps, one by one."""

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
    """One promise, and what tests it."""

    name: str
    """a sentence, with _ between its words"""
    check: Callable[[str], None]
    """of the back end of that name; raises whatever shows that it does not keep the law"""


class Laws(list[Law]):
    """Laws in the order in which they were written."""

    def law(self, check: Check) -> Check:
        """Decorate what tests a law, called with a back end's name."""
        self.append(Law(check.__name__, check))
        return check

    def law_for(self, cases: Collection[Any]) -> Callable[[Check], Check]:
        """Decorate what tests a law in each of some cases, called with a back end's name and the case."""

        def keep(check: Check) -> Check:
            for k, case in enumerate(cases):
                said = case if isinstance(case, str) else case if isinstance(case, float) else k
                self.append(Law(f"{check.__name__} [{said}]", partial(_of, check, case)))
            return check

        return keep


def _of(check: Check, case: Any, name: str) -> None:
    check(name, case)


@contextlib.contextmanager
def refused(kind: type[Exception], match: str = "") -> Iterator[None]:
    """Within the block an exception of that kind is raised whose words match; AssertionError if not."""
    try:
        yield
    except kind as error:
        assert re.search(match, str(error)), f"found {error}, expected {match}"
    else:
        raise AssertionError(f"nothing was refused, expected {kind.__name__} {match}")
