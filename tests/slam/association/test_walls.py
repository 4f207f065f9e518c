"""Walls as landmarks: geometry, observations, and all estimators on them."""

import math

import gtsam
import numpy as np
import pytest
from laws.nees import error_of, normalised
from point_world import joint_state
from predicted import predict_walls
from scanned import box, look

from sixthsense.config import AssociationConfig, preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import run
from sixthsense.simulation.scene import load_scene
from sixthsense.slam.association import associator as associator_module
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.observed import ends, fused
from sixthsense.slam.estimators import ESTIMATORS, make_estimator
from sixthsense.slam.estimators.isam2_factors import lines, measurement
from sixthsense.slam.features import extract

WALLS = np.array([[0.0, -4.0], [math.pi / 2, -3.0], [3.0, -5.0], [-math.pi / 2, -4.5], [0.7, -6.0], [2.4, -5.0]])
ROOM = box(-3, -2, 6, 4)
COV = np.array([[4e-5, 1e-5], [1e-5, 1e-4]])
STEP = Odometry(Pose(0.2, 0.0, 0.1), np.diag([2e-4, 1e-4, 1e-4]))


def sight(pose, ids, rng=None, walls=WALLS):
    z, _, _ = predict_walls(pose, walls[list(ids)])
    noise = np.zeros_like(z) if rng is None else rng.multivariate_normal(np.zeros(2), COV, len(z))
    return {i: Observation(Kind.WALL, z[k] + noise[k], COV, (-1.0, 1.5)) for k, i in enumerate(ids)}


@pytest.mark.parametrize("name", ESTIMATORS)
def test_poses_and_walls_are_consistent_over_many_runs(name):
    """NEES of the pose (3) and of each wall (2) within 4 sigma of their mean over 60 runs."""
    pose, wall = [], []
    for seed in range(60):
        rng = np.random.default_rng(seed)
        estimator, true = make_estimator(name, Pose(), np.zeros((3, 3))), Pose()
        for _ in range(40):
            error = rng.multivariate_normal(np.zeros(3), STEP.cov)
            true = true @ STEP.motion @ Pose.from_array(error)
            estimator.predict(STEP)
            estimator.update(sight(true, rng.choice(6, 3, replace=False), rng))
        estimate, joint = joint_state(estimator)
        error = error_of(estimate, true, WALLS)
        pose.append(normalised(error[:3], joint[:3, :3]))
        wall.append(
            np.mean([normalised(error[a : a + 2], joint[a : a + 2, a : a + 2]) for a in range(3, len(joint), 2)])
        )
    assert abs(np.mean(pose) - 3.0) < 4 * math.sqrt(6 / 60)
    assert abs(np.mean(wall) - 2.0) < 4 * math.sqrt(4 / 60)


def test_the_walls_of_a_room_are_observed_with_their_true_errors():
    rng, values = np.random.default_rng(3), []
    config = preset(features={"landmarks": "walls"})
    truth = np.array([[math.pi / 2, -2.0], [math.pi, -3.0], [-math.pi / 2, -2.0], [0.0, -3.0]])
    for _ in range(60):
        pose = Pose(*rng.uniform([-1.5, -1.0, -math.pi], [1.5, 1.0, math.pi]))
        found = extract(look(pose, ROOM, sigma=0.01, rng=rng), config.assumed, config.features).observations
        assert len(found) >= 4 and all(s.is_wall and s.z[1] < 0.0 for s in found)
        z, _, _ = predict_walls(pose, truth)
        for s in found:
            e = s.z - z[np.abs(wrap_angle(z[:, 0] - s.z[0])).argmin()]
            e[0] = wrap_angle(float(e[0]))
            values.append(e @ np.linalg.solve(s.cov, e))
            segment = ends(pose, s)
            assert np.abs(segment).max(axis=0)[0] < 3.1 and np.abs(segment).max(axis=0)[1] < 2.1
    assert abs(np.mean(values) - 2.0) < 4 * math.sqrt(4 / len(values))


