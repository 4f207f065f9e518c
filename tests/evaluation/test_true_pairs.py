"""The NIS of true pairs: with the survivors alone it is too small, with all pairs it is 2."""

import numpy as np
import pytest

from sixthsense.config import AssociationConfig, LaserConfig, LaserNoise, merge, preset
from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation, predict_walls
from sixthsense.evaluation.matches import InnovationObserver, true_pair_nis
from sixthsense.evaluation.true_identities import TrueLaser, identify, true_identities
from sixthsense.loop import run
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import make_estimator

LASER = TrueLaser(LaserConfig(), LaserNoise())
CORNERS = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 4.0], [0.0, 4.0]])
SCENE = true_identities(np.stack([CORNERS, np.roll(CORNERS, -1, axis=0)], axis=1))
COV = np.diag([0.004**2, 0.01**2])
POSE = Pose(2.0, 1.5, 0.0)


def room(rng, cov=COV, scale=1.0):
    """The four walls seen from POSE with errors drawn from `cov` (2, 2), times `scale`."""
    found = []
    for a, b in zip(CORNERS, np.roll(CORNERS, -1, axis=0), strict=True):
        places = a + np.linspace(0.1, 0.9, 20)[:, None] * (b - a)
        along = (b - a) / np.linalg.norm(b - a)
        normal = np.array([-along[1], along[0]])
        exact = predict_walls(POSE, np.array([[np.arctan2(normal[1], normal[0]), normal @ a]]))[0][0]
        z = exact + scale * rng.multivariate_normal(np.zeros(2), cov)
        z[0] = wrap_angle(z[0])
        off = places - POSE.position
        reach = np.sort(off @ np.array([-np.sin(exact[0]), np.cos(exact[0])]))
        bearings = np.arctan2(off[:, 1], off[:, 0])
        found.append(Observation(Kind.WALL, z, cov, (float(reach[0]), float(reach[-1])), bearings))
    return found


def pairs_of(rooms, config=None):
    """The true pairs of one associator, and an EKF that stands still, given the observations of each keyframe."""
    estimator, associator = make_estimator("ekf", POSE, np.zeros((3, 3))), Associator(config or AssociationConfig())
    observer = InnovationObserver()
    associator.observer = observer
    associations = []
    for observations in rooms:
        associations.append(associator.associate(observations, estimator))
        estimator.update(associations[-1].observations)
    truths = np.tile(POSE.array(), (len(associations), 1))
    return true_pair_nis(observer.scans, associations, truths, SCENE, LASER), associations


def test_the_nis_of_true_pairs_is_that_of_two_degrees_of_freedom():
    rng = np.random.default_rng(1)
    pairs = [pairs_of([room(rng), room(rng)])[0] for _ in range(100)]
    nis = np.concatenate([one.nis for one in pairs])
    assert len(nis) == 400
    assert nis.mean() == pytest.approx(2.0, abs=4.0 * 2.0 / np.sqrt(400))
    assert np.concatenate([one.matched for one in pairs]).mean() > 0.98


def test_errors_beyond_the_stated_covariance_show_although_the_matches_look_consistent():
    rng = np.random.default_rng(3)
    found = [pairs_of([room(rng), room(rng, scale=4.0)]) for _ in range(100)]
    nis = np.concatenate([pairs.nis for pairs, _ in found])
    of_matches = [associations[1] for _, associations in found]
    survivors = sum(a.nis for a in of_matches) / sum(a.dof for a in of_matches)
    # Innovation (16 + 1) R against 2 R.
    assert nis.mean() / 2.0 == pytest.approx(8.5, rel=0.25)
    assert survivors < 0.5 * nis.mean() / 2.0


def test_an_observed_run_is_the_same_run_and_its_true_pairs_are_consistent():
    config = merge(preset("default"), {"scene": "apartment", "task": "tour", "max_time": 15.0, "seed": 7})
    observer = InnovationObserver()
    trace = run(config, on_tick=observer.attach)
    np.testing.assert_array_equal(run(config).trajectory, trace.trajectory)
    assert trace.scene is not None
    scene = true_identities(trace.scene.walls)
    laser = TrueLaser(config.laser, config.assumed.laser)
    truths = np.array(trace.key_truths)
    pairs = true_pair_nis(observer.scans, trace.associations, truths, scene, laser)
    assert len(pairs.nis) > 100
    assert pairs.matched.mean() > 0.95
    assert 1.0 < pairs.nis.mean() < 3.0
    seen = identify(observer.scans[-1].observations, Pose.from_array(truths[-1]), scene, laser)
    assert any(one.verdict == "single" for one in seen)
