"""Packages that only an extra installs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from sixthsense.config.errors import InputError


class ExtraError(InputError):
    """One line that names the package and how to install it."""


def pandas() -> Any:
    """The module; ExtraError that says how to install it if it is missing."""
    try:
        return import_module("pandas")
    except ImportError as error:
        allowed = "allowed: after pip install 'sixthsense[notebooks]'"
        raise ExtraError(f"pandas: cannot be imported ({error}), {allowed}") from None