def test_a_walls_factor_does_not_depend_on_the_predicted_pose():
    pose, frame = Pose(0.3, -0.2, 0.4), Pose(2.0, 3.0, -0.3)
    observation = Observation(
        Kind.WALL, lines((pose.inverse() @ frame).array()[None])[0][0] + np.array([0.2, -0.1]), COV
    )
    place, root = measurement(pose, frame, observation, is_first=False)
    assert lines(place.inverse().array()[None])[0][0] == pytest.approx(observation.z, abs=1e-12)
    # The residual ignores the place along the wall; offset and heading are weighted by the observation's covariance.
    turn, d = 0.01, 0.02
    for along in (0.0, 0.05):
        off = Pose(place.x + along, place.y - d, place.theta - turn)
        residual = root @ gtsam.Pose2.Logmap(gtsam.Pose2(*(place.inverse() @ off).array()))
        error = np.array([turn, d])
        assert residual @ residual == pytest.approx(error @ np.linalg.solve(COV, error), rel=0.05)


@pytest.mark.parametrize(
    ("pose", "wall"),
    [
        (Pose(7.70, 5.92, -2.66), (0.0, 6.2)),
        (Pose(11.60, 2.96, 1.01), (math.pi, -14.0)),
        (Pose(3.57, 4.12, 1.16), (math.pi / 2, 2.4)),
        (Pose(10.67, 5.02, 0.45), (-math.pi / 2, -6.6)),
        (Pose(7.70, 5.93, 0.86), (0.0, 6.2)),
    ],
)
def test_a_neighbouring_wall_with_a_single_return_does_not_rotate_a_wall(pose, wall):
    # At these poses in the apartment that return lies 2 to 4 cm off the wall's line, at its end.
    walls, config, rng, turns = load_scene("apartment").walls, preset(), np.random.default_rng(4), []
    z = predict_walls(pose, np.array([wall]))[0][0]
    for _ in range(60):
        for s in extract(look(pose, walls, config.laser, 0.01, rng), config.assumed, config.features).observations:
            turn = wrap_angle(float(s.z[0] - z[0]))
            if s.is_wall and abs(turn) < 0.1 and abs(s.z[1] - z[1]) < 0.3:
                turns.append(turn / math.sqrt(s.cov[0, 0]))
    assert len(turns) >= 50
    assert abs(np.mean(turns)) < 4.0 / math.sqrt(len(turns))


def test_two_pieces_of_a_wall_in_one_scan_are_fused_by_their_information():
    one = Observation(Kind.WALL, np.array([math.pi - 0.01, -2.0]), np.diag([1e-4, 1e-3]), (-1.0, 0.0))
    two = Observation(Kind.WALL, np.array([-math.pi + 0.01, -2.2]), np.diag([1e-4, 1e-3]), (1.0, 2.0))
    both = fused(one, two)
    assert abs(wrap_angle(both.z[0] - math.pi)) < 3e-4 and both.z[1] == pytest.approx(-2.1, abs=2e-4)
    assert np.allclose(both.cov, np.diag([5e-5, 5e-4]), rtol=1e-2, atol=2e-6) and both.extent == (-1.0, 2.0)


def test_a_wall_is_matched_again_and_its_other_side_is_a_new_one():
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(AssociationConfig())
    wall = Observation(Kind.WALL, np.array([0.0, -2.0]), COV, (-1.0, 1.0))
    other = Observation(Kind.WALL, np.array([math.pi, 1.9]), COV, (-1.0, 1.0))
    point = Observation(Kind.END, np.array([-2.0, 1.0]), np.eye(2) * 1e-4)
    for expected_new in (3, 0):
        found = associator.associate([wall, other, point], estimator)
        assert len(found.observations) - found.dof // 2 == expected_new and found.discarded == 0
        estimator.update(found.observations)
    beside = Observation(Kind.WALL, np.array([0.0, -2.0]), COV, (3.0, 4.0))  # in line, two metres on
    assert associator.associate([beside], estimator).dof == 0
    longer = Observation(Kind.WALL, np.array([0.0, -2.0]), COV, (0.5, 1.4))
    assert associator.associate([longer], estimator).dof == 2
    assert sorted(np.round(associator.records[0].extent[:, 1], 6)) == [-1.0, 1.4]


