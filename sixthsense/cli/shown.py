"""How the help shows an option of a command."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Shown:
    """An annotation of an option's type."""

    metavar: str = ""
    """name of its value in the help"""
    is_positional: bool = False
    """an argument without a flag"""


def arg(metavar: str = "") -> Shown:
    """The annotation of an option whose value the help calls `metavar`."""
    return Shown(metavar)


def positional() -> Shown:
    """The annotation of a positional argument."""
    return Shown(is_positional=True)
