"""Packages that only an extra installs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from sixthsense.config.errors import InputError


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
