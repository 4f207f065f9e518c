"""The error for wrong input of a user, and what its messages have in common; packages that only an extra installs."""

import difflib
from collections.abc import Iterable
from importlib import import_module
from typing import Any

_LONGEST = 80  # a longer text is no misspelt name, and comparing it takes time


class InputError(ValueError):
    """Wrong input of a user: one line with the file, line or field, what was found and what is allowed."""


def reason_of(error: BaseException, longest: int = 160) -> str:
    """What an error of a library says, for a message: one line of at most so many letters."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return reason if len(reason) <= longest else f"{reason[:longest]}..."


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


class ExtraError(InputError):
    """One line that names the package and how to install it."""


def import_extra(module: str, extra: str, error: type[InputError] = ExtraError) -> Any:
    """A module that an extra installs; `error`, in one line that says how to install it, if it is missing."""
    try:
        return import_module(module)
    except ImportError as cause:
        allowed = f"allowed: after pip install 'sixthsense[{extra}]'"
        raise error(f"{module}: cannot be imported ({cause}), {allowed}") from None


def pandas() -> Any:
    """The module pandas."""
    return import_extra("pandas", "notebooks")
