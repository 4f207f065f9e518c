import math

import numpy as np
import pytest
from predicted import predict_points

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association import associator as associator_module
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import make_estimator

BY_GATE = AssociationConfig(new_separation_m=0.0)
REPORT = AssociationConfig(match_gate=20.0, new_gate=200.0, new_separation_m=0.0)
POINTS = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0], [4.0, 3.0], [-2.0, -1.0]])


def sight(pose, ids, rng=None, sigma=0.02, points=POINTS):
    z, _, _ = predict_points(pose, points[list(ids)])
    z = z if rng is None else z + rng.normal(0, sigma, z.shape)
    return [Observation(Kind.CORNER, row, np.eye(2) * sigma**2) for row in z]


def updated(estimator, associator, observations):
    """The landmarks that are forgotten after a keyframe."""
    association = associator.associate(observations, estimator)
    estimator.update(association.observations)
    gone = associator.forgotten(estimator, estimator.estimate())
    estimator.forget(gone)
    return gone


def known(config=None, sigma=0.02):
    """An estimator that has seen the five points once, its associator, and its pose."""
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(config or AssociationConfig())
    estimator.update(associator.associate(sight(Pose(), range(5), sigma=sigma), estimator).observations)
    return estimator, associator


@pytest.mark.parametrize(
    ("config", "squared", "expected"),
    [
        *((BY_GATE, k**2, n) for k, n in ((1.0, (1, 0)), (4.5, (0, 0)), (12.0, (0, 1)))),
        *((REPORT, k, n) for k, n in ((19.0, (1, 0)), (21.0, (0, 0)), (199.0, (0, 0)), (201.0, (0, 1)))),
    ],
)
def test_a_near_observation_is_matched_a_far_one_is_new_and_an_ambiguous_one_is_discarded(config, squared, expected):
    """By the squared Mahalanobis distance, as in the report."""
    estimator, associator = known(config)
    point = POINTS[0] + [0.02 * math.sqrt(2 * squared), 0.0]
    found = associator.associate([Observation(Kind.END, point, np.eye(2) * 4e-4)], estimator)
    assert (found.dof // 2, len(found.observations) - found.dof // 2) == expected
    assert found.discarded == 1 - sum(expected)


def test_one_scan_that_shows_an_end_twice_makes_one_landmark():
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(AssociationConfig())
    twice = [Observation(Kind.END, np.array([2.0, d]), np.eye(2) * 1e-4) for d in (0.0, 0.03)]
    assert len(associator.associate(twice, estimator).observations) == 1


def test_culling_removes_landmarks_seen_too_rarely_but_no_younger_ones(monkeypatch):
    monkeypatch.setattr(associator_module, "CULL_PERIOD", 5)
    config = AssociationConfig(cull_below=3)
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(config)
    culled = []
    for scan in range(1, 11):
        ids = [0] if scan not in (1, 8) else [0, 1] if scan == 1 else [0, 2]
        gone = updated(estimator, associator, sight(Pose(), ids))
        culled += [(scan, i) for i in gone]
    assert culled == [(10, 1)]  # at scan 5 it was too young, as the third is at scan 10
    assert associator.culled == 1 and sorted(associator.records) == [0, 2]
    monkeypatch.setattr(associator_module, "CULL_PERIOD", 1)
    estimator, off = known(AssociationConfig(cull_below=0))
    assert updated(estimator, off, sight(Pose(), range(5))) == []


@pytest.mark.parametrize("sigma", [0.01, 0.05])
def test_the_nis_of_all_matches_together_is_their_degrees_of_freedom(sigma):
    """300 drives from an exact start; matches are correlated through the pose, which the joint NIS accounts for."""
    nis = dof = 0.0
    config = AssociationConfig()
    for seed in range(300):
        rng = np.random.default_rng(seed)
        estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(config)
        estimator.update(associator.associate(sight(Pose(), range(5), rng, sigma), estimator).observations)
        cov = np.diag([2e-3, 2e-3, 1e-3])
        true = Pose.from_array(np.array([0.2, 0.0, 0.1]) + rng.multivariate_normal(np.zeros(3), cov))
        estimator.predict(Odometry(Pose(0.2, 0.0, 0.1), cov))
        found = associator.associate(sight(true, range(5), rng, sigma), estimator)
        nis, dof = nis + found.nis, dof + found.dof
    assert dof > 2900  # the gate loses one in a thousand
    assert nis / dof == pytest.approx(1.0, abs=4 * math.sqrt(2 / dof))


def test_named_observations_are_accepted_and_gated_by_their_innovation():
    estimator, associator = make_estimator("ekf", Pose(), np.zeros((3, 3))), Associator(AssociationConfig())
    first = dict(zip([7, 3], sight(Pose(), [0, 1]), strict=True))
    found = associator.match_named(first, estimator)
    assert found.observations == first and found.dof == 0 and found.nis == 0.0
    estimator.update(found.observations)
    off = Observation(Kind.CORNER, POINTS[0] + [0.02 * math.sqrt(2), 0.0], np.eye(2) * 4e-4)
    found = associator.match_named({7: off, 9: sight(Pose(), [2])[0]}, estimator)
    assert found.dof == 2 and math.isclose(found.nis, 1.0, rel_tol=1e-9)
    assert {i: r.observations for i, r in associator.records.items()} == {7: 2, 3: 1, 9: 1}
    assert {i: (r.first_scan, r.last_scan) for i, r in associator.records.items()} == {7: (1, 2), 3: (1, 1), 9: (2, 2)}
