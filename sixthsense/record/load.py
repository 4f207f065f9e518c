"""What a run's folder holds, read back: the record, without estimating again, and the map for the next run."""

from __future__ import annotations

import enum
import hashlib
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from sixthsense.config import load_config, prior_map_of
from sixthsense.config.errors import InputError
from sixthsense.config.files import absolute
from sixthsense.core.covariance import COVARIANCE_SLACK, covariance_fault
from sixthsense.core.geometry import Pose
from sixthsense.record.ending import (
    END_FILE,
    GRID_FILE,
    LANDMARKS_FILE,
    VERDICT_FILE,
    read_arrays,
    read_grid,
    read_landmarks,
    read_records,
)
from sixthsense.record.reading import read_stream
from sixthsense.record.stream import FILE
from sixthsense.record.trace import Trace
from sixthsense.record.verdict_file import read_verdict
from sixthsense.slam.estimators import LandmarkPrior
from sixthsense.slam.mapping.submap import Submap
from sixthsense.slam.prior_map import PriorMap, PriorStart

_MAP_FILES = (LANDMARKS_FILE, END_FILE, GRID_FILE)


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
    if (folder / VERDICT_FILE).exists():
        trace.verdict = read_verdict(folder / VERDICT_FILE)
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
        raise InputError(folder / LANDMARKS_FILE, f"found landmarks that {END_FILE} does not know", "those of one run")
    return set()


def read_prior_map(folder: Path | str) -> PriorMap:
    """The map in the folder of a run that has ended.

    Raises InputError, naming the file, for a folder that is no run folder, lacks a part of the map, or is damaged, and
    for a map without landmarks.
    """
    folder = Path(folder)
    if not (folder / "config.toml").is_file():
        found = "no config.toml in it" if folder.is_dir() else "no such folder"
        raise InputError(folder, f"found {found}", "the folder of a run")
    for name in (LANDMARKS_FILE, END_FILE):
        if not (folder / name).is_file():
            raise InputError(folder, f"found no {name}", "the folder of a run that has ended")
    config = load_config(folder / "config.toml")
    trace = Trace(config, None, 0.0)
    read_landmarks(folder / LANDMARKS_FILE, trace)
    records = read_records(folder / END_FILE)
    final, cov = trace.final, trace.joint_cov[3:, 3:]
    if not len(final.ids):
        raise InputError(folder, "found a map without landmarks", "one by the front end of landmarks")
    if len(np.unique(final.ids)) != len(final.ids) or not set(final.ids.tolist()) <= set(records):
        raise InputError(folder / LANDMARKS_FILE, f"found landmarks unlike {END_FILE}", "those of one run")
    if fault := covariance_fault(cov, lowest=-COVARIANCE_SLACK):
        raise InputError(folder / LANDMARKS_FILE, f"found {fault}", "a covariance")
    kept = {i: records[i] for i in final.ids.tolist()}
    extents = np.array([record.extent for record in kept.values()])
    landmarks = LandmarkPrior(final.ids, final.landmarks, final.walls, cov, extents)
    none = np.zeros(0, np.int32)
    evidence = Submap.of(np.zeros((0, 2), np.int64), none, none, np.zeros(0, np.bool_))
    if (folder / GRID_FILE).is_file():
        evidence = read_grid(folder / GRID_FILE, config, 0.0).submap()
    return PriorMap(folder.resolve().name, _digest(folder), landmarks, kept, evidence, config.grid.cell_m)


def prior_start(
    folder: Path | str | None,
    pose: Sequence[float] | None,
    sigma: Sequence[float] | None,
    lost: bool = False,
) -> PriorStart | None:
    """The prior map in `folder` and the start in it, None without a folder. A robot that is `lost` has no pose.

    Raises InputError for a pose or sigmas that are not allowed, and without a folder; InputError as `read_prior_map`.
    """
    given = {name: value for name, value in (("pose", pose), ("pose_sigma", sigma)) if value is not None}
    if folder is None:
        for name in ("lost",) if lost else given:
            raise InputError(name, "found without `prior_map`", "with it")
        return None
    for name, value in given.items():
        is_number = [isinstance(number, int | float) and math.isfinite(number) for number in value]
        if len(value) != 3 or not all(is_number):
            raise InputError(name, f"found {' '.join(map(str, value))}", "three finite numbers")
        if lost:
            raise InputError(name, "found with `lost`", "one of both")
    if sigma is not None and min(sigma) < 0.0:
        raise InputError("pose_sigma", f"found {' '.join(map(str, sigma))}", "at least 0")
    x, y, theta = (0.0, 0.0, 0.0) if sigma is None else map(float, sigma)
    there = None if pose is None else Pose.from_array(np.array(pose, dtype=np.float64))
    return PriorStart(read_prior_map(folder), there, (x, y, theta), lost)


def _digest(folder: Path) -> str:
    digest = hashlib.sha256()
    for name in _MAP_FILES:
        if (folder / name).is_file():
            digest.update((folder / name).read_bytes())
    return digest.hexdigest()
