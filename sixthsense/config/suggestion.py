"""The known name that a misspelt one is likely to mean."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_LONGEST = 80  # a longer text is no misspelt name, and comparing it takes time


def did_you_mean(found: object, known: Iterable[str]) -> str:
    """The end of an error message: "; did you mean NAME?" with the known name nearest to `found`, "" if none is near.

    Upper and lower case count as equal.
    """
    if not isinstance(found, str) or len(found) > _LONGEST:
        return ""
    names = {name.lower(): name for name in known}
    near = difflib.get_close_matches(found.lower(), names, 1)
    return f"; did you mean {names[near[0]]}?" if near else ""
