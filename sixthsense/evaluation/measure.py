"""Metrics of a run from its trace: errors, consistency, coverage and timing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.source import seconds
from sixthsense.evaluation import metrics
from sixthsense.evaluation.consistency import consistency
from sixthsense.evaluation.coverage import coverage_of
from sixthsense.evaluation.curves import key_errors, key_poses
from sixthsense.evaluation.results import QUANTITIES, Metrics
from sixthsense.evaluation.true_identities import TrueLaser, landmark_identities, true_identities
from sixthsense.record.trace import STAGES
from sixthsense.simulation.scene import Scene

if TYPE_CHECKING:
    from sixthsense.record.trace import Trace


def measure(trace: Trace) -> Metrics:
    """The metrics of a run, without keys for what cannot be measured."""
    out = Metrics(outcome=trace.outcome)
    if trace.truths:
        out["collisions"] = int(trace.outcome == "collided")
        if trace.touches is not None:
            out["touches_by_robot"], out["touches_by_walkers"] = trace.touches
        out |= _goal_error(trace) | _home_error(trace)
        out |= _errors(trace)
        if trace.scene is not None:
            share = float(coverage_of(trace)[1][-1])
            out |= {"coverage": share} if np.isfinite(share) else {}
            out |= _landmark_nees(trace, trace.scene)
    out |= _consistency(trace)
    out |= _relations(trace)
    out |= _evidence(trace)
    if trace.verdict is not None:
        out["verdict"] = str(trace.verdict)
        if trace.verdict.probability is not None:
            out["map_wrong_probability"] = trace.verdict.probability
    if trace.config.front_end == "landmarks":
        out["landmarks"] = len(trace.records)
    if trace.loop_closures is not None:
        out["loop_closures_found"] = trace.loop_closures.found
    for name, parameters in (("wheel_", trace.wheels), ("sensor_", trace.sensor)):
        if parameters is not None:  # (2, n), values and sigmas
            out |= zip((key for key in QUANTITIES if key.startswith(name)), parameters[0].tolist(), strict=True)
    if trace.outcome.startswith("explored") or trace.left:
        out["places_left"] = len(trace.left)
        out["area_left_m2"] = sum(place.area_m2 for place in trace.left)
    out["path_length_m"] = trace.path_length_m
    if trace.plans or trace.guard_stops is not None:
        out["plans"] = len(trace.plans)
    if trace.plans_below_margin is not None and trace.guard_stops is not None:
        out["plans_below_margin"], out["guard_stops"] = trace.plans_below_margin, trace.guard_stops
    if trace.plans_by_astar is not None:
        out["plans_by_astar"] = trace.plans_by_astar
    sim_time_s = seconds(trace.stamps_ns[-1] - trace.stamps_ns[0]) if trace.stamps_ns else 0.0
    out["sim_time_s"] = sim_time_s
    out |= _timing(trace, sim_time_s)
    return out


def _evidence(trace: Trace) -> dict[str, float]:
    """What was used of the source, and how much of the area was seen."""
    out: dict[str, float] = {"scans": len(trace.stamps_ns), "keyframes": len(trace.key_stamps_ns)}
    if len(trace.stamps_ns) > 1:
        out["largest_gap_s"] = seconds(float(np.diff(trace.stamps_ns).max()))
    if trace.grid is not None and (area_m2 := trace.grid.seen_area_m2):
        out["area_seen_m2"] = area_m2
    return out


def _goal_error(trace: Trace) -> dict[str, float]:
    """Distance of the true position from the goal; the outcome is judged by the estimate."""
    goal = trace.config.goal or (trace.scene.goal if trace.scene is not None else None)
    if goal is None or trace.config.task != "goal" or trace.last_position is None:
        return {}
    return {"goal_error_m": float(np.hypot(*(trace.last_position - np.array(goal))))}


def _home_error(trace: Trace) -> dict[str, float]:
    """Distance of the true position from the start after an exploration that returns home."""
    ended = trace.config.explore.return_home and trace.outcome.startswith("explored")
    if not ended or trace.config.task != "explore" or trace.last_position is None:
        return {}
    return {"home_error_m": float(np.hypot(*(trace.last_position - trace.truths[0][:2])))}


def _relations(trace: Trace) -> dict[str, float]:
    if trace.relations is None:
        return {}
    given = trace.relations
    stamps = np.array(trace.log_stamps_s)
    # A replay that ended early is compared with the relations of its part only.
    reached = np.isin(np.round(given.stamps, 6), np.round(stamps, 6)).all(axis=1)
    if not reached.any():
        return {}
    poses = trace.scan_poses()
    translation, angle = metrics.relations_error(stamps, poses, given.stamps[reached], given.poses[reached])
    return {
        "relations_trans_m_mean": float(translation.mean()),
        "relations_rot_deg_mean": float(np.degrees(angle).mean()),
    }


def _errors(trace: Trace) -> dict[str, float]:
    truth, estimate = np.array(trace.truths), np.array(trace.estimates)
    out = {
        "ate_rmse_m": metrics.ate(estimate, truth),
        "dead_reckoning_ate_rmse_m": metrics.ate(np.array(trace.odometry), truth),
        "heading_rmse_rad": metrics.heading_rmse(estimate, truth),
    }
    out |= relative_errors(trace)
    if trace.scene is not None and not trace.final.walls.all():
        corners = metrics.true_landmarks(trace.scene.walls)
        rmse, matched = metrics.match_landmarks(trace.final.landmarks[~trace.final.walls], corners, 0.5)
        if matched:
            out["landmark_rmse_m"] = rmse
    return out


def relative_errors(trace: Trace) -> dict[str, float]:
    """The relative pose error over each length that the robot has driven; the trace must have truth."""
    out: dict[str, float] = {}
    for length_m in metrics.RPE_LENGTHS_M:
        translation, angle = metrics.relative_pose_errors(np.array(trace.estimates), np.array(trace.truths), length_m)
        if len(angle):
            out[f"rpe_trans_m_{length_m}m"] = float(np.sqrt(np.mean(translation**2)))
            out[f"rpe_rot_deg_{length_m}m"] = float(np.degrees(np.sqrt(np.mean(angle**2))))
    return out


def _consistency(trace: Trace) -> dict[str, float]:
    """NEES of the pose after each update; NIS and discarded observations."""
    out: dict[str, float] = {}
    if trace.key_truths and len((errors := key_errors(trace))[0]):
        found = consistency([errors])
        out["pose_nees_world_mean"], out["pose_nees_effective_samples"] = found.nees, found.samples
        poses, covs = (one[-len(errors[0]) :] for one in key_poses(trace.key_estimates))
        truth = np.array(trace.key_truths)[-len(errors[0]) :]
        out["pose_nees_invariant_mean"] = float(np.mean(metrics.nees_invariant(poses, truth, covs)))
    dof = sum(a.dof for a in trace.associations)
    if dof:
        out["nis_mean_per_dof"] = sum(a.nis for a in trace.associations) / dof
    discarded = sum(a.discarded for a in trace.associations)
    if seen := discarded + sum(len(a.observations) + a.fused for a in trace.associations):
        out["discarded_share"] = discarded / seen
    return out


def _landmark_nees(trace: Trace, scene: Scene) -> dict[str, float]:
    """NEES at the end of the landmarks whose true wall or point is known."""
    known = true_identities(scene.walls)
    laser = TrueLaser(trace.config.laser, trace.config.assumed.laser)
    identities = landmark_identities(
        [a.observations for a in trace.associations], np.array(trace.key_truths), known, laser
    )
    rows = [k for k, i in enumerate(trace.final.ids.tolist()) if i in identities]
    if not rows:
        return {}
    truth = np.array([known.landmark(identities[i]) for i in trace.final.ids[rows].tolist()])
    covs = landmark_covariances(trace.joint_cov)[rows]
    nees = metrics.nees_landmarks(trace.final.landmarks[rows], truth, trace.final.walls[rows], covs)
    return {"landmark_nees_mean": float(np.mean(nees))}


def _timing(trace: Trace, sim_time_s: float) -> dict[str, float]:
    out = {"wall_time_s": trace.wall_time_s}
    if trace.wall_time_s > 0.0:
        out["realtime_factor"] = sim_time_s / trace.wall_time_s
    rows = trace.stopwatch.rows
    if rows:
        out |= metrics.scan_times(trace.stopwatch.keyframe_ms())
        totals = trace.stopwatch.totals
        out |= {f"stage_ms_mean.{stage}": totals[stage] / len(rows) for stage in STAGES if totals[stage] > 0.0}
    return out
