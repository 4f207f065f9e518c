"""Every figure of a run from a second source: a few plain lines over a record made by hand."""

import dataclasses
import itertools
import math

import numpy as np
import pytest
from made_run import CARRIED, CORNERS, FIRST_KEY, SCANS, UNDEFINED, made_run, matrix

from sixthsense.config import merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.consistency import consistency
from sixthsense.evaluation.coverage import coverage_of
from sixthsense.evaluation.curves import curves, scan_covariances
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.measured_run import MAX_RUNS, MeasuredRun, check_folders
from sixthsense.logs.log import Relations
from sixthsense.record.trace import Trace

TRACE = made_run()
KEYS = len(TRACE.key_stamps_ns)


@pytest.fixture(scope="module")
def found():
    return measure(TRACE)


def with_config(trace: Trace = TRACE, **fields) -> Trace:
    return dataclasses.replace(trace, config=merge(trace.config, fields))


def angle(value):
    """In [-pi, pi], by the remainder."""
    return math.remainder(value, 2.0 * math.pi)


def rms(values):
    return math.sqrt(sum(value**2 for value in values) / len(values))


def between(a, b):
    """Translation and turn of b in the frame of a, by matrices."""
    motion = np.linalg.inv(matrix(a)) @ matrix(b)
    return np.array([motion[0, 2], motion[1, 2], math.atan2(motion[1, 0], motion[0, 0])])


def size(motion):
    return math.hypot(motion[0], motion[1]), abs(motion[2])


def key_errors(estimates):
    """Error and covariance of each keyframe whose covariance has full rank."""
    pairs = list(zip(estimates, TRACE.key_truths, strict=True))[UNDEFINED:]
    for one, truth in pairs:
        error = one.pose.array() - truth
        yield np.array([error[0], error[1], angle(error[2])]), one.pose_cov


def squared(error, cov):
    return float(error @ np.linalg.inv(cov) @ error)


def test_absolute_errors_are_root_mean_squares_over_all_scans(found):
    truths = TRACE.truths
    off = [math.dist(a[:2], b[:2]) for a, b in zip(TRACE.estimates, truths, strict=True)]
    assert found["ate_rmse_m"] == pytest.approx(rms(off))
    off = [math.dist(a[:2], b[:2]) for a, b in zip(TRACE.odometry, truths, strict=True)]
    assert found["dead_reckoning_ate_rmse_m"] == pytest.approx(rms(off))
    turns = [a[2] - b[2] for a, b in zip(TRACE.estimates, truths, strict=True)]
    assert max(map(abs, turns)) > 6.0  # a heading and its truth on both sides of the cut
    assert found["heading_rmse_rad"] == pytest.approx(rms(list(map(angle, turns))))


@pytest.mark.parametrize("length_m", [1, 2, 5, 10])
def test_relative_errors_are_root_mean_squares_over_all_pieces_of_so_much_true_path(found, length_m):
    truths, estimates = TRACE.truths, TRACE.estimates
    along = [0.0, *itertools.accumulate(math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(truths))]
    errors = []
    for i in range(SCANS - 1):
        j = min(range(i + 1, SCANS), key=lambda j: abs(along[j] - along[i] - length_m))
        if abs(along[j] - along[i] - length_m) <= 0.1 * length_m:
            errors.append(size(between(between(truths[i], truths[j]), between(estimates[i], estimates[j]))))
    assert 10 < len(errors) < SCANS - 1
    translation, rotation = zip(*errors, strict=True)
    assert found[f"rpe_trans_m_{length_m}m"] == pytest.approx(rms(translation))
    assert found[f"rpe_rot_deg_{length_m}m"] == pytest.approx(180.0 / math.pi * rms(rotation))


def test_errors_against_relations_are_those_of_the_final_poses_at_the_relations_that_the_run_reached(found):
    final = [matrix(TRACE.trajectory[k]) @ matrix(off) for k, off in zip(TRACE.last_key, TRACE.since_key, strict=True)]
    rows = [[TRACE.log_stamps_s.index(stamp) for stamp in pair if stamp in TRACE.log_stamps_s]
            for pair in TRACE.relations.stamps.tolist()]  # fmt: skip
    errors = []
    for pair, relation in zip(rows, TRACE.relations.poses, strict=True):
        if len(pair) == 2:
            motion = np.linalg.inv(matrix(relation)) @ np.linalg.inv(final[pair[0]]) @ final[pair[1]]
            errors.append((np.hypot(*motion[:2, 2]), abs(np.degrees(np.arctan2(motion[1, 0], motion[0, 0])))))
    assert len(errors) == 9
    told = [found[f"relations_{part}"] for part in ("trans_m_mean", "rot_deg_mean")]
    assert told == pytest.approx(np.mean(errors, axis=0))
    unreached = Relations(TRACE.relations.stamps + 2000.0, TRACE.relations.poses)
    assert not any("relations" in key for key in measure(dataclasses.replace(TRACE, relations=unreached)))


