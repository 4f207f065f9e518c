"""The UTIAS multi-robot data set (MRCLAM): odometry and barcode observations of one robot (Leung et al., IJRR 2011)."""

from __future__ import annotations

import itertools
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
from sixthsense.logs.text_lines import Record, Table, read_table, shown

_ROBOTS = range(1, 6)
"""ids of robots among the subjects"""
_FARTHEST_M = 1000.0
_WIDEST_RAD = 1.5
"""largest bearing: a camera sees only ahead of its image plane"""
_MISREAD = 0.01
"""largest accepted share of measurements with an unknown barcode"""
_DELAY_NS = 200_000_000
"""from a command, which is what the log has as odometry, to the robot's motion, by Vicon"""
_NAME = re.compile(r"Robot([1-9][0-9]{0,8})_Odometry\.dat(\.gz)?")


def robots(folder: Path) -> list[int]:
    """The numbers of the robots with odometry in a folder."""
    return sorted({int(match[1]) for file in folder.iterdir() if (match := _NAME.fullmatch(file.name))})


def read_mrclam(folder: str | Path, assumed: AssumedConfig, robot: int | None = None) -> Log:
    """Read `Barcodes.dat` and one robot's `RobotN_Odometry.dat`, `_Measurement.dat` and `_Groundtruth.dat`.

    Each file is plain or gzip; `_Groundtruth.dat` and `Landmark_Groundtruth.dat` are optional. `robot` is optional if
    there is only one. Each stamp of odometry, 0.2 s later, or of a measurement is a tick. Forward speed and turn rate
    hold until the next record and are integrated by RK4 from the first true pose, or from zero without truth. Truth is
    interpolated between Vicon's poses. The log spans the odometry, and with truth only its part with truth.

    The id of a landmark is the number of its subject; robots (subjects 1 to 5) are skipped. `assumed.laser` has the
    sigmas of range (m) and bearing (rad), both above 0; `assumed.landmark_floor_m` is added on both axes. All
    measurements with one stamp form one time step, with at most one observation of each landmark. Cameras sometimes
    misread a barcode: up to 1 % of the measurements may have a barcode that is not in `Barcodes.dat`; these are
    skipped.

    The column called range is a depth, the distance along the camera's axis, and is divided by the cosine of the
    bearing: compared with Vicon it is 12 % short at 0.55 rad and correct ahead, as (cos bearing)^0.94 (set 6, robot 3).
    Raises InputError, naming file and line, for anything else.
    """
    path = Path(folder)
    robot = _chosen(path, robot)
    for name, sigma in (("range_m", assumed.laser.range_m), ("bearing_rad", assumed.laser.bearing_rad)):
        if sigma <= 0.0:
            raise InputError(path, f"found assumed.laser.{name} {sigma:g}", "above 0 for ranges and bearings")
    subjects = _subjects(_file(path, "Barcodes.dat"))
    drive = read_table(_file(path, f"Robot{robot}_Odometry.dat"), "stamp speed turn-rate")
    seen, misread = _observations(_file(path, f"Robot{robot}_Measurement.dat"), subjects, assumed)
    vicon = _existing(path, f"Robot{robot}_Groundtruth.dat")
    table = None if vicon is None else read_table(vicon, "stamp x y orientation")
    truth = None if table is None else Odometry(np.array(_ascending_ns(table)), table.numbers[:, 1:])
    ticks = _ticks(drive, seen, truth)
    if not ticks:
        raise InputError(vicon, "found truth at no stamp of the odometry", "of the same drive")
    unread = Finding("left_out", misread, place="measurements with an unknown barcode are skipped")
    return Log(ticks, found=[unread] * (misread > 0))


