"""What is in the folder of a run. Only a folder that holds a run, and nothing else, may be replaced."""

from __future__ import annotations

import os
import stat
import tomllib
from collections.abc import Iterator
from pathlib import Path

from sixthsense.record.stream import FILE

FILES = frozenset(
    {
        "config.toml", FILE, "record.npz", "grid.npz", "metrics.json", "places_left.csv",
        "estimate.tum", "smoothed.tum", "truth.tum", "landmarks.csv", "landmarks.npz",
        "graph.g2o", "graph.npz", "map.pgm", "map.yaml",
        "bag/bag_0.mcap", "bag/metadata.yaml", "figures/report.html", "figures/animation.gif",
    }
)  # fmt: skip
"""files of a run and of its report, but for the figures"""
FIGURES = frozenset({"map", "error", "rpe", "nees", "nis", "stages", "coverage", "exploration"})
"""names of the figures, without suffix"""

_FORMS = (".png", ".svg", ".pdf")
_FOLDERS = ("bag", "figures")
_BAG_BEGINS, _RECORD_BEGINS = b"\x89MCAP0\r\n", b'{"format":'


def reason_not_a_run(folder: Path) -> str:
    """Why a path is not the folder of one run and nothing else: "is a file", "holds notes.txt"; "" if it is."""
    if reason := reason_not_started(folder):
        return reason
    if not has_record(folder) and not _begins(folder / "bag" / "bag_0.mcap", _BAG_BEGINS):  # an older version's
        return "holds no record of a run"
    foreign = next(foreign_entries(folder), None)
    return "" if foreign is None else f"holds {foreign}, which no run writes"


def reason_not_started(folder: Path) -> str:
    """Why no run has begun in this path: "is a file", "holds no config.toml of a run"; "" if one has."""
    if folder.is_symlink():
        return "is a symbolic link"
    if not folder.is_dir():
        return "is a file"
    return "" if _is_configuration(folder / "config.toml") else "holds no config.toml of a run"


def has_record(folder: Path) -> bool:
    """Whether a tick of a run has been recorded in the folder."""
    return _begins(folder / FILE, _RECORD_BEGINS)


def foreign_entries(folder: Path) -> Iterator[str]:
    """The paths within a folder, relative to it, that neither a run nor its report writes."""
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        if entry.name in _FOLDERS and entry.is_dir(follow_symlinks=False):
            yield from (
                f"{entry.name}/{inner.name}" for inner in os.scandir(entry.path) if not _is_known(inner, entry.name)
            )
        elif not _is_known(entry):
            yield entry.name


def _is_known(entry: os.DirEntry[str], within: str = "") -> bool:
    if not entry.is_file(follow_symlinks=False):
        return False
    file = Path(entry.name)
    is_figure = within == "figures" and file.stem in FIGURES and file.suffix in _FORMS
    return is_figure or (f"{within}/{entry.name}" if within else entry.name) in FILES


def _is_configuration(file: Path) -> bool:
    """Whether a file is a configuration that a run saved: it names the version of this package that ran it."""
    try:
        if not stat.S_ISREG(file.lstat().st_mode):
            return False
        versions = tomllib.loads(file.read_text(encoding="utf-8-sig")).get("versions")
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(versions, dict) and isinstance(versions.get("sixthsense"), str)


def _begins(file: Path, content: bytes) -> bool:
    try:
        with file.open("rb") as stream:
            return stream.read(len(content)) == content
    except OSError:
        return False