def test_the_nees_is_that_of_each_keyframe_of_full_rank_in_the_world(found):
    nees = [squared(*one) for one in key_errors(TRACE.key_estimates)]
    assert found["pose_nees_world_mean"] == pytest.approx(np.mean(nees))
    whole = consistency([tuple(map(np.array, zip(*key_errors(TRACE.key_estimates), strict=True)))])
    assert found["pose_nees_effective_samples"] == pytest.approx(whole.samples)


def test_the_nis_is_per_degree_of_freedom_and_the_discarded_are_a_share_of_all_observations(found):
    rows = TRACE.associations
    assert found["nis_mean_per_dof"] == pytest.approx(sum(a.nis for a in rows) / sum(a.dof for a in rows))
    discarded = sum(a.discarded for a in rows)
    assert found["discarded_share"] == discarded / (discarded + 3 + sum(a.fused for a in rows))  # 3 are used


def test_landmarks_are_judged_by_the_side_of_a_wall_that_was_seen_and_by_points_within_half_a_metre(found):
    """Normals point to the side that was seen: the upper wall's down, the right one's to the left."""
    truth = {12: [-0.5 * math.pi, -4.9], 13: [3.1, 1.6], 15: [-math.pi, -6.2]}
    nees = []
    for k, i in enumerate(TRACE.final.ids.tolist()):
        if i in truth:
            cov = TRACE.joint_cov[3 + 2 * k : 5 + 2 * k, 3 + 2 * k : 5 + 2 * k]
            nees.append(squared(TRACE.final.landmarks[k] - truth[i], cov))
    assert found["landmark_nees_mean"] == pytest.approx(np.mean(nees), rel=0.02)  # of the walls to first order
    points = TRACE.final.landmarks[[2, 4, 5, 6]]
    nearest = [min(math.dist(point, corner) for corner in CORNERS) for point in points]
    assert nearest[3] > 0.5 > max(nearest[:3])
    assert found["landmark_rmse_m"] == pytest.approx(rms(nearest[:3]))


def test_counts_areas_and_times_are_those_of_the_record(found):
    assert found["coverage"] == coverage_of(TRACE)[1][-1]
    expected = {
        "outcome": "explored in part", "collisions": 0, "touches_by_robot": 2, "touches_by_walkers": 5,
        "places_left": 2, "landmarks": 7, "loop_closures_found": 14,
        "path_length_m": 13.7,
        "plans": 3, "plans_below_margin": 4, "plans_by_astar": 6, "guard_stops": 7, "scans": SCANS, "keyframes": KEYS,
        "wall_time_s": 2.31, "stage_ms_mean.sense": 310.0 / KEYS, "stage_ms_mean.extract": 47.0 / KEYS,
        "stage_ms_mean.update": 81.0 / KEYS,
    }  # fmt: skip
    assert {key: found[key] for key in expected} == pytest.approx(expected)
    stamps = [1e-9 * (stamp - TRACE.stamps_ns[0]) for stamp in TRACE.stamps_ns]
    assert found["sim_time_s"] == pytest.approx(stamps[-1])
    assert found["realtime_factor"] == pytest.approx(stamps[-1] / 2.31)
    assert found["largest_gap_s"] == pytest.approx(max(b - a for a, b in itertools.pairwise(stamps)))
    ms = [1.0 + 0.1 * k**1.5 + 0.3 * k for k in range(KEYS)]  # ascending, sensing left out
    assert found["scan_ms_p50"] == pytest.approx((ms[10] + ms[11]) / 2)
    assert found["scan_ms_p99"] == pytest.approx(ms[20] + 0.79 * (ms[21] - ms[20]))  # 0.99 of 21 steps is 20.79
    assert measure(dataclasses.replace(TRACE, outcome="collided"))["collisions"] == 1


def test_the_home_error_is_of_an_exploration_that_came_home_and_the_goal_error_of_a_drive_to_a_goal(found):
    first = TRACE.truths[0]
    assert found["home_error_m"] == pytest.approx(math.hypot(4.3 - first[0], 3.9 - first[1]))
    for other in (with_config(explore={"return_home": False}), dataclasses.replace(TRACE, outcome="stuck")):
        assert "home_error_m" not in measure(other)
    to_goal = measure(with_config(task="goal"))
    assert to_goal["goal_error_m"] == pytest.approx(math.hypot(4.3 - 4.6, 3.9 - 2.2)) and "home_error_m" not in to_goal
    to_own = measure(with_config(task="goal", goal=(1.2, 2.3)))["goal_error_m"]
    assert to_own == pytest.approx(math.hypot(4.3 - 1.2, 3.9 - 2.3))
    assert "goal_error_m" not in found


