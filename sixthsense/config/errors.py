"""The error for wrong input of a user, and what its messages have in common; packages that only an extra installs."""

import difflib
from collections.abc import Iterable

_LONGEST = 80  # a longer text is no misspelt name, and comparing it takes time


class InputError(ValueError):
    """Wrong input of a user, in one line: where it is, what was found there, and what is allowed."""

    def __init__(self, where: object, found: str, allowed: str = "", near: str = "") -> None:
        """Say what was `found`, a phrase, and what is `allowed` in its place; `near` is what may have been meant.

        `where` is the field, the argument, or the file with its line or field. Names of other fields and arguments are
        in backquotes, so that the command line can write them as its options.
        """
        super().__init__(str(where), found, allowed, near)
        self.where, self.found, self.allowed, self.near = str(where), found, allowed, near

    def __str__(self) -> str:
        meant = f", did you mean {self.near}?" if self.near else ""
        allowed = f"{'' if meant else ','} allowed: {self.allowed}" if self.allowed else ""
        return f"{self.where}{': ' * bool(self.where)}{self.found}{meant}{allowed}"

    def at(self, where: object) -> "InputError":
        """The same error at another place."""
        return InputError(where, self.found, self.allowed, self.near)

    def within(self, where: object) -> "InputError":
        """The same error in the file, the section or the argument that `where` names."""
        return self.at(f"{where}: {self.where}" if self.where else where)


class PartError(RuntimeError):
    """A part that is not shipped raised an error, or returned what its contract does not allow."""

    def __init__(self, part: str, found: str, when: str = "") -> None:
        """Say which `part` it is, as "estimator lab.fading:Fading", what was `found`, and `when` in the run."""
        super().__init__(part, found, when)
        self.part, self.found, self.when = part, found, when

    def __str__(self) -> str:
        return f"{self.part}: {self.found}{', ' * bool(self.when)}{self.when}"


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


def did_you_mean(found: object, known: Iterable[str]) -> str:
    """The end of an error message without a list of names: "; did you mean NAME?", "" if no name is near."""
    near = nearest(found, known)
    return f"; did you mean {near}?" if near else ""


def installing(extra: str) -> str:
    """How to install an extra; from a clone, until there is a release."""
    return f"install it with pip install -e '.[{extra}]' in the clone of the repository"
