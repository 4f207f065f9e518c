"""Metrics of a run from its trace: errors, consistency, coverage and timing."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sixthsense.core.covariance import landmark_covariances
from sixthsense.core.source import seconds
from sixthsense.evaluation import metrics
from sixthsense.evaluation.consistency import consistency
from sixthsense.evaluation.coverage import coverage_of
from sixthsense.evaluation.curves import key_errors
from sixthsense.evaluation.results import QUANTITIES, Metrics
from sixthsense.evaluation.true_identities import landmark_identities, true_identities
from sixthsense.record.trace import STAGES

if TYPE_CHECKING:
    from sixthsense.record.trace import Trace

_COUNTED = ("plans_below_margin", "guard_stops", "plans_by_astar")
"""metrics that a trace has under the same name, or as None"""


def measure(trace: Trace) -> Metrics:
    """The metrics of a run, without keys for what cannot be measured."""
    out = Metrics(outcome=trace.outcome)
    if trace.truths:
        out |= _errors(trace) | _error_at_end(trace) | _of_scene(trace)
    return Metrics({**out, **_consistency(trace), **_relations(trace), **_record(trace), **_timing(trace)})


def _record(trace: Trace) -> dict[str, float | str]:
    """The verdict, what was used of the source, the map, the path, and parameters that were estimated."""
    out: dict[str, float | str] = {"scans": len(trace.stamps_ns), "keyframes": len(trace.key_stamps_ns)}
    if len(trace.stamps_ns) > 1:
        out["largest_gap_s"] = seconds(float(np.diff(trace.stamps_ns).max()))
    if trace.grid is not None and (area_m2 := trace.grid.seen_area_m2):
        out["area_seen_m2"] = area_m2
    if trace.verdict is not None:
        out["verdict"] = str(trace.verdict)
        if trace.verdict.probability is not None:
            out["map_wrong_probability"] = trace.verdict.probability
    if trace.config.front_end == "landmarks":
        out["landmarks"] = len(trace.records)
    if trace.loop_closures is not None:
        out["loop_closures_found"] = trace.loop_closures.found
        if not trace.loop_closures.found and trace.verdict is not None:
            out["keyframes_passed_before"] = int(trace.verdict.evidence.get("keyframes_passed_before", 0))
    for name, parameters in (("wheel_", trace.wheels), ("sensor_", trace.sensor)):
        if parameters is not None:  # (2, n), values and sigmas
            out |= zip((key for key in QUANTITIES if key.startswith(name)), parameters[0].tolist(), strict=True)
    if trace.outcome.startswith("explored") or trace.left:
        out["places_left"] = len(trace.left)
    out["path_length_m"] = trace.path_length_m
    if trace.plans or trace.guard_stops is not None:
        out["plans"] = len(trace.plans)
    return out | {name: value for name in _COUNTED if (value := getattr(trace, name)) is not None}


def _error_at_end(trace: Trace) -> dict[str, float]:
    """Distance of the true position from the goal, or from the start after an exploration that returned home."""
    config, name = trace.config, "goal_error_m"
    place: Any = None
    if config.task == "goal":
        place = config.goal or (trace.scene.goal if trace.scene is not None else None)
    elif config.task == "explore" and config.explore.return_home and trace.outcome.startswith("explored"):
        name, place = "home_error_m", trace.truths[0][:2]
    if place is None or trace.last_position is None:
        return {}
    return {name: float(np.hypot(*(trace.last_position - place)))}


def _relations(trace: Trace) -> dict[str, float]:
    if trace.relations is None:
        return {}
    given, stamps = trace.relations, np.array(trace.log_stamps_s)
    # A replay that ended early is compared with the relations of its part only.
    reached = np.isin(np.round(given.stamps, 6), np.round(stamps, 6)).all(axis=1)
    if not reached.any():
        return {}
    found = metrics.relations_error(stamps, trace.scan_poses(), given.stamps[reached], given.poses[reached])
    metres, degrees = float(found[0].mean()), float(np.degrees(found[1]).mean())
    return {"relations_trans_m_mean": metres, "relations_rot_deg_mean": degrees}


def _errors(trace: Trace) -> dict[str, float]:
    truth, estimate = np.array(trace.truths), np.array(trace.estimates)
    out = {
        "collisions": int(trace.outcome == "collided"),
        "ate_rmse_m": metrics.ate(estimate, truth),
        "dead_reckoning_ate_rmse_m": metrics.ate(np.array(trace.odometry), truth),
        "heading_rmse_rad": metrics.heading_rmse(estimate, truth),
    }
    for length_m in metrics.RPE_LENGTHS_M:
        translation, angle = metrics.relative_pose_errors(estimate, truth, length_m)
        if len(angle):
            out[f"rpe_trans_m_{length_m}m"] = float(np.sqrt(np.mean(translation**2)))
            out[f"rpe_rot_deg_{length_m}m"] = float(np.degrees(np.sqrt(np.mean(angle**2))))
    return out | dict(zip(("touches_by_robot", "touches_by_walkers"), trace.touches or (), strict=False))


def _consistency(trace: Trace) -> dict[str, float]:
    """NEES of the pose after each update; NIS and discarded observations."""
    out: dict[str, float] = {}
    if trace.key_truths and len((errors := key_errors(trace))[0]):
        found = consistency([errors])
        out["pose_nees_world_mean"], out["pose_nees_effective_samples"] = found.nees, found.samples
    dof = sum(a.dof for a in trace.associations)
    if dof:
        out["nis_mean_per_dof"] = sum(a.nis for a in trace.associations) / dof
    discarded = sum(a.discarded for a in trace.associations)
    if seen := discarded + sum(len(a.observations) + a.fused for a in trace.associations):
        out["discarded_share"] = discarded / seen
    return out


def _of_scene(trace: Trace) -> dict[str, float]:
    """Coverage, errors of points, and NEES at the end of the landmarks whose true wall or point is known."""
    if trace.scene is None:
        return {}
    final, known = trace.final, true_identities(trace.scene.walls)
    out: dict[str, float] = {}
    if not final.walls.all():
        rmse, matched = metrics.match_landmarks(final.landmarks[~final.walls], known.points, 0.5)
        out |= {"landmark_rmse_m": rmse} if matched else {}
    if np.isfinite(share := float(coverage_of(trace)[1][-1])):
        out["coverage"] = share
    associations = [one.observations for one in trace.associations]
    identities = landmark_identities(associations, np.array(trace.key_truths), known)
    rows = [k for k, i in enumerate(final.ids.tolist()) if i in identities]
    if rows:
        truth = np.array([known.landmark(identities[i]) for i in final.ids[rows].tolist()])
        covs = landmark_covariances(trace.joint_cov)[rows]
        nees = metrics.nees_landmarks(final.landmarks[rows], truth, final.walls[rows], covs)
        out["landmark_nees_mean"] = float(nees.mean())
    return out


def _timing(trace: Trace) -> dict[str, float]:
    sim_time_s = seconds(trace.stamps_ns[-1] - trace.stamps_ns[0]) if trace.stamps_ns else 0.0
    out = {"sim_time_s": sim_time_s, "wall_time_s": trace.wall_time_s}
    if trace.wall_time_s > 0.0:
        out["realtime_factor"] = sim_time_s / trace.wall_time_s
    if rows := trace.stopwatch.rows:
        times = np.percentile(trace.stopwatch.keyframe_ms(), [50, 99]).tolist()
        out |= dict(zip(("scan_ms_p50", "scan_ms_p99"), times, strict=True))
        totals = trace.stopwatch.totals
        out |= {f"stage_ms_mean.{stage}": totals[stage] / len(rows) for stage in STAGES if totals[stage] > 0.0}
    return out