def test_of_two_walls_that_meet_the_one_is_matched_that_covers_the_observation():
    """The piece lies on the first wall, but noise has put it onto the line of the second, which ends there."""
    bend, certain = 0.008, np.diag([1e-8, 1e-8])
    first = Observation(Kind.WALL, np.array([0.0, 2.0]), certain, (0.0, 4.0))
    second = Observation(Kind.WALL, np.array([bend, 2.0 * math.cos(bend)]), certain, (-4.0, 0.0))
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(AssociationConfig())
    estimator.update(associator.associate([first, second], estimator).observations)
    assert len(associator.records) == 2
    piece = Observation(Kind.WALL, np.array([bend, 2.0 * math.cos(bend)]), np.diag([4e-4, 2.5e-5]), (-0.05, 0.9))
    assert list(associator.associate([piece], estimator).observations) == [0]
    beyond = Observation(Kind.WALL, np.array([bend, 2.0 * math.cos(bend)]), np.diag([4e-4, 2.5e-5]), (-0.9, 0.05))
    assert list(associator.associate([beyond], estimator).observations) == [1]


def test_another_piece_of_a_known_wall_is_fused_unless_it_is_offset():
    for step, fused_in in ((0.0, True), (0.2, False)):
        estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(AssociationConfig())
        wall = Observation(Kind.WALL, np.array([0.0, -2.0]), COV, (-1.0, 3.0))
        estimator.update(associator.associate([wall], estimator).observations)
        near = Observation(Kind.WALL, np.array([0.0, -2.0]), COV, (-1.0, 0.5))
        far = Observation(Kind.WALL, np.array([0.0, -2.0 + step]), COV, (1.0, 3.0))
        found = associator.associate([near, far], estimator)
        assert found.dof == 2 and len(found.observations) == 1
        assert np.allclose(found.observations[0].cov, COV / 2 if fused_in else COV, rtol=5e-3)  # and the wall's shape
        assert found.observations[0].extent == ((-1.0, 3.0) if fused_in else (-1.0, 0.5))
        assert found.nis == pytest.approx(0.0, abs=1e-9) and found.discarded == (0 if fused_in else 1)


def test_duplicate_walls_are_merged(monkeypatch):
    monkeypatch.setattr(associator_module, "CULL_PERIOD", 2)
    config = AssociationConfig(cull_below=1)
    for offset, gone in ((0.005, [1]), (0.15, [])):
        estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(config)
        # Two pieces with a gap too large for one wall, until an observation of the first reaches the second.
        first = Observation(Kind.WALL, np.array([0.0, -2.0]), COV, (-2.0, -0.5))
        second = Observation(Kind.WALL, np.array([0.0, -2.0 + offset]), COV, (0.5, 2.0))
        for longer in (-0.5, 0.48):
            seen = Observation(Kind.WALL, first.z, COV, (-2.0, longer))
            association = associator.associate([seen, second], estimator)
            estimator.update(association.observations)
            assert estimator.estimate().walls.sum() == 2
            merged = associator.forgotten(estimator, estimator.estimate())
        estimator.forget(merged)
        assert merged == gone and associator.walls_merged == len(gone)
        if gone:
            assert associator.records[0].observations == 4
            assert sorted(np.round(associator.records[0].extent[:, 1], 3)) == [-2.0, 2.0]


@pytest.mark.parametrize("kinds", ["walls", "both"])
@pytest.mark.parametrize("estimator", ["ekf", "ekf-invariant", "isam2"])
def test_walls_hold_the_block_where_corners_let_it_drift(kinds, estimator):
    given = {"scene": "block", "estimator": estimator, "task": "tour", "max_time": 100.0}
    corners = measure(run(preset(**given, features={"landmarks": "corners"})))["ate_rmse_m"]
    trace = run(preset(**given, features={"landmarks": kinds}))
    assert trace.outcome == "tour ended" and trace.final.walls.sum() == 8
    assert measure(trace)["ate_rmse_m"] < min(0.01, 0.5 * corners)
