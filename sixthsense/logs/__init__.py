"""Recorded logs: each reader returns a `Log`, whose ticks drive the same loop as the simulated world."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sixthsense.config.errors import InputError

if TYPE_CHECKING:
    from sixthsense.config import AssumedConfig, LaserConfig
    from sixthsense.logs.log import Log

_ALLOWED = (
    "CARMEN, graph of GTSAM or g2o, both also with .gz or .bz2 or .xz, ROS bag (.bag, .mcap, .db3, or a folder of them;"
    " `zstd -d` makes one of a .zstd), folder of a run, folder of MRCLAM"
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
    """Open a log, a file or a folder, with the reader of its kind, recognised by what is in it.

    The log says what its laser is. Fields of `laser` that were stated take precedence, such as that of
    `ss.LaserConfig(max_range=8.0)`; of a bag they are its mount, and its maximum range where messages have none.
    `topics` selects topics of a bag, `odometry_frames` the parent and the child of its odometry in /tf; without
    `odometry` the bag's is not read. `robot` selects a robot of a MRCLAM folder; its ranges and bearings have the noise
    of `assumed.laser`, by default of the preset mrclam.
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
    raise InputError(path, "found no known kind of log", _ALLOWED)


def kind_of(path: Path) -> Literal["carmen", "graph", "run", "bag", "mrclam", ""]:
    """How a log is read, by what is in it: a text by its first line that is known; "" if none is.

    Raises InputError for a text that cannot be read.
    """
    from sixthsense.logs.carmen import MESSAGES
    from sixthsense.logs.graph import TAGS
    from sixthsense.logs.rosbag import bag_files, suffix_of
    from sixthsense.logs.text_lines import records

    if path.is_dir():
        if (path / "config.toml").is_file():
            return "run"
        is_bag = (path / "metadata.yaml").is_file() or bag_files(path)
        return "bag" if is_bag else "mrclam" if any(path.glob("Robot*_*.dat*")) else ""
    if suffix_of(path):
        return "bag"
    words = (record.fields[0] for record in itertools.islice(records(path), 10_000))  # a film has more
    return next(("graph" if word in TAGS else "carmen" for word in words if word in TAGS or word in MESSAGES), "")
