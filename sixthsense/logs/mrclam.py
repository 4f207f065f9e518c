"""The UTIAS multi-robot data set (MRCLAM): odometry and barcode observations of one robot (Leung et al., IJRR 2011)."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from sixthsense.config import AssumedConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import LandmarkId, Observation, polar_observation
from sixthsense.core.motion import rk4, variance
from sixthsense.core.source import Tick, seconds
from sixthsense.logs.finding import Finding
from sixthsense.logs.log import Log, Odometry, ascending, pose_at
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

    Each file is plain or gzip. `robot` is optional if there is only one. Each stamp of odometry, 0.2 s later, or of a
    measurement is a tick. Forward speed and turn rate hold until the next record and are integrated by RK4 from the
    first true pose. Truth is interpolated between Vicon's poses. The log spans the part of the odometry with truth.

    The id of a landmark is the number of its subject; robots (subjects 1 to 5) are skipped. `assumed.laser` has the
    sigmas of range (m) and bearing (rad), both above 0; `assumed.landmark_floor_m` is added on both axes. All
    measurements with one stamp form one time step, with the last observation of each landmark. Cameras sometimes
    misread a barcode: measurements with one that is not in `Barcodes.dat`, and those that no camera makes, are skipped
    and counted.

    The column called range is a depth, the distance along the camera's axis, and is divided by the cosine of the
    bearing: compared with Vicon it is 12 % short at 0.55 rad and correct ahead, as (cos bearing)^0.94 (set 6, robot 3).
    Raises InputError, naming file and line, for anything else.
    """
    path, laser = Path(folder), assumed.laser
    names = sorted({int(match[1]) for file in path.iterdir() if (match := _NAME.fullmatch(file.name))})
    if robot not in names and (robot is not None or len(names) != 1):
        raise InputError(path, f"found odometry of robots {names}", "a MRCLAM folder, and one of these by `robot` N")
    of_robot = f"Robot{names[0] if robot is None else robot}"
    if min(laser.range_m, laser.bearing_rad) <= 0.0:
        raise InputError("assumed.laser", "found a range_m or bearing_rad of 0", "above 0 for ranges and bearings")
    barcodes = _read(path, "Barcodes.dat", "subject barcode").records
    subjects = {record.whole(1, "barcode"): record.whole(0, "subject") for record in barcodes}
    drive = _read(path, f"{of_robot}_Odometry.dat", "stamp speed turn-rate")
    measured = _read(path, f"{of_robot}_Measurement.dat", "stamp barcode range bearing")
    variances = variance(laser.distribution, laser.range_m), variance(laser.distribution, laser.bearing_rad)
    seen: dict[int, dict[LandmarkId, Observation]] = {}
    misread = 0
    for stamp, (barcode, depth, bearing) in zip(measured.stamps_ns(), measured.numbers[:, 1:].tolist(), strict=True):
        subject = subjects.get(int(barcode))
        if subject is None or depth <= 0.0 or abs(bearing) > _WIDEST_RAD:
            misread += 1
        elif subject not in _ROBOTS:
            found = polar_observation(depth / math.cos(bearing), bearing, variances, assumed.landmark_floor_m)
            seen.setdefault(int(stamp), {})[subject] = found
    vicon = _read(path, f"{of_robot}_Groundtruth.dat", "stamp x y orientation")
    truth = Odometry(ascending(vicon.stamps_ns()), vicon.numbers[:, 1:])
    ticks = _ticks(drive, seen, truth)
    if not ticks:
        raise InputError(path, "found truth at no stamp of the odometry", "of the same drive")
    unread = Finding("left_out", misread, place="measurements with an unknown barcode are skipped")
    return Log(ticks, found=[unread] * (misread > 0))


def _ticks(drive: Table, seen: dict[int, dict[LandmarkId, Observation]], truth: Odometry) -> list[Tick]:
    # the last record of each stamp
    rates = dict(zip((drive.stamps_ns() + _DELAY_NS).tolist(), drive.numbers[:, 1:].tolist(), strict=True))
    first, last = max(min(rates), int(truth.stamps_ns[0])), min(max(rates), int(truth.stamps_ns[-1]))
    stamps = [stamp for stamp in sorted({*rates, *seen}) if first <= stamp <= last]
    truths = [Pose.from_array(row) for row in pose_at(truth, np.array(stamps, dtype=np.int64), math.inf)]
    ticks: list[Tick] = []
    speed, turn_rate = rates[max(stamp for stamp in rates if stamp <= first)]
    for stamp, true in zip(stamps, truths, strict=True):
        pose = rk4(ticks[-1].odometry, speed, turn_rate, seconds(stamp - ticks[-1].stamp_ns)) if ticks else true
        speed, turn_rate = rates.get(stamp, (speed, turn_rate))
        ticks.append(Tick(stamp, pose, observations=seen.get(stamp, {}), truth=true))
    return ticks


def _read(folder: Path, name: str, columns: str) -> Table:
    """The file of this name, plain or compressed."""
    return read_table(next(folder.glob(f"{name}*"), folder / name), columns)
