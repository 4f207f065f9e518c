"""How the help shows an option; tyro, which prints the help, is loaded for that alone."""

from __future__ import annotations

import sys
from typing import Any


def arg(**options: str) -> Any:
    """The annotation of an option, `metavar` or `name`; None where no help is printed."""
    return sys.modules["tyro"].conf.arg(**options) if "tyro" in sys.modules else None


def positional() -> Any:
    """The annotation of a positional argument; None where no help is printed."""
    return sys.modules["tyro"].conf.Positional if "tyro" in sys.modules else None
