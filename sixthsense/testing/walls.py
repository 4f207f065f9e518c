"""Laws of walls; all but one are for estimators that use walls."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.testing.batch import Posterior, jacobian, to_robot, to_world
from sixthsense.testing.estimation import assert_same, family, fed, joint_state, make, sight
from sixthsense.testing.estimation import driven as driven_among_points
from sixthsense.testing.laws import Laws, raises
from sixthsense.testing.posterior import (
    BOTH,
    MOTION,
    NOISE,
    START,
    START_COV,
    WALL_COV,
    assert_agrees,
    corrected,
    drive,
    driven,
    posterior,
    reference_of,
)

LAWS = Laws()
WALLS, VALIDATION = Laws(needs_walls=True), Laws("validation", needs_walls=True)

BAD_WALLS = {
    "landmark 7: found z": ([np.nan, -2.0], [[0.01, 0.0], [0.0, 0.01]]),
    "an eigenvalue of -0.01": ([1.0, -2.0], [[0.01, 0.02], [0.02, 0.01]]),
}


def wall(z: Array, cov: Array = WALL_COV) -> Observation:
    """An observation of a wall that was seen over two metres."""
    return Observation(Kind.WALL, z, cov, (-1.0, 1.0))


@LAWS.law
def a_scan_with_a_wall_is_used_or_refused_as_a_whole(name: str) -> None:
    """An estimator without walls raises NotImplementedError and leaves its state unchanged."""
    estimator = driven_among_points(name)
    before, rows = joint_state(estimator), estimator.trajectory()
    scan = sight(Pose(1.0, 1.0, 1.0), [0, 2], np.random.default_rng(5)) | {9: wall(np.array([1.0, -3.0]))}
    try:
        estimator.update(scan)
    except NotImplementedError:
        assert_same(before, joint_state(estimator))
        assert np.array_equal(rows, estimator.trajectory())
    else:
        assert estimator.estimate().ids.tolist() == [*before[0].ids.tolist(), 9]


@WALLS.law
def a_new_wall_is_initialized_from_its_observation(name: str) -> None:
    estimator = driven(name, BOTH)
    estimator.predict(MOTION)
    before, cov = posterior(estimator)
    observation = wall(np.array([2.9, -1.5]))
    estimator.update({77: observation})
    after, joint = posterior(estimator)
    mean = to_world(before[:3], observation.z, True)
    by_both = jacobian(lambda x: to_world(x[:3], x[3:], True), np.append(before[:3], observation.z))
    G = np.hstack([by_both[:, :3], np.zeros((2, len(before) - 3))])
    own = G @ cov @ G.T + by_both[:, 3:] @ observation.cov @ by_both[:, 3:].T
    expected = np.block([[cov, cov @ G.T], [G @ cov, own]])
    angles = np.append(reference_of(driven(name, BOTH)).angles, [True, False])
    ids = [*estimator.estimate().ids.tolist()[:-1], 77]
    assert_agrees(estimator, Posterior(ids, np.append(before, mean), expected, angles))
    assert abs(wrap_angle(float(after[-2] - mean[0]))) < 1e-9 and abs(after[-1] - mean[1]) < 1e-8
    scale = np.sqrt(np.diag(expected))
    assert np.abs((joint - expected) / np.outer(scale, scale)).max() < 1e-4


@WALLS.law
def a_wall_is_returned_as_a_wall(name: str) -> None:
    estimate = driven(name, BOTH).estimate()
    expected = [BOTH.kinds[i] == Kind.WALL for i in estimate.ids]
    assert estimate.walls.dtype == np.bool_ and estimate.walls.tolist() == expected
    alpha = estimate.landmarks[estimate.walls, 0]
    assert (alpha >= -math.pi).all() and (alpha < math.pi).all()


@WALLS.law
def an_observation_of_a_wall_with_zero_innovation_moves_nothing_and_grows_no_marginal(name: str) -> None:
    estimator = driven(name, BOTH)
    estimator.predict(MOTION)
    before, cov = posterior(estimator)
    landmarks = before[3:].reshape(-1, 2)
    ids, walls = estimator.estimate().ids.tolist(), estimator.estimate().walls
    seen = [k for k in range(len(ids)) if walls[k]]
    estimator.update({ids[k]: wall(to_robot(before[:3], landmarks[k], True)) for k in seen})
    after, cov_after = posterior(estimator)
    assert np.abs(after - before).max() < 1e-6 * NOISE + 1e-9
    scale = np.sqrt(np.diag(cov))
    shrunk = (cov - cov_after) / np.outer(scale, scale)
    assert np.linalg.eigvalsh(0.5 * (shrunk + shrunk.T)).min() > -1e-4


@WALLS.law
def the_innovation_of_a_wall_is_wrapped(name: str) -> None:
    """The predicted angle and the observation's are on the two sides of a half turn."""
    estimator = make(name, Pose(), START_COV)
    near = math.pi - 0.1 * NOISE
    estimator.update({3: wall(np.array([near, -2.0]))})
    prior = reference_of(estimator)
    observations = {3: wall(np.array([-near, -2.0]))}
    estimator.update(observations)
    assert_agrees(estimator, corrected(prior, observations))


