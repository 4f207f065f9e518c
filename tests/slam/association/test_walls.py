"""Walls as landmarks: geometry, observations, and all estimators on them."""

import math

import gtsam
import numpy as np
import pytest

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.slam.association import associator as associator_module
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.association.observed import fused
from sixthsense.slam.estimators import make_estimator
from sixthsense.slam.estimators.isam2_factors import lines, measurement

COV = np.array([[4e-5, 1e-5], [1e-5, 1e-4]])


def test_a_walls_factor_does_not_depend_on_the_predicted_pose():
    pose, frame = Pose(0.3, -0.2, 0.4), Pose(2.0, 3.0, -0.3)
    z = lines((pose.inverse() @ frame).array()[None])[0][0] + np.array([0.2, -0.1])
    observation = Observation(Kind.WALL, z, COV)
    place, root = measurement(pose, frame, observation, is_first=False)
    assert lines(place.inverse().array()[None])[0][0] == pytest.approx(observation.z, abs=1e-12)
    # The residual ignores the place along the wall; offset and heading are weighted by the observation's covariance.
    turn, d = 0.01, 0.02
    for along in (0.0, 0.05):
        off = Pose(place.x + along, place.y - d, place.theta - turn)
        residual = root @ gtsam.Pose2.Logmap(gtsam.Pose2(*(place.inverse() @ off).array()))
        error = np.array([turn, d])
        assert residual @ residual == pytest.approx(error @ np.linalg.solve(COV, error), rel=0.05)


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