def key_path():
    """Distance to each keyframe along the true path, without the way that the robot was carried."""
    carried = FIRST_KEY + 3 * CARRIED
    steps = [math.dist(a[:2], b[:2]) for a, b in itertools.pairwise(TRACE.truths)]
    return [sum(step for k, step in enumerate(steps[:scan]) if k != carried - 1) for scan in range(FIRST_KEY, SCANS, 3)]


def test_curves_are_the_errors_at_scans_over_time_and_the_true_path():
    found = {name: column.to_numpy() for name, column in curves(TRACE).items()}
    errors = [e - t for e, t in zip(TRACE.estimates, TRACE.truths, strict=True)]
    assert found["position_m"] == pytest.approx([math.hypot(e[0], e[1]) for e in errors])
    assert found["heading_rad"] == pytest.approx([abs(angle(e[2])) for e in errors])
    assert found["time_s"] == pytest.approx([1e-9 * (stamp - TRACE.stamps_ns[0]) for stamp in TRACE.stamps_ns])
    at_keys = [TRACE.stamps_ns.index(stamp) for stamp in TRACE.key_stamps_ns]
    assert found["distance_m"][at_keys] == pytest.approx(key_path())
    assert np.isnan(np.delete(found["nees"], at_keys[UNDEFINED:])).all()
    expected = [squared(*one) for one in key_errors(TRACE.key_estimates)]
    assert found["nees"][at_keys[UNDEFINED:]] == pytest.approx(expected)
    assert math.sqrt(np.mean(found["position_m"] ** 2)) == pytest.approx(measure(TRACE)["ate_rmse_m"])
    assert curves(dataclasses.replace(TRACE, truths=[])) is None


def test_the_covariance_at_a_scan_is_that_at_its_keyframe_and_of_the_motion_since():
    """By numerical derivatives of the composed pose; the motion's error has the axes of its end."""
    for k in np.flatnonzero(np.array(TRACE.last_key) >= 0).tolist():
        key = TRACE.key_estimates[TRACE.last_key[k]]
        since = key.pose.inverse() @ Pose(*TRACE.estimates[k])

        def pose(errors, key=key, since=since):
            return (Pose(*(key.pose.array() + errors[:3])) @ since @ Pose(*errors[3:])).array()

        steps = 1e-6 * np.eye(6)
        by = (
            np.array([[angle(off) if i == 2 else off for i, off in enumerate(pose(h) - pose(-h))] for h in steps]).T
            / 2e-6
        )
        joint = np.block([[key.pose_cov, np.zeros((3, 3))], [np.zeros((3, 3)), TRACE.since_covs[k]]])
        np.testing.assert_allclose(scan_covariances(TRACE)[k], by @ joint @ by.T, rtol=1e-5, atol=1e-8)


def test_a_trajectory_has_a_row_per_keyframe():
    run = MeasuredRun("made", TRACE)
    frame, poses = run.trajectory, [e.pose.array() for e in TRACE.key_estimates]
    sigmas = [np.sqrt(np.diag(e.pose_cov)) for e in TRACE.key_estimates]
    assert frame.index.tolist() == TRACE.key_stamps_ns and len(run.trajectory) == KEYS
    expected = {
        ("x", "y", "theta"): poses, ("sigma_x", "sigma_y", "sigma_theta"): sigmas,
        ("x_final", "y_final", "theta_final"): TRACE.trajectory, ("x_true", "y_true", "theta_true"): TRACE.key_truths,
    }  # fmt: skip
    for names, values in expected.items():
        np.testing.assert_allclose(frame[list(names)], values)
    own, at_keys = curves(TRACE).to_records(), [TRACE.stamps_ns.index(stamp) for stamp in TRACE.key_stamps_ns]
    of_keys = [values[at_keys] for values in (own.time_s, own.distance_m, own.nees)]
    np.testing.assert_allclose(frame[["time_s", "distance_m", "nees"]].T, of_keys, rtol=1e-12)


def test_one_folder_to_as_many_as_a_figure_has_room_for_are_read_together(tmp_path):
    (tmp_path / "config.toml").write_text("")
    check_folders([tmp_path])
    check_folders([tmp_path] * MAX_RUNS)
    for count in (0, MAX_RUNS + 1):
        with pytest.raises(InputError, match=f"found {count}, allowed: 1 to {MAX_RUNS}"):
            check_folders([tmp_path] * count)
