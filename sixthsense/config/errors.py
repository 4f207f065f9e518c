"""The one kind of error that a user can cause."""


class InputError(ValueError):
    """What a user gave will not do: one line with the file, line or field, what was found and what is allowed."""
