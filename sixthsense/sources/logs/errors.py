"""What is wrong with a log."""

from __future__ import annotations

from sixthsense.config.errors import InputError


class LogError(InputError):
    """One line that names the file and line, what was found and what is allowed."""
