"""The UTIAS multi-robot data set (MRCLAM): odometry and barcode observations of one robot (Leung et al., IJRR 2011)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from sixthsense.config import AssumedConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import LandmarkId, Observation, polar_observation
from sixthsense.core.motion import rk4, variance
from sixthsense.core.source import Tick
from sixthsense.logs.finding import Finding
from sixthsense.logs.joining import Odometry, pose_at
from sixthsense.logs.log import Log
from sixthsense.logs.stamps import ascending
from sixthsense.logs.text_lines import Table, read_table

_ROBOTS = range(1, 6)
"""ids of robots among the subjects"""
_WIDEST_RAD = 1.5
"""largest bearing: a camera sees only ahead of its image plane"""
_DELAY_NS = 200_000_000
"""from a command, which is what the log has as odometry, to the robot's motion, by Vicon"""
_NAME = re.compile(r"Robot([1-9][0-9]{0,8})_Odometry\.dat(\.gz)?")


def read_mrclam(folder: str | Path, assumed: AssumedConfig, robot: int | None = None) -> Log:
    """Read `Barcodes.dat` and one robot's `RobotN_Odometry.dat`, `_Measurement.dat` and `_Groundtruth.dat`.

    Each file is plain or gzip; `_Groundtruth.dat` and `Landmark_Groundtruth.dat` are optional. `robot` is optional if
    there is only one. Each stamp of odometry, 0.2 s later, or of a measurement is a tick. Forward speed and turn rate
    hold until the next record and are integrated by RK4 from the first true pose, or from zero without truth. Truth is
    interpolated between Vicon's poses. The log spans the odometry, and with truth only its part with truth.

    The id of a landmark is the number of its subject; robots (subjects 1 to 5) are skipped. `assumed.laser` has the
    sigmas of range (m) and bearing (rad), both above 0; `assumed.landmark_floor_m` is added on both axes. All
    measurements with one stamp form one time step, with the last observation of each landmark. Cameras sometimes
    misread a barcode: measurements with one that is not in `Barcodes.dat`, and those that no camera makes, are skipped
    and counted.

    The column called range is a depth, the distance along the camera's axis, and is divided by the cosine of the
    bearing: compared with Vicon it is 12 % short at 0.55 rad and correct ahead, as (cos bearing)^0.94 (set 6, robot 3).
    Raises InputError, naming file and line, for anything else.
    """
    path = Path(folder)
    robot = _chosen(path, robot)
    for name, sigma in (("range_m", assumed.laser.range_m), ("bearing_rad", assumed.laser.bearing_rad)):
        if sigma <= 0.0:
            raise InputError(path, f"found assumed.laser.{name} {sigma:g}", "above 0 for ranges and bearings")
    barcodes = _read(path, "Barcodes.dat", "subject barcode").records
    subjects = {record.whole(1, "barcode"): record.whole(0, "subject") for record in barcodes}
    drive = _read(path, f"Robot{robot}_Odometry.dat", "stamp speed turn-rate")
    measured = _read(path, f"Robot{robot}_Measurement.dat", "stamp barcode range bearing")
    seen, misread = _observations(measured, subjects, assumed)
    truth = None
    if _existing(path, f"Robot{robot}_Groundtruth.dat"):
        vicon = _read(path, f"Robot{robot}_Groundtruth.dat", "stamp x y orientation")
        truth = Odometry(ascending(vicon.stamps_ns()), vicon.numbers[:, 1:])
    ticks = _ticks(drive, seen, truth)
    if not ticks:
        raise InputError(path, "found truth at no stamp of the odometry", "of the same drive")
    unread = Finding("left_out", misread, place="measurements with an unknown barcode are skipped")
    return Log(ticks, found=[unread] * (misread > 0))


def _ticks(drive: Table, seen: Mapping[int, dict[LandmarkId, Observation]], truth: Odometry | None) -> list[Tick]:
    stamps_ns = (drive.stamps_ns() + _DELAY_NS).tolist()
    rates = dict(zip(stamps_ns, drive.numbers[:, 1:].tolist(), strict=True))  # the last record of each stamp
    first, last = min(rates), max(rates)
    if truth is not None:
        first, last = max(first, int(truth.stamps_ns[0])), min(last, int(truth.stamps_ns[-1]))
    stamps = [stamp for stamp in sorted({*rates, *seen}) if first <= stamp <= last]
    if not stamps:
        return []
    truths: list[Pose | None] = [None] * len(stamps)
    if truth is not None:
        truths = [Pose.from_array(row) for row in pose_at(truth, np.array(stamps, dtype=np.int64), math.inf)]
    pose, before = truths[0] or Pose(), stamps[0]
    speed, turn_rate = rates[max(stamp for stamp in rates if stamp <= before)]
    ticks = []
    for stamp, true in zip(stamps, truths, strict=True):
        pose = rk4(pose, speed, turn_rate, 1e-9 * (stamp - before))
        before = stamp
        speed, turn_rate = rates.get(stamp, (speed, turn_rate))
        ticks.append(Tick(stamp, pose, observations=seen.get(stamp, {}), truth=true))
    return ticks


def _observations(
    table: Table, subjects: Mapping[int, int], assumed: AssumedConfig
) -> tuple[dict[int, dict[LandmarkId, Observation]], int]:
    """Observations of landmarks by stamp (ns), and the number of measurements that are skipped."""
    laser, misread = assumed.laser, 0
    variances = variance(laser.distribution, laser.range_m), variance(laser.distribution, laser.bearing_rad)
    seen: dict[int, dict[LandmarkId, Observation]] = {}
    for stamp, (_, barcode, depth, bearing) in zip(table.stamps_ns().tolist(), table.numbers.tolist(), strict=True):
        subject = subjects.get(int(barcode))
        if subject is None or depth <= 0.0 or abs(bearing) > _WIDEST_RAD:
            misread += 1
        elif subject not in _ROBOTS:
            found = polar_observation(depth / math.cos(bearing), bearing, variances, assumed.landmark_floor_m)
            seen.setdefault(stamp, {})[subject] = found
    return seen, misread


def true_landmarks(folder: Path) -> dict[LandmarkId, Array]:
    """True positions (2,) of the landmarks, world frame, metres; none if the folder has none. For evaluation only."""
    if not _existing(folder, "Landmark_Groundtruth.dat"):
        return {}
    table = _read(folder, "Landmark_Groundtruth.dat", "subject x y sigma-x sigma-y")
    return {int(subject): place for subject, place in zip(table.numbers[:, 0], table.numbers[:, 1:3], strict=True)}


def _chosen(folder: Path, robot: int | None) -> int:
    found = sorted({int(match[1]) for file in folder.iterdir() if (match := _NAME.fullmatch(file.name))})
    if not found:
        raise InputError(folder, "found no RobotN_Odometry.dat", "a MRCLAM folder, files plain or .gz")
    if robot not in found and (robot is not None or len(found) > 1):
        raise InputError(folder, f"found robots {', '.join(map(str, found))}", "one, by `robot` N")
    return found[0] if robot is None else robot


def _existing(folder: Path, name: str) -> Path | None:
    return next((file for file in (folder / name, folder / f"{name}.gz") if file.is_file()), None)


def _read(folder: Path, name: str, columns: str) -> Table:
    if (file := _existing(folder, name)) is None:
        raise InputError(folder, f"found no {name}", "a MRCLAM folder with it, plain or .gz")
    return read_table(file, columns)
