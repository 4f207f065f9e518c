"""What can be wrong with a campaign, and the packages that only a campaign needs."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from sixthsense.config.errors import InputError

EXTRA = "pip install 'sixthsense[campaign]'"


class CampaignError(InputError):
    """One line that names the option, folder or worker, what was found and what is allowed."""


def needed(module: str) -> Any:
    """A module of the packages of the extra `campaign`; CampaignError that says how to install it where it is not."""
    try:
        return import_module(module)
    except ImportError as error:
        raise CampaignError(f"{module}: cannot be imported ({error}), allowed: after {EXTRA}") from None
