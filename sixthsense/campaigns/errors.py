"""The errors of campaigns, and the import of the packages that only campaigns need."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from sixthsense.config.errors import InputError

EXTRA = "pip install 'sixthsense[campaign]'"


class CampaignError(InputError):
    """An invalid option, folder or worker: one line with what was found and what is allowed."""


def import_extra(module: str) -> Any:
    """Import a module of the extra `campaign`; raises CampaignError with the command that installs it."""
    try:
        return import_module(module)
    except ImportError as error:
        raise CampaignError(f"{module}: cannot be imported ({error}), allowed: after {EXTRA}") from None
