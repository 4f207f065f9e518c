"""Recorded logs: each reader makes a `Source` of a file, so that a log drives the same loop as the world."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from sixthsense.errors import InputError

if TYPE_CHECKING:
    from sixthsense.config import LaserConfig
    from sixthsense.logs.carmen import CarmenLog

_CARMEN = (".log", ".clf", ".carmen")
_COMPRESSED = (".gz", ".bz2")


class LogError(InputError):
    """One line that names the file and line, what was found and what is allowed."""


def open_log(file: str | Path, laser: LaserConfig) -> CarmenLog:
    """Open a log with the reader of its kind, which the file's name tells.

    `laser` describes the scanner that recorded it. Raises LogError for a kind that is not known, listing those that
    are, and for a file that the reader cannot make sense of.
    """
    path = Path(file)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] in _COMPRESSED:
        suffixes.pop()
    if suffixes and suffixes[-1] in _CARMEN:
        from sixthsense.logs.carmen import read_carmen

        return read_carmen(path, laser)
    if not path.exists():
        raise LogError(f"{path}: no such file")
    kinds = f"CARMEN ({', '.join(_CARMEN)}, also with {' or '.join(_COMPRESSED)})"
    raise LogError(f"{path}: found no known kind of log, allowed: {kinds}")
