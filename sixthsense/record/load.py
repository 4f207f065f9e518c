"""The record of a run, read back from its folder without estimating again."""

from __future__ import annotations

import csv
import enum
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from sixthsense.config import Config, load_config, prior_map_of
from sixthsense.config.files import absolute
from sixthsense.config.section import shown
from sixthsense.navigation.unseen_places import UnseenPlace, as_reason
from sixthsense.record.ending import (
    END_FILE,
    GRID_FILE,
    LANDMARKS_FILE,
    read_arrays,
    read_grid,
    read_landmark_table,
    read_landmarks,
    read_planar_tum,
)
from sixthsense.record.older import trace_of_bag
from sixthsense.record.reading import RecordError, read_stream
from sixthsense.record.stream import FILE
from sixthsense.record.trace import Trace


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
        trace, has_ended = trace_of_bag(folder, config), False
        missing = {RecordPart.KEYFRAMES, RecordPart.END}
        trace.outcome = _outcome(folder / "metrics.json")
        trace.left = _places_left(folder / "places_left.csv")
    else:
        trace, has_ended = streamed
        missing = set() if has_ended else {RecordPart.END}
        trace.outcome = trace.outcome or "interrupted"
    trace.prior_map = prior_map_of(folder / "config.toml")
    trace.name = absolute(folder).name.removesuffix(".partial")
    missing |= _read_end(folder, trace) | _read_grid(folder, config, trace)
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
        trace.trajectory = read_planar_tum(folder / "smoothed.tum", len(trace.key_stamps_ns))
        if (folder / "landmarks.csv").exists():
            trace.records = read_landmark_table(folder / "landmarks.csv")
    else:
        missing.add(RecordPart.TRAJECTORY)
        poses = [estimate.pose.array() for estimate in trace.key_estimates]
        trace.trajectory = np.array(poses).reshape(-1, 3)
    if not set(trace.final.ids.tolist()) <= set(trace.records):
        raise RecordError(
            f"{folder / LANDMARKS_FILE}: found landmarks that {END_FILE} does not know, allowed: those of one run"
        )
    return missing


def _read_grid(folder: Path, config: Config, trace: Trace) -> set[RecordPart]:
    if not (folder / GRID_FILE).exists():
        return {RecordPart.GRID}
    trace.grid = read_grid(folder / GRID_FILE, config, trace.radius_m)
    return set()


def _outcome(file: Path) -> str:
    """Why a run ended, from its metrics; a run without them was stopped."""
    if not file.exists():
        return "interrupted"
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["outcome"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return "interrupted"


def _places_left(file: Path) -> list[UnseenPlace]:
    """What an exploration left unseen, from its table; nothing of a run without one."""
    if not file.exists():
        return []
    number = 1
    try:
        with file.open(newline="", encoding="utf-8") as stream:
            places, rows = [], csv.DictReader(stream)
            for row in rows:
                number = rows.line_num
                area_m2 = float(row["area_m2"])
                places.append(UnseenPlace(float(row["x"]), float(row["y"]), area_m2, as_reason(row["reason"])))
            return places
    except OSError as error:
        raise RecordError(f"{file}: cannot be read ({error.strerror})") from None
    except (LookupError, TypeError, ValueError) as error:
        raise RecordError(f"{file}: line {number}: found {shown(str(error))}, allowed: a place left") from None
