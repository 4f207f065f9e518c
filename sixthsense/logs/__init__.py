"""Recorded logs: each reader returns a `Log`, whose ticks drive the same loop as the simulated world."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from sixthsense.config.errors import InputError

if TYPE_CHECKING:
    from sixthsense.config import AssumedConfig, LaserConfig
    from sixthsense.logs.log import Log

_CARMEN = (".log", ".clf", ".carmen")
_COMPRESSED = (".gz", ".bz2", ".xz")
_BAGS = (".bag", ".mcap", ".db3")
_GRAPHS = (".graph", ".g2o")
_MRCLAM = ("Barcodes.dat*", "Robot*_Odometry.dat*", "Robot*_Measurement.dat*")


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

    path = Path(file)
    kind = kind_of(path)
    if kind == "carmen":
        from sixthsense.logs.carmen import read_carmen

        return read_carmen(path, laser)
    if kind == "graph":
        from sixthsense.logs.graph import read_graph

        return read_graph(path)
    if kind == "run":
        from sixthsense.logs.runfolder import read_run

        return read_run(path, laser or LaserConfig())
    if kind == "bag":
        from sixthsense.logs.rosbag import How, read_bag
        from sixthsense.logs.transforms import frame_pair

        return read_bag(path, laser or LaserConfig(), How(topics, frame_pair(odometry_frames), odometry))
    if kind == "mrclam":
        from sixthsense.logs.mrclam import read_mrclam

        return read_mrclam(path, assumed or preset("mrclam").assumed, robot)
    if not path.exists():
        raise InputError(path, "no such file")
    if path.name.endswith((".db3.zstd", ".mcap.zstd")):
        allowed = "its folder with metadata.yaml, or what `zstd -d` makes of it"
        raise InputError(path, "found a piece of a compressed bag", allowed)
    compressed = f"also with {' or '.join(_COMPRESSED)}"
    kinds = (
        f"CARMEN ({', '.join(_CARMEN)}, {compressed}), graph ({', '.join(_GRAPHS)}, {compressed}), "
        f"ROS bag ({', '.join(_BAGS)}, or a folder of them), folder of a run, folder of MRCLAM"
    )
    raise InputError(path, "found no known kind of log", kinds)


def kind_of(path: Path) -> Literal["carmen", "graph", "run", "bag", "mrclam", ""]:
    """How a log is read, by its name or what is in it; "" if that is not known."""
    from sixthsense.logs.bag_file import bag_files, suffix_of
    from sixthsense.logs.carmen import MESSAGES
    from sixthsense.logs.graph import TAGS
    from sixthsense.logs.text_lines import first_word

    if path.is_dir():
        if is_run_folder(path):
            return "run"
        if (path / "metadata.yaml").is_file() or bag_files(path):
            return "bag"
        return "mrclam" if any(next(path.glob(name), None) is not None for name in _MRCLAM) else ""
    suffixes = [suffix.lower() for suffix in path.suffixes]
    suffix = next((each for each in reversed(suffixes) if each not in _COMPRESSED), "")
    if suffix_of(path) or suffix in _BAGS:
        return "bag"
    if suffix in (*_CARMEN, *_GRAPHS):
        return "carmen" if suffix in _CARMEN else "graph"
    word = first_word(path)
    return "graph" if word in TAGS else "carmen" if word in MESSAGES else ""


def is_run_folder(path: Path) -> bool:
    """Whether a path is a run folder, finished or not."""
    return (path / "config.toml").is_file()
