"""The record of a run: what the loop saw, believed and did, tick by tick, and the metrics that follow from it."""

from __future__ import annotations

import csv
import json
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense import metrics
from sixthsense.association import Association, Record
from sixthsense.config import Config
from sixthsense.coverage import coverage, visible_area
from sixthsense.estimators import Estimate
from sixthsense.geometry import Array, Pose
from sixthsense.grid import Grid
from sixthsense.landmarks import LandmarkId
from sixthsense.laser import beam_bearings
from sixthsense.logs.relations import Relations
from sixthsense.motion import Odometry
from sixthsense.navigate import Place, as_reason
from sixthsense.scene import Scene
from sixthsense.source import Tick

NOTHING = Estimate(Pose(), np.zeros((3, 3)), np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0, dtype=np.bool_))

STAGES = ("sense", "extract", "associate", "predict", "update", "grid", "plan")


class Stopwatch:
    """Times the stages of the loop; a key scan's whole processing is the sum of its stages after sensing."""

    def __init__(self) -> None:
        self.rows: list[dict[str, float]] = []
        """per key scan, milliseconds per stage"""
        self.totals = dict.fromkeys(STAGES, 0.0)
        """per stage, milliseconds in the whole run"""
        self._row: dict[str, float] = {}
        self._last = time.perf_counter()

    def start(self) -> None:
        """Begin a turn of the loop."""
        self._row = {}
        self._last = time.perf_counter()

    def lap(self, stage: str) -> None:
        """Book the time since the last lap on `stage`."""
        now = time.perf_counter()
        elapsed = 1e3 * (now - self._last)
        self._row[stage] = self._row.get(stage, 0.0) + elapsed
        self.totals[stage] += elapsed
        self._last = now

    def key_scan(self) -> None:
        """Keep this turn's laps as a key scan's."""
        self.rows.append(self._row)

    def key_scan_ms(self) -> Array:
        """(K,) the whole processing of each key scan, sensing left out; milliseconds."""
        return np.array([sum(ms for stage, ms in row.items() if stage != "sense") for row in self.rows])


