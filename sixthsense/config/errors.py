"""The error for wrong input of a user."""


class InputError(ValueError):
    """Wrong input of a user: one line with the file, line or field, what was found and what is allowed."""