def _ticks(drive: Table, seen: Mapping[int, dict[LandmarkId, Observation]], truth: Odometry | None) -> list[Tick]:
    rates = {  # the last record of each stamp
        stamp + _DELAY_NS: row for stamp, row in zip(_ascending_ns(drive), drive.numbers[:, 1:].tolist(), strict=True)
    }
    first, last = min(rates), max(rates)
    if truth is not None:
        first, last = max(first, int(truth.stamps_ns[0])), min(last, int(truth.stamps_ns[-1]))
    stamps = [stamp for stamp in sorted({*rates, *seen}) if first <= stamp <= last]
    if not stamps:
        return []
    truths: list[Pose | None] = [None] * len(stamps)
    if truth is not None:
        at_ns = np.array(stamps, dtype=np.int64)
        truths = [Pose.from_array(row) for row in pose_at(truth, at_ns, math.inf)]
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
    file: Path, subjects: Mapping[int, int], assumed: AssumedConfig
) -> tuple[dict[int, dict[LandmarkId, Observation]], int]:
    """Observations of landmarks by stamp (ns), and the number of measurements with an unknown barcode."""
    table = read_table(file, "stamp barcode range bearing")
    table.check(2, "range", 1e-3, _FARTHEST_M)
    table.check(3, "bearing", -_WIDEST_RAD, _WIDEST_RAD)
    laser = assumed.laser
    variances = variance(laser.distribution, laser.range_m), variance(laser.distribution, laser.bearing_rad)
    seen: dict[int, dict[LandmarkId, Observation]] = {}
    unknown: list[Record] = []
    for record, stamp, row in zip(table.records, _ascending_ns(table), table.numbers.tolist(), strict=True):
        barcode = record.whole(1, "barcode")
        if barcode not in subjects:
            unknown.append(record)
            continue
        subject = subjects[barcode]
        if subject in _ROBOTS:
            continue
        step = seen.setdefault(stamp, {})
        if subject in step:
            record.fail(
                f"found landmark {subject} (barcode {barcode}) again at the same stamp, allowed: once per time step"
            )
        step[subject] = polar_observation(row[2] / math.cos(row[3]), row[3], variances, assumed.landmark_floor_m)
    if len(unknown) > _MISREAD * len(table.records):
        barcodes = ", ".join(map(str, sorted(subjects)))
        unknown[0].fail(f"found barcode {shown(unknown[0].fields[1])}, allowed: those of Barcodes.dat, {barcodes}")
    return seen, len(unknown)


def _subjects(file: Path) -> dict[int, int]:
    """Subject of each barcode, by barcode."""
    subjects: dict[int, int] = {}
    for record in read_table(file, "subject barcode").records:
        subject, barcode = record.whole(0, "subject"), record.whole(1, "barcode")
        if barcode in subjects or subject in subjects.values():
            record.fail(f"found subject {subject} with barcode {barcode}, allowed: each once")
        subjects[barcode] = subject
    return subjects


def true_landmarks(folder: Path) -> dict[LandmarkId, Array]:
    """True positions (2,) of the landmarks, world frame, metres; none if the folder has none. For evaluation only."""
    file = _existing(folder, "Landmark_Groundtruth.dat")
    if file is None:
        return {}
    table = read_table(file, "subject x y sigma-x sigma-y")
    places: dict[LandmarkId, Array] = {}
    for record, row in zip(table.records, table.numbers, strict=True):
        subject = record.whole(0, "subject")
        if subject in places:
            record.fail(f"found subject {subject} again, allowed: each once")
        places[subject] = row[1:3].copy()
    return places


def _chosen(folder: Path, robot: int | None) -> int:
    found = robots(folder)
    if not found:
        raise InputError(folder, "found no RobotN_Odometry.dat", "a MRCLAM folder, files plain or .gz")
    if robot not in found and (robot is not None or len(found) > 1):
        raise InputError(folder, f"found robots {', '.join(map(str, found))}", "one, by `robot` N")
    return found[0] if robot is None else robot


def _existing(folder: Path, name: str) -> Path | None:
    return next((file for file in (folder / name, folder / f"{name}.gz") if file.is_file()), None)


def _file(folder: Path, name: str) -> Path:
    if (file := _existing(folder, name)) is None:
        raise InputError(folder, f"found no {name}", "a MRCLAM folder with it, plain or .gz")
    return file


def _ascending_ns(table: Table) -> list[int]:
    """(N,) stamps that do not decrease."""
    stamps: list[int] = table.stamps_ns().tolist()
    for (before, after), record in zip(itertools.pairwise(stamps), table.records[1:], strict=True):
        if after < before:
            record.fail(f"found stamp {shown(record.fields[0])}, allowed: not before that of the previous line")
    return stamps
