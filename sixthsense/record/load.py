"""The record of a run, read back from its folder without estimating again."""

from __future__ import annotations

import contextlib
import csv
import enum
import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

import numpy as np

from sixthsense.config import Config, load_config, prior_map_of
from sixthsense.config.files import absolute
from sixthsense.config.platform import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, LandmarkId
from sixthsense.core.motion import Odometry, odometry
from sixthsense.navigation.unseen_places import UnseenPlace, as_reason
from sixthsense.record.ending import END_FILE, GRID_FILE, LANDMARKS_FILE, read_arrays, read_grid, read_landmarks
from sixthsense.record.reading import RecordError, read_stream
from sixthsense.record.stream import FILE
from sixthsense.record.trace import Trace
from sixthsense.slam.association.records import Record
from sixthsense.slam.estimators import Estimate
from sixthsense.slam.keyframes import Keyframes
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.slam import Keyframe, Step
from sixthsense.sources.logs.runfolder import read_run
from sixthsense.sources.logs.tum import read_tum
from sixthsense.sources.replay_input import recorded_scene

T = TypeVar("T")


class RecordPart(enum.Enum):
    """A part of the record that a run folder may lack; its value describes it to a user."""

    KEYFRAMES = f"walls, innovations and times of keyframes ({FILE})"
    """missing from folders of versions that did not write this file"""
    END = f"the last line of the record: outcome, counts and clocks ({FILE})"
    """missing from a run that was killed"""
    TRAJECTORY = f"the final trajectory ({END_FILE})"
    """without it each keyframe keeps the pose estimated at its time"""
    LANDMARKS = f"landmark means and their joint covariance ({LANDMARKS_FILE})"
    GRID = f"the grid map ({GRID_FILE})"


@dataclass(frozen=True, slots=True)
class LoadedRecord:
    """A trace, and what its folder lacks."""

    trace: Trace
    """lists of missing parts are empty, a missing grid is None"""
    missing: tuple[RecordPart, ...]
    """in the order of `RecordPart`"""


def load_record(folder: Path | str) -> LoadedRecord:
    """Read the record in the folder of a run, or in the `.partial` that a killed run has left.

    The estimates at keyframes are read without their landmarks, which no folder holds. The outcome of a killed run is
    "interrupted". Raises an InputError that names file and line for a folder that is no run folder, has recorded
    nothing, or is damaged.
    """
    folder = Path(folder)
    config = load_config(folder / "config.toml")
    streamed = read_stream(folder / FILE, config) if (folder / FILE).exists() else None
    if streamed is None:
        trace = _older(folder, config)
        missing = {RecordPart.KEYFRAMES, RecordPart.END}
    else:
        trace, has_ended = streamed
        missing = set() if has_ended else {RecordPart.END}
        trace.outcome = trace.outcome or "interrupted"
    trace.prior_map = prior_map_of(folder / "config.toml")
    trace.name = absolute(folder).name.removesuffix(".partial")
    missing |= _read_end(folder, trace)
    if (folder / GRID_FILE).exists():
        trace.grid = read_grid(folder / GRID_FILE, config, trace.radius_m)
    else:
        missing.add(RecordPart.GRID)
    return LoadedRecord(trace, tuple(part for part in RecordPart if part in missing))


def _read_end(folder: Path, trace: Trace) -> set[RecordPart]:
    """Add the final estimate and trajectory to the trace; what of them is missing."""
    missing: set[RecordPart] = set()
    if (folder / LANDMARKS_FILE).exists():
        read_landmarks(folder / LANDMARKS_FILE, trace)
    else:
        missing.add(RecordPart.LANDMARKS)
        if trace.key_estimates:
            trace.final, trace.joint_cov = trace.key_estimates[-1], trace.key_estimates[-1].pose_cov
    if (folder / END_FILE).exists():
        read_arrays(folder / END_FILE, trace)
    elif (folder / "smoothed.tum").exists():
        trace.trajectory = _planar_tum(folder / "smoothed.tum", len(trace.key_stamps_ns))
        if (folder / "landmarks.csv").exists():
            trace.records = dict(_rows(folder / "landmarks.csv", "landmark", _landmark))
    else:
        missing.add(RecordPart.TRAJECTORY)
        poses = [estimate.pose.array() for estimate in trace.key_estimates]
        trace.trajectory = np.array(poses).reshape(-1, 3)
    if not set(trace.final.ids.tolist()) <= set(trace.records):
        raise RecordError(
            f"{folder / LANDMARKS_FILE}: found landmarks that {END_FILE} does not know, allowed: those of one run"
        )
    return missing


