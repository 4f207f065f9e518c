"""The error for wrong input of a user."""


class InputError(ValueError):
    """Wrong input of a user: one line with the file, line or field, what was found and what is allowed."""


def reason_of(error: BaseException, longest: int = 160) -> str:
    """What an error of a library says, for a message: one line of at most so many letters."""
    reason = " ".join(str(error).split()) or type(error).__name__
    return reason if len(reason) <= longest else f"{reason[:longest]}..."
