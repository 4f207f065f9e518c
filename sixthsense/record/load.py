"""The record of a run, read back from its folder without estimating again."""

from __future__ import annotations

import enum
from pathlib import Path

import numpy as np

from sixthsense.config import load_config, prior_map_of
from sixthsense.config.files import absolute
from sixthsense.record.ending import END_FILE, GRID_FILE, LANDMARKS_FILE, read_arrays, read_grid, read_landmarks
from sixthsense.record.reading import RecordError, read_stream
from sixthsense.record.stream import FILE
from sixthsense.record.trace import Trace


class RecordPart(enum.Enum):
    """A part of the record that a run folder may lack; its value describes it to a user."""

    END = f"the last line of the record: outcome, counts and clocks ({FILE})"
    """missing from a run that was killed"""
    TRAJECTORY = f"the final trajectory ({END_FILE})"
    """without it each keyframe keeps the pose estimated at its time"""
    LANDMARKS = f"landmark means and their joint covariance ({LANDMARKS_FILE})"
    GRID = f"the grid map ({GRID_FILE})"


def load_record(folder: Path | str) -> tuple[Trace, tuple[RecordPart, ...]]:
    """Read the record in the folder of a run, or in the `.partial` that a killed run has left; and what it lacks.

    Lists of missing parts are empty, a missing grid is None. The estimates at keyframes are read without their
    landmarks, which no folder holds. The outcome of a killed run is "interrupted". Raises an InputError that names file
    and line for a folder that is no run folder, has recorded nothing, or is damaged.
    """
    folder = Path(folder)
    config = load_config(folder / "config.toml")
    trace, has_ended = read_stream(folder / FILE, config)
    trace.outcome = trace.outcome or "interrupted"
    missing = set() if has_ended else {RecordPart.END}
    trace.prior_map = prior_map_of(folder / "config.toml")
    trace.name = absolute(folder).name.removesuffix(".partial")
    missing |= _read_end(folder, trace)
    if (folder / GRID_FILE).exists():
        trace.grid = read_grid(folder / GRID_FILE, config, trace.radius_m)
    else:
        missing.add(RecordPart.GRID)
    return trace, tuple(part for part in RecordPart if part in missing)


def _read_end(folder: Path, trace: Trace) -> set[RecordPart]:
    """Add the final estimate and trajectory to the trace; what of them is missing."""
    if not (folder / END_FILE).exists():
        if trace.key_estimates:
            trace.final, trace.joint_cov = trace.key_estimates[-1], trace.key_estimates[-1].pose_cov
        trace.trajectory = np.array([estimate.pose.array() for estimate in trace.key_estimates]).reshape(-1, 3)
        return {RecordPart.TRAJECTORY, RecordPart.LANDMARKS}
    read_arrays(folder / END_FILE, trace)
    read_landmarks(folder / LANDMARKS_FILE, trace)
    if not set(trace.final.ids.tolist()) <= set(trace.records):
        raise RecordError(
            f"{folder / LANDMARKS_FILE}: found landmarks that {END_FILE} does not know, allowed: those of one run"
        )
    return set()