def _older(folder: Path, config: Config) -> Trace:
    """The trace of a folder of a version that wrote no `record.jsonl`: what its bag, metrics and tables say."""
    trace = _trace_of_bag(folder, config)
    trace.outcome = "interrupted"  # a run without metrics was stopped
    if (folder / "metrics.json").exists():
        with contextlib.suppress(OSError, ValueError, LookupError, TypeError, RecursionError):
            trace.outcome = str(json.loads((folder / "metrics.json").read_text(encoding="utf-8"))["outcome"])
    if (folder / "places_left.csv").exists():
        trace.left = _rows(folder / "places_left.csv", "place left", _place_left)
    return trace


def _trace_of_bag(folder: Path, config: Config) -> Trace:
    """Poses, truth and plans of a run, from its bag: without landmarks, walls, innovations and times.

    Raises LogError for a folder without a bag, and a bag without a scan.
    """
    log = read_run(folder, config.laser)
    scene = recorded_scene(log, config)
    trace = Trace(config, scene, config.robot.radius or (DEFAULT_ROBOT_RADIUS_M if scene is None else scene.radius))
    trace.plans = [path for _, path in log.plans]
    estimates = {stamp_ns: (pose, cov) for stamp_ns, pose, cov in log.estimates}
    pose, before, folded = log.start, log.ticks[0].odometry, Keyframes(config.keyframes)
    no_grid = Grid(config.grid, trace.radius_m)
    for k, tick in enumerate(log.ticks):
        if k:
            increment = odometry(before, tick.odometry, config.assumed)
            if tick.increment_cov is not None:
                increment = Odometry(before.inverse() @ tick.odometry, tick.increment_cov)
            pose = pose @ increment.motion
            folded.moved(increment)
            before = tick.odometry
        if tick.stamp_ns in estimates:
            pose, cov = estimates[tick.stamp_ns]
            unknown = Estimate.of_pose(Pose(), np.zeros((3, 3)))
            trace.add_keyframe(tick, Keyframe(folded.take(), unknown, Estimate.of_pose(pose, cov)))
        trace.add_tick(tick, tick.odometry)
        if tick.scan is not None or tick.observations is not None:
            since = folded.since.motion, folded.since.cov
            trace.add_scan(tick, Step(tick.stamp_ns, pose, tick.odometry, None, *since, None, None, no_grid))
    return trace


def _rows(file: Path, what: str, read: Callable[[dict[str, str]], T]) -> list[T]:
    """What `read` says of each row of a table; RecordError, naming the line, for a table that is damaged."""
    number, found = 1, []
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            rows = csv.DictReader(stream)
            for row in rows:
                number = rows.line_num
                found.append(read(row))
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error.strerror})") from None
    except (LookupError, TypeError, ValueError, AttributeError, csv.Error):
        raise RecordError(f"{file}: line {number}: found no {what}, allowed: a table of them") from None
    return found


def _place_left(row: dict[str, str]) -> UnseenPlace:
    return UnseenPlace(float(row["x"]), float(row["y"]), float(row["area_m2"]), as_reason(row["reason"]))


def _landmark(row: dict[str, str]) -> tuple[LandmarkId, Record]:
    ends = [float(row[name] or 0.0) for name in ("from_x", "from_y", "to_x", "to_y")]
    count = int(row.get("observations") or row["sightings"])  # the name in older tables
    return int(row["id"]), Record(Kind[row["kind"].upper()], count, 0, 0, extent=np.array(ends).reshape(2, 2))


def _planar_tum(file: Path, rows: int) -> Array:
    """(rows, 3) poses of a TUM trajectory; raises an InputError, naming the line, for a file that is damaged."""
    if rows == 0:
        return np.zeros((0, 3))
    _, poses = read_tum(file)
    if len(poses) != rows:
        raise RecordError(f"{file}: found {len(poses)} poses, allowed: {rows}")
    x, y, _, _, _, z, w = poses.T
    return np.column_stack([x, y, wrap_angle(2.0 * np.arctan2(z, w))])