@dataclass(slots=True)
class Trace:
    """Everything a run leaves behind; rows are appended by the loop."""

    config: Config
    scene: Scene | None
    """the truth, for the record; none for a log"""
    radius_m: float
    """of the robot"""
    stamps_ns: list[int] = field(default_factory=list)
    """per scan: record time"""
    log_stamps_s: list[float] = field(default_factory=list)
    """per scan: the log's own stamp, NaN in a simulated world"""
    estimates: list[Array] = field(default_factory=list)
    """per scan: (3,) pose believed then"""
    odometry: list[Array] = field(default_factory=list)
    """per scan: (3,) dead-reckoned pose, world frame"""
    truths: list[Array] = field(default_factory=list)
    """per scan: (3,) true pose; none in a log"""
    last_key: list[int] = field(default_factory=list)
    """per scan: index of the last key scan, itself included"""
    since_key: list[Array] = field(default_factory=list)
    """per scan: (3,) motion since that key scan, by odometry"""
    key_stamps_ns: list[int] = field(default_factory=list)
    """per key scan: record time"""
    key_odometry: list[Odometry] = field(default_factory=list)
    """per key scan: motion since the one before"""
    key_estimates: list[Estimate] = field(default_factory=list)
    """per key scan: after its update"""
    key_truths: list[Array] = field(default_factory=list)
    """per key scan: (3,) true pose; none in a log"""
    associations: list[Association] = field(default_factory=list)
    """per key scan"""
    walls_found: list[Array] = field(default_factory=list)
    """per key scan: (W, 2, 2) segments, robot's frame"""
    stopwatch: Stopwatch = field(default_factory=Stopwatch)
    """per key scan: stage times"""
    outcome: str = ""
    """why the run ended"""
    path_length_m: float = 0.0
    """true way, or by odometry in a log"""
    wall_time_s: float = 0.0
    """of the loop"""
    plans: list[Array] = field(default_factory=list)
    """planned paths"""
    plans_below_margin: int | None = None
    """of these, that keep less from obstacles than was wanted; none in a log"""
    guard_stops: int | None = None
    """times the guard stopped the moving robot; none in a log"""
    left: list[Place] = field(default_factory=list)
    """what an exploration has not seen"""
    trajectory: Array = field(default_factory=lambda: np.zeros((0, 3)))
    """(K, 3) final pose at each key scan"""
    final: Estimate = field(default_factory=lambda: NOTHING)
    """at the end of the run"""
    joint_cov: Array = field(default_factory=lambda: np.zeros((3, 3)))
    """(3 + 2n, 3 + 2n) of the final estimate"""
    records: dict[LandmarkId, Record] = field(default_factory=dict)
    """of the landmarks in the final estimate"""
    culled: int = 0
    """landmarks removed"""
    walls_merged: int = 0
    """walls that have turned out to be others"""
    relations: Relations | None = None
    """hand-checked relations to measure the trajectory against"""
    grid: Grid | None = None
    """the map"""
    rebuilds: int = 0
    """times it was drawn anew, because key poses had moved"""
    _last_position: Array | None = None

    @classmethod
    def load(cls, folder: str | Path) -> Trace:
        """Read the folder of a run, or the `.partial` that a killed run has left, back into a Trace.

        The estimates are made anew from the recorded evidence with the folder's configuration, which repeats the run
        exactly; plans are read from the bag, the outcome from `metrics.json` ("interrupted" without one), what was left
        unseen from `places_left.csv`. The times
        are those of the repetition. Raises InputError for a folder that is no run's, or has recorded nothing.
        """
        from sixthsense.config import load_config
        from sixthsense.logs.runfolder import read_run
        from sixthsense.loop import replay

        path = Path(folder)
        config = load_config(path / "config.toml")
        log = read_run(path, config.laser)
        trace = replay(log, config)
        trace.plans = list(log.plans)
        trace.outcome = _outcome(path / "metrics.json")
        trace.left = _places_left(path / "places_left.csv")
        return trace

    def add_tick(self, tick: Tick, odometry: Pose) -> None:
        """Record the way made; `odometry` is the dead-reckoned pose in the world frame."""
        position = (tick.truth or odometry).position
        if self._last_position is not None:
            self.path_length_m += float(np.hypot(*(position - self._last_position)))
        self._last_position = position

    def add_scan(self, tick: Tick, pose: Pose, odometry: Pose, since_key: Pose) -> None:
        """Record one scan, after whatever the loop made of it."""
        self.stamps_ns.append(tick.stamp_ns)
        self.log_stamps_s.append(np.nan if tick.log_stamp_s is None else tick.log_stamp_s)
        self.estimates.append(pose.array())
        self.odometry.append(odometry.array())
        if tick.truth is not None:
            self.truths.append(tick.truth.array())
        self.last_key.append(len(self.key_stamps_ns) - 1)
        self.since_key.append(since_key.array())

    def add_key_scan(
        self, tick: Tick, motion: Odometry, estimate: Estimate, association: Association, walls: Array
    ) -> None:
        """Record one key scan after its update; `motion` is that since the one before."""
        self.key_odometry.append(motion)
        self.key_stamps_ns.append(tick.stamp_ns)
        self.key_estimates.append(estimate)
        if tick.truth is not None:
            self.key_truths.append(tick.truth.array())
        self.associations.append(association)
        self.walls_found.append(walls)

    def scan_poses(self) -> Array:
        """(S, 3) final pose of every scan: its last key scan's, and the odometry since."""
        rows = [
            (Pose.from_array(self.trajectory[k]) @ Pose.from_array(motion)).array()
            for k, motion in zip(self.last_key, self.since_key, strict=True)
        ]
        return np.array(rows).reshape(-1, 3)

    def metrics(self) -> dict[str, Any]:
        """Flat keys and numbers; what cannot be measured is left out."""
        out: dict[str, Any] = {"outcome": self.outcome}
        if self.truths:
            out["collisions"] = int(self.outcome == "collided")
            out |= self._goal_error() | self._home_error()
            out |= self._errors()
            if self.scene is not None:
                out |= self._coverage(self.scene)
        out |= self._consistency()
        out |= self._relations()
        out["landmarks"] = len(self.records)
        out["landmarks_culled"] = self.culled
        out["walls_merged"] = self.walls_merged
        if self.outcome.startswith("explored"):
            out["places_left"] = len(self.left)
            out["area_left_m2"] = sum(place.area_m2 for place in self.left)
        out["path_length_m"] = self.path_length_m
        out["plans"] = len(self.plans)
        if self.plans_below_margin is not None and self.guard_stops is not None:
            out["plans_below_margin"], out["guard_stops"] = self.plans_below_margin, self.guard_stops
        sim_time_s = 1e-9 * (self.stamps_ns[-1] - self.stamps_ns[0]) if self.stamps_ns else 0.0
        out["sim_time_s"] = sim_time_s
        out |= self._timing(sim_time_s)
        return out

    def _goal_error(self) -> dict[str, float]:
        """How far from the goal the robot truly is: the outcome is judged by the estimate."""
        goal = self.config.goal or (self.scene.goal if self.scene is not None else None)
        if goal is None or self.config.task != "goal" or self._last_position is None:
            return {}
        return {"goal_error_m": float(np.hypot(*(self._last_position - np.array(goal))))}

    def _home_error(self) -> dict[str, float]:
        """How far from where it began the robot truly is after an exploration that was to end there."""
        ended = self.config.explore.return_home and self.outcome.startswith("explored")
        if not ended or self.config.task != "explore" or self._last_position is None:
            return {}
        return {"home_error_m": float(np.hypot(*(self._last_position - self.truths[0][:2])))}

    def _coverage(self, scene: Scene) -> dict[str, float]:
        laser = self.config.laser
        region = self.config.region or scene.region
        start = (float(self.truths[0][0]), float(self.truths[0][1]))
        area = visible_area(scene.walls, region, start, self.radius_m, laser.max_range)
        poses = np.array(self.truths)
        share = coverage(area, poses, beam_bearings(laser), laser.mount, laser.max_range, scene.walls)
        return {"coverage": share} if np.isfinite(share) else {}

    def _relations(self) -> dict[str, float]:
        if self.relations is None:
            return {}
        given = self.relations
        stamps = np.array(self.log_stamps_s)
        # A replay that ends early is measured by the relations it has reached.
        reached = np.isin(np.round(given.stamps, 6), np.round(stamps, 6)).all(axis=1)
        if not reached.any():
            return {}
        poses = self.scan_poses()
        translation, angle = metrics.relations_error(stamps, poses, given.stamps[reached], given.poses[reached])
        return {
            "relations_trans_m_mean": float(translation.mean()),
            "relations_trans_m_std": float(translation.std()),
            "relations_rot_deg_mean": float(np.degrees(angle).mean()),
            "relations_rot_deg_std": float(np.degrees(angle).std()),
        }

    def _errors(self) -> dict[str, float]:
        truth, estimate = np.array(self.truths), np.array(self.estimates)
        rmse, worst = metrics.ate(estimate, truth)
        dead_reckoning, _ = metrics.ate(np.array(self.odometry), truth)
        out = {
            "ate_rmse_m": rmse,
            "ate_max_m": worst,
            "dead_reckoning_ate_rmse_m": dead_reckoning,
            "heading_rmse_rad": metrics.heading_rmse(estimate, truth),
        }
        if self.scene is not None and not self.final.walls.all():
            corners = metrics.true_landmarks(self.scene.walls)
            rmse, matched = metrics.match_landmarks(self.final.landmarks[~self.final.walls], corners, 0.5)
            if matched:
                out["landmark_rmse_m"] = rmse
        return out

    def _consistency(self) -> dict[str, float]:
        out: dict[str, float] = {}
        covs = np.array([e.pose_cov for e in self.key_estimates])
        if self.key_truths:
            first = metrics.full_rank_from(covs)
            poses = np.array([e.pose.array() for e in self.key_estimates])[first:]
            truth = np.array(self.key_truths)[first:]
            if len(poses):
                errors = poses - truth
                out["pose_nees_world_mean"] = float(np.mean(metrics.nees_world(errors, covs[first:])))
                out["pose_nees_invariant_mean"] = float(np.mean(metrics.nees_invariant(poses, truth, covs[first:])))
        dof = sum(a.dof for a in self.associations)
        if dof:
            out["nis_mean_per_dof"] = sum(a.nis for a in self.associations) / dof
        return out

    def _timing(self, sim_time_s: float) -> dict[str, float]:
        out = {"wall_time_s": self.wall_time_s}
        if self.wall_time_s > 0.0:
            out["realtime_factor"] = sim_time_s / self.wall_time_s
        rows = self.stopwatch.rows
        if rows:
            out |= metrics.scan_times(self.stopwatch.key_scan_ms())
            out |= {f"stage_ms_mean.{stage}": self.stopwatch.totals[stage] / len(rows) for stage in STAGES}
        return out


def _outcome(file: Path) -> str:
    """Why a run ended, from its metrics; a run without them was stopped."""
    try:
        return str(json.loads(file.read_text(encoding="utf-8"))["outcome"])
    except (OSError, ValueError, LookupError, TypeError, RecursionError):
        return "interrupted"


def _places_left(file: Path) -> list[Place]:
    """What an exploration left unseen, from its table; nothing of a run without one."""
    try:
        with file.open(newline="", encoding="utf-8") as rows:
            return [
                Place(float(row["x"]), float(row["y"]), float(row["area_m2"]), as_reason(row["reason"]))
                for row in csv.DictReader(rows)
            ]
    except (OSError, ValueError, LookupError, TypeError):
        return []
