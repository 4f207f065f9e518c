"""Recorded logs: each reader returns a `Log`, whose ticks drive the same loop as the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sixthsense.config.errors import InputError

if TYPE_CHECKING:
    from sixthsense.config import AssumedConfig, LaserConfig
    from sixthsense.logs.log import Log

_COMPRESSED = (".gz", ".bz2", ".xz")
_SUFFIXES: dict[str | bytes, Literal["carmen", "graph", "bag"]] = {
    ".log": "carmen", ".clf": "carmen", ".carmen": "carmen", ".graph": "graph", ".g2o": "graph",
    ".bag": "bag", ".mcap": "bag", ".db3": "bag",
}  # fmt: skip
_ALLOWED = (
    "CARMEN (.log, .clf, .carmen), graph (.graph, .g2o), both also with .gz or .bz2 or .xz, ROS bag (.bag, .mcap, .db3,"
    " or a folder of them; `zstd -d` makes one of a .zstd), folder of a run, folder of MRCLAM"
)


def open_log(
    file: str | Path,
    laser: LaserConfig | None = None,
    topics: Sequence[str] = (),
    robot: int | None = None,
    assumed: AssumedConfig | None = None,
    odometry_frames: Sequence[str] = (),
    odometry: bool = True,
) -> Log:
    """Open a log, a file or a folder, with the reader of its kind, recognised by its name, or else by how it begins.

    The log says what its laser is. Fields of `laser` that were stated take precedence, such as that of
    `ss.LaserConfig(max_range=8.0)`; a bag takes its mount alone. `topics` selects topics of a bag, `odometry_frames`
    the parent and the child of its odometry in /tf; without `odometry` the bag's is not read. `robot` selects a robot
    of a MRCLAM folder; its ranges and bearings have the noise of `assumed.laser`, by default of the preset mrclam.
    Raises InputError for an unknown kind, with the known ones, and for a file that the reader cannot read.
    """
    from sixthsense.config import LaserConfig, preset
    from sixthsense.logs import carmen, graph, mrclam, rosbag, runfolder

    path, laser = Path(file), laser or LaserConfig()
    readers = {
        "carmen": lambda: carmen.read_carmen(path, laser),
        "graph": lambda: graph.read_graph(path),
        "run": lambda: runfolder.read_run(path, laser),
        "bag": lambda: rosbag.read_bag(path, laser, topics, odometry_frames, odometry),
        "mrclam": lambda: mrclam.read_mrclam(path, assumed or preset("mrclam").assumed, robot),
    }
    if reader := readers.get(kind_of(path)):
        return reader()
    raise InputError(path, *(("found no known kind of log", _ALLOWED) if path.exists() else ("no such file",)))


def kind_of(path: Path) -> Literal["carmen", "graph", "run", "bag", "mrclam", ""]:
    """How a log is read, by its name or what is in it; "" if that is not known."""
    from sixthsense.logs.carmen import MESSAGES
    from sixthsense.logs.graph import TAGS
    from sixthsense.logs.rosbag import bag_files, suffix_of
    from sixthsense.logs.text_lines import first_word

    if path.is_dir():
        if is_run_folder(path):
            return "run"
        is_bag = (path / "metadata.yaml").is_file() or bag_files(path)
        return "bag" if is_bag else "mrclam" if any(path.glob("Robot*_*.dat*")) else ""
    if suffix_of(path):
        return "bag"
    suffixes = [suffix.lower() for suffix in path.suffixes if suffix.lower() not in _COMPRESSED]
    word = suffixes[-1] if suffixes and suffixes[-1] in _SUFFIXES else first_word(path)
    return _SUFFIXES.get(word) or ("graph" if word in TAGS else "carmen" if word in MESSAGES else "")


def is_run_folder(path: Path) -> bool:
    """Whether a path is a run folder, finished or not."""
    return (path / "config.toml").is_file()
