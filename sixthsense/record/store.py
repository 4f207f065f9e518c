"""A run's record, read back without estimating again; and the map in it, with which another run begins."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from sixthsense.config import load_config, notes_of
from sixthsense.config.errors import InputError
from sixthsense.config.files import absolute, instead_of, path_of
from sixthsense.config.section import checked
from sixthsense.core.covariance import COVARIANCE_SLACK, covariance_fault
from sixthsense.core.geometry import Pose
from sixthsense.logs.runfolder import FILE, Message, read_messages, readable, ticks_of
from sixthsense.record.stream import read_end, read_fields, read_keyframes, read_scans
from sixthsense.record.trace import Trace
from sixthsense.slam.estimators import LandmarkPrior
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.prior_map import KeyScans, PriorMap, PriorStart

END = "the run's end: outcome, counts, clocks, final trajectory and landmarks"
"""missing from a run that was stopped; each keyframe keeps the pose estimated at its time"""
GRID = "the grid map"


class Loaded(NamedTuple):
    """A record that was read back."""

    trace: Trace
    lacks: tuple[str, ...]
    """parts of the record that are not there, `END` and `GRID`"""
    metrics: Mapping[str, Any] | None
    """as the run computed them at its end; None of one that was stopped"""


def load_record(folder: Path | str) -> Loaded:
    """Read the record in the folder of a run, or in the `.partial` that a stopped run has left.

    Lists of missing fields are empty, a missing grid is None. The estimates at keyframes are read without their
    landmarks, and scans of keyframes as the laser sent them, not de-skewed. The outcome of a run that was stopped is
    "interrupted". Raises an InputError that names the file for a folder that is no run folder, has recorded nothing, or
    is damaged.
    """
    folder = Path(folder)
    config, file = load_config(folder / "config.toml"), folder / FILE
    messages, _ = read_messages(file)
    with readable(file):
        trace = Trace(config, **read_fields(messages[0].value["fields"]))
        channels: dict[str, list[Message]] = {}
        for message in messages:
            channels.setdefault(message.channel, []).append(message)
        _read_stream(trace, channels)
        scans = {tick.stamp_ns: tick.scan for tick in ticks_of(messages, Pose(*config.laser.mount))}
        trace.key_scans = [scans.get(stamp_ns) for stamp_ns in trace.key_stamps_ns]
        trace.prior_map = notes_of(folder / "config.toml").get("prior_map")
        trace.name = absolute(folder).name.removesuffix(".partial")
        if "end" not in channels:
            return Loaded(_stopped(trace), (END, GRID), None)
        table = channels["end"][0].value
        arrays = {name: np.concatenate([one.value for one in channels[name]]) for name in channels if "array." in name}
        read_end(trace, table, arrays)
    return Loaded(trace, () if trace.grid is not None else (GRID,), table["metrics"])


def _read_stream(trace: Trace, channels: Mapping[str, list[Message]]) -> None:
    """Add what was streamed during the run; ValueError for a record without a scan."""
    if "estimate" not in channels:
        raise ValueError("no scan")
    for name in ("plan", "tour"):
        setattr(trace, f"{name}s", [message.value for message in channels.get(name, ())])
    trace.stamps_ns = [message.stamp_ns for message in channels["estimate"]]
    read_scans(trace, np.concatenate([message.value for message in channels["estimate"]]))
    if "keyframe" in channels:
        trace.key_stamps_ns = [message.stamp_ns for message in channels["keyframe"]]
        read_keyframes(trace, [message.value for message in channels["keyframe"]])


def _stopped(trace: Trace) -> Trace:
    """The trace of a run that was stopped, which ends with its last keyframe."""
    trace.outcome = "interrupted"
    trace.last_position = (trace.truths or trace.odometry)[-1][:2]
    if trace.key_estimates:
        trace.final, trace.joint_cov = trace.key_estimates[-1], trace.key_estimates[-1].pose_cov
    trace.trajectory = np.array([estimate.pose.array() for estimate in trace.key_estimates]).reshape(-1, 3)
    return trace


def read_prior_map(folder: Path | str) -> PriorMap:
    """The map in the folder of a run that has ended.

    Raises InputError, naming the folder or its file, for one that is no run folder, lacks a part of the map, or is
    damaged, and for a map without landmarks.
    """
    folder = path_of("prior_map", folder)
    if not (folder / "config.toml").is_file():
        raise InputError(folder, f"found {instead_of(folder, 'config.toml')}", "the folder of a run")
    trace, lacks, _ = load_record(folder)
    if END in lacks:
        raise InputError(folder, "found a run that was stopped", "the folder of a run that has ended")
    final, cov = trace.final, trace.joint_cov[3:, 3:]
    if not len(final.ids):
        raise InputError(folder, "found a map without landmarks", "one by the front end of landmarks")
    if fault := covariance_fault(cov, lowest=-COVARIANCE_SLACK):
        raise InputError(folder / FILE, f"found {fault}", "a covariance")
    kept = {i: trace.records[i] for i in final.ids.tolist()}
    extents = np.array([record.extent for record in kept.values()])
    landmarks = LandmarkPrior(final.ids, final.landmarks, final.walls, cov, extents)
    evidence = (trace.grid or Grid(trace.config.grid, trace.radius_m)).submap()
    counts = np.array([(one.kind, one.observations, one.first_scan, one.last_scan) for one in kept.values()])
    arrays = (final.ids, final.walls, final.landmarks, cov, counts, extents, *evidence)
    digest = hashlib.sha256(b"".join(array.tobytes() for array in arrays))
    name, cell_m = folder.resolve().name, trace.config.grid.cell_m
    return PriorMap(
        name, digest.hexdigest(), landmarks, kept, evidence, cell_m, KeyScans.of(trace.key_scans, trace.trajectory)
    )


def prior_start(
    prior_map: Path | str | None,
    pose: Sequence[float] | None = None,
    pose_sigma: Sequence[float] | None = None,
    lost: bool | None = False,
) -> PriorStart | None:
    """The prior map in a folder and the start in it, None without a folder. A robot that is `lost` has no pose.

    Raises InputError for a pose or sigmas that are not allowed, and without a folder; InputError as `read_prior_map`.
    """
    values, hint = {"pose": pose, "pose_sigma": pose_sigma}, tuple[float, float, float]
    given = {name: checked(name, hint, value) for name, value in values.items() if value is not None}
    if prior_map is None:
        for name in ("lost",) if lost else given:
            raise InputError(name, "found without `prior_map`", "with it")
        return None
    if lost and given:
        raise InputError(next(iter(given)), "found with `lost`", "one of both")
    place, spread = given.get("pose"), given.get("pose_sigma")
    if spread is not None and min(spread) < 0.0:
        raise InputError("pose_sigma", f"found {' '.join(map(str, spread))}", "at least 0")
    start = Pose(*place) if place else None
    return PriorStart(read_prior_map(prior_map), start, spread or (0.0, 0.0, 0.0), bool(lost))
