"""The known name that a misspelt one is likely to mean, and how an error message says so."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

_LONGEST = 80  # a longer text is no misspelt name, and comparing it takes time


def nearest(found: object, known: Iterable[str]) -> str:
    """The known name nearest to `found`, "" if none is near. Upper and lower case count as equal."""
    if not isinstance(found, str) or len(found) > _LONGEST:
        return ""
    names = {name.lower(): name for name in known}
    near = difflib.get_close_matches(found.lower(), names, 1)
    return names[near[0]] if near else ""


def allowed_names(names: Iterable[str], near: str = "", otherwise: str = "") -> str:
    """The end of an error message, the nearest name first: "did you mean NAME? allowed: NAME, NAME".

    `near` is the nearest name, "" for none; `otherwise` follows the list.
    """
    return f"{f'did you mean {near}? ' if near else ''}allowed: {', '.join(names)}{otherwise}"


def did_you_mean(found: object, known: Iterable[str]) -> str:
    """The end of an error message without a list of names: "; did you mean NAME?", "" if no name is near."""
    near = nearest(found, known)
    return f"; did you mean {near}?" if near else ""