@WALLS.law_for([Pose(0.0, 0.0, 2.5), Pose(-8.0, 5.0, -1.2)])
def moving_the_world_moves_walls_with_it(name: str, transform: Pose) -> None:
    log = drive(BOTH, 6)[0]
    plain = reference_of(driven(name, BOTH))
    turn = np.eye(3)
    turn[:2, :2] = rotation(transform.theta)
    moved = fed(make(name, transform @ START, turn @ START_COV @ turn.T), log)
    T, mean = np.eye(len(plain.mean)), plain.mean.copy()
    T[:3, :3], mean[:3] = turn, (transform @ Pose.from_array(mean[:3])).array()
    for k, i in enumerate(plain.ids):
        at = slice(3 + 2 * k, 5 + 2 * k)
        if BOTH.kinds[i] == Kind.WALL:
            alpha = float(wrap_angle(plain.mean[at][0] + transform.theta))
            normal = np.array([math.cos(alpha), math.sin(alpha)])
            mean[at] = [alpha, plain.mean[at][1] + normal @ transform.position]
            T[4 + 2 * k, 3 + 2 * k] = np.array([-normal[1], normal[0]]) @ transform.position
        else:
            mean[at], T[at, at] = transform @ plain.mean[at], rotation(transform.theta)
    assert_agrees(moved, Posterior(plain.ids, mean, T @ plain.cov @ T.T, plain.angles))


@WALLS.law
def the_joint_covariance_of_points_and_walls_is_in_the_requested_order(name: str) -> None:
    estimator = driven(name, BOTH)
    estimate, joint = joint_state(estimator)
    assert np.array_equal(joint, joint.T) and np.linalg.eigvalsh(joint).min() > 0.0
    assert np.array_equal(joint[:3, :3], estimate.pose_cov)
    place = {i: 3 + 2 * k for k, i in enumerate(estimate.ids.tolist())}
    for ids in ([3, 0], [1, 2], [2]):
        index = [0, 1, 2, *(place[i] + n for i in ids for n in (0, 1))]
        gap = np.abs(estimator.joint_covariance(ids) - joint[np.ix_(index, index)]).max()
        assert gap <= max(family(name).rounding, 1e-12) * np.abs(joint).max()


@WALLS.law
def forgetting_a_wall_leaves_the_others_unchanged(name: str) -> None:
    """A smoother also removes the observations of the forgotten wall."""
    estimator = driven(name, BOTH)
    before = reference_of(estimator)
    estimator.forget([3])
    assert estimator.estimate().walls.tolist() == [False, False, True]
    if family(name).forgets_evidence:
        log = [(odometry, {i: s for i, s in scan.items() if i != 3}) for odometry, scan in drive(BOTH, 6)[0]]
        assert_agrees(estimator, reference_of(fed(make(name, START, START_COV), log)))
        return
    k = before.ids.index(3)
    index = np.delete(np.arange(len(before.mean)), [3 + 2 * k, 4 + 2 * k])
    left = [i for i in before.ids if i != 3]
    cov = before.cov[np.ix_(index, index)]
    assert_agrees(estimator, Posterior(left, before.mean[index], cov, before.angles[index]))


@VALIDATION.law_for(BAD_WALLS)
def an_invalid_observation_of_a_wall_is_named_and_changes_nothing(name: str, fault: str) -> None:
    estimator = driven(name, BOTH)
    before = joint_state(estimator)
    z, cov = BAD_WALLS[fault]
    with raises(ValueError, fault):
        estimator.update({7: wall(np.array(z), np.array(cov))})
    assert_same(before, joint_state(estimator))
