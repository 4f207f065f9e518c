"""The six golden runs. None is at the identity: start, mount, the map's origin and its shape are general."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import sixthsense as ss
from golden import drives
from golden.drives import Drive
from sixthsense.logs.replay_input import open_recorded
from sixthsense.record.folder import RunFolder
from sixthsense.running.merging import merged_log, replay_merged
from sixthsense.running.runs import QUIET

ROUND, OTHER_WAY = Drive(2.4, 0.31, 11), Drive(-0.7, -0.27, 12)
SHORT = Drive(0.9, 0.31, 13, scans=60)


def simulated(folder: Path, shift_m: float) -> None:
    """A tour in the simulator: landmarks with ekf-invariant."""
    drives.scene_file(folder / "room.toml")
    laser = {"beams": drives.BEAMS, "fov": 3.9, "max_range": drives.MAX_RANGE, "mount": tuple(drives.MOUNT.array())}
    noise = {"laser": {"range_m": drives.SIGMA_M + shift_m}}
    ss.run(
        folder / "room.toml", estimator="ekf-invariant", task="tour", seed=7, max_time=9.0, laser=laser, world=noise,
        out=folder / "run", progress=False,
    )  # fmt: skip


def smoothed(folder: Path, shift_m: float) -> None:
    """A recorded drive: landmarks with isam2."""
    drives.run_folder(ROUND, folder / "drive", shift_m)
    ss.replay(folder / "drive", estimator="isam2", out=folder / "run", progress=False)


def matched(folder: Path, shift_m: float) -> None:
    """A recorded drive: scan matching."""
    drives.run_folder(OTHER_WAY, folder / "drive", shift_m)
    settings = {"front_end": "scan-matching", "estimator": "isam2"}
    ss.replay(folder / "drive", **settings, out=folder / "run", progress=False)


def carmen(folder: Path, shift_m: float) -> None:
    """A CARMEN log with relations."""
    drives.carmen_file(ROUND, folder / "drive.log", shift_m)
    drives.relations_file(ROUND, folder / "drive.relations")
    ss.replay(folder / "drive.log", relations=folder / "drive.relations", out=folder / "run", progress=False)


def bag(folder: Path, shift_m: float) -> None:
    """A bag whose laser is mounted aside and turned, with relations."""
    drives.bag_folder(OTHER_WAY, folder / "bag", shift_m)
    drives.relations_file(OTHER_WAY, folder / "drive.relations")
    ss.replay(folder / "bag", relations=folder / "drive.relations", out=folder / "run", progress=False)


def merged(folder: Path, shift_m: float) -> None:
    """Two recorded drives as one."""
    runs = []
    for name, drive in (("first", OTHER_WAY), ("second", SHORT)):
        drives.run_folder(drive, folder / name, shift_m)
        config = ss.load_config(folder / name / "config.toml")
        runs.append(open_recorded(folder / name, config.replaced(front_end="scan-matching", estimator="isam2")))
    with RunFolder(folder / "run", runs[0].config) as out:
        replay_merged(merged_log(*runs), out, QUIET)


CASES: dict[str, Callable[[Path, float], None]] = {
    "landmarks-ekf-invariant": simulated, "landmarks-isam2": smoothed, "scan-matching": matched, "carmen": carmen,
    "bag": bag, "merge": merged,
}  # fmt: skip
