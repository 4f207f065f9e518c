"""Recorded logs: each reader makes a `Source` of a file, so that a log drives the same loop as the world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from sixthsense.errors import InputError

if TYPE_CHECKING:
    from sixthsense.config import LaserConfig
    from sixthsense.logs.carmen import CarmenLog

_CARMEN = (".log", ".clf", ".carmen")
_COMPRESSED = (".gz", ".bz2")
_BAGS = (".bag", ".mcap", ".db3")


class LogError(InputError):
    """One line that names the file and line, what was found and what is allowed."""


def open_log(file: str | Path, laser: LaserConfig, topics: Sequence[str] = ()) -> CarmenLog:
    """Open a log with the reader of its kind, which the name tells: a file, or a folder of a bag or a run.

    `laser` describes the scanner that recorded it, as far as the log does not; `topics` chooses among a bag's. Raises
    LogError for a kind that is not known, listing those that are, and for a file that the reader cannot make sense of.
    """
    path = Path(file)
    suffixes = [suffix.lower() for suffix in path.suffixes]
    if suffixes and suffixes[-1] in _COMPRESSED:
        suffixes.pop()
    if suffixes and suffixes[-1] in _CARMEN and not path.is_dir():
        from sixthsense.logs.carmen import read_carmen

        return read_carmen(path, laser)
    if not path.exists():
        raise LogError(f"{path}: no such file")
    if is_run_folder(path):
        from sixthsense.logs.runfolder import read_run

        return read_run(path, laser)
    if is_bag(path):
        from sixthsense.logs.rosbag import read_bag

        return read_bag(path, laser, topics)
    kinds = (
        f"CARMEN ({', '.join(_CARMEN)}, also with {' or '.join(_COMPRESSED)}), "
        f"ROS bag ({', '.join(_BAGS)}, or a folder with metadata.yaml), folder of a run"
    )
    raise LogError(f"{path}: found no known kind of log, allowed: {kinds}")


def is_run_folder(path: Path) -> bool:
    """Whether a path is the folder of a run, finished or not."""
    return (path / "config.toml").is_file()


def is_bag(path: Path) -> bool:
    """Whether a path is, by its name, a bag of ROS."""
    return (path / "metadata.yaml").is_file() if path.is_dir() else path.suffix.lower() in _BAGS
