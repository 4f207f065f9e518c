"""The laws of the contract of `Estimator`, which `slam/estimators/base.py` specifies."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.testing.estimation import (
    assert_same,
    driven,
    exact,
    expected_new_landmark,
    family,
    joint_state,
    make,
    rotated_covariance,
    sight,
    step,
)
from sixthsense.testing.laws import Laws, raises
from sixthsense.testing.sight import predict_points

LAWS = Laws()


@LAWS.law
def zero_motion_at_zero_noise_changes_nothing(name: str) -> None:
    estimator = driven(name)
    before = joint_state(estimator)
    estimator.predict(Odometry(Pose(), np.zeros((3, 3))))
    assert_same(before, joint_state(estimator))


@LAWS.law
def zero_motion_at_zero_noise_before_a_scan_is_the_same_as_none(name: str) -> None:
    one, two = driven(name), driven(name)
    one.predict(Odometry(Pose(), np.zeros((3, 3))))
    for estimator in (one, two):
        estimator.update(sight(Pose(1.0, 1.0, 1.0), [0, 2, 4], np.random.default_rng(5)))
    assert_same(joint_state(one), joint_state(two))


@LAWS.law
def predict_never_shrinks_the_joint_covariance(name: str) -> None:
    estimator = driven(name)
    for motion in (step(), step(0.0, 0.5), step(-0.3, 0.0), step(1.0, -1.0, 0.001), step(2.0, 1.0, 0.0)):
        before = np.linalg.slogdet(joint_state(estimator)[1])[1]
        estimator.predict(motion)
        assert np.linalg.slogdet(joint_state(estimator)[1])[1] >= before - 1e-9


@LAWS.law
def predicting_in_pieces_is_predicting_at_once(name: str) -> None:
    queried, pieces, once = (driven(name) for _ in range(3))
    folded = step()
    for estimator in (queried, pieces):
        estimator.predict(step())
    for k in range(5):
        part = step(0.1 * k, -0.2)
        folded = folded.then(part)
        pieces.predict(part)
        queried.predict(part)
        queried.estimate()
    once.predict(folded)
    for after in ({}, sight(Pose(1.0, 1.0, 1.0), [0, 2, 4], np.random.default_rng(5))):
        for estimator in (queried, pieces):
            assert_same(joint_state(estimator), joint_state(once), 1e-12)
        for estimator in (queried, pieces, once):
            estimator.update(after)
    for estimator in (queried, pieces):
        assert_same(joint_state(estimator), joint_state(once), 1e-9)
    assert np.allclose(queried.trajectory(), once.trajectory(), atol=1e-9)


@LAWS.law
def an_observation_with_zero_innovation_moves_nothing_and_grows_no_marginal(name: str) -> None:
    estimator = driven(name)
    estimator.predict(step())
    before, cov = joint_state(estimator)
    z, _, _ = predict_points(before.pose, before.landmarks[[0, 2]])
    ids = before.ids[[0, 2]].tolist()
    estimator.update({i: exact(name, z[k], np.eye(2) * 1e-3) for k, i in enumerate(ids)})
    after, cov_after = joint_state(estimator)
    assert np.allclose(before.pose.array(), after.pose.array(), atol=1e-9)
    assert np.allclose(before.landmarks, after.landmarks, atol=1e-9)
    assert (np.diag(cov_after) <= np.diag(cov) + 1e-12).all()
    assert np.linalg.eigvalsh(cov - cov_after).min() > -1e-10  # in every direction, not only the marginals


@LAWS.law
def a_new_landmark_is_initialized_from_its_observation(name: str) -> None:
    estimator = driven(name)
    estimator.predict(step())
    before, cov = joint_state(estimator)
    observation = Observation(Kind.END, np.array([1.0, 0.5]), np.array([[0.01, 0.004], [0.004, 0.02]]))
    estimator.update({77: observation})
    after, joint = joint_state(estimator)
    mean, own, with_pose = expected_new_landmark(name, before, observation)
    assert after.ids[-1] == 77 and np.allclose(after.landmarks[-1], mean, atol=1e-9)
    assert np.allclose(joint[-2:, -2:], own, atol=1e-9) and np.allclose(joint[-2:, :3], with_pose, atol=1e-9)
    # The first observation of a landmark changes nothing else.
    assert np.allclose(joint[:-2, :-2], cov, atol=1e-9) and np.allclose(after.landmarks[:-1], before.landmarks)


@LAWS.law
def known_landmarks_of_a_scan_update_before_new_ones_are_initialized(name: str) -> None:
    one, two = driven(name), driven(name)
    observations = sight(Pose(1.0, 1.0, 1.0), [0, 2], np.random.default_rng(5))
    new = {77: Observation(Kind.END, np.array([1.0, 0.5]), np.eye(2) * 0.01)}
    one.update(new | observations)
    two.update(observations)
    two.update(new)
    # With a motion noise of a micrometre, a Cholesky factorisation keeps about five digits of a covariance.
    assert_same(joint_state(one), joint_state(two), max(1e-7, family(name).step_rounding))


@LAWS.law
def an_empty_update_leaves_the_covariance_alone(name: str) -> None:
    estimator = driven(name)
    before = joint_state(estimator)
    estimator.update({})
    assert_same(before, joint_state(estimator), family(name).still)
    assert len(estimator.trajectory()) == 9


@LAWS.law
def the_joint_covariance_is_symmetric_positive_definite_and_in_the_requested_order(name: str) -> None:
    estimator = driven(name)
    estimate, joint = joint_state(estimator)
    assert np.array_equal(joint, joint.T) and np.linalg.eigvalsh(joint).min() > 0.0
    assert np.array_equal(joint[:3, :3], estimate.pose_cov)
    other = estimator.joint_covariance([4, 0])
    place = {i: 3 + 2 * k for k, i in enumerate(estimate.ids.tolist())}
    index = [0, 1, 2, place[4], place[4] + 1, place[0], place[0] + 1]
    slack = family(name).rounding * np.abs(joint).max()
    assert np.abs(other - joint[np.ix_(index, index)]).max() <= slack
    assert np.array_equal(estimator.joint_covariance([]), estimate.pose_cov)
    with raises(KeyError):
        estimator.joint_covariance([99])


@LAWS.law_for([Pose(0, 0, 2.5), Pose(1000.0, -300.0, 0.0), Pose(-40.0, 7.0, -1.2)])
def moving_the_world_moves_everything_with_it(name: str, transform: Pose) -> None:
    plain, cov = joint_state(driven(name))
    estimator = driven(name, transform=transform)
    moved, cov_moved = joint_state(estimator)
    assert np.allclose((transform @ plain.pose).position, moved.pose.position, atol=1e-8)
    assert abs(wrap_angle((transform @ plain.pose).theta - moved.pose.theta)) < 1e-9
    assert np.allclose(transform @ plain.landmarks, moved.landmarks, atol=1e-8)
    assert np.allclose(rotated_covariance(transform.theta, cov), cov_moved, atol=1e-9)
    rows = [(transform @ Pose.from_array(row)).array() for row in driven(name).trajectory()]
    difference = np.array(rows) - estimator.trajectory()
    assert np.abs(difference[:, :2]).max() < 1e-8 and np.abs(wrap_angle(difference[:, 2])).max() < 1e-9


@LAWS.law
def returned_arrays_are_copies(name: str) -> None:
    estimator = driven(name)
    for pending in (False, True):
        if pending:
            estimator.predict(step())
        before, cov = joint_state(estimator)
        alone = estimator.joint_covariance([])
        for array in (before.landmarks, before.pose_cov, before.ids, estimator.trajectory(), cov, alone):
            array[:] = 99
        after, cov_after = joint_state(estimator)
        assert after.landmarks.max() < 50 and cov_after.max() < 1 and after.ids.max() < 50
        assert estimator.trajectory().max() < 50


@LAWS.law
def arguments_may_change_after_the_call(name: str) -> None:
    one, two = driven(name), driven(name)
    one.predict(step())
    one.update(sight(Pose(1.0, 1.0, 1.0), [0, 2], np.random.default_rng(5)))
    motion, seen = step(), sight(Pose(1.0, 1.0, 1.0), [0, 2], np.random.default_rng(5))
    two.predict(motion)
    motion.cov[:] = 7.0
    two.update(seen)
    for observation in seen.values():
        observation.z[:], observation.cov[:] = 9.0, 9.0
    assert_same(joint_state(one), joint_state(two))


@LAWS.law
def integers_give_the_same_result_as_floats(name: str) -> None:
    results = []
    for number in (int, float):
        estimator = make(name, Pose(number(0), number(1), number(0)), np.zeros((3, 3)).astype(number))
        estimator.predict(Odometry(Pose(number(1), number(0), number(1)), np.eye(3).astype(number)))
        estimator.update({0: Observation(Kind.CORNER, np.array([2, 1], number), np.eye(2).astype(number))})
        estimator.update({0: Observation(Kind.CORNER, np.array([2, 1.5]), np.eye(2))})
        results.append(joint_state(estimator))
    assert_same(results[0], results[1])


@LAWS.law
def the_same_input_gives_the_same_bits(name: str) -> None:
    one, two = driven(name), driven(name)
    assert_same(joint_state(one), joint_state(two))
    assert np.array_equal(one.trajectory(), two.trajectory())


@LAWS.law
def forgetting_a_landmark_leaves_the_others_unchanged(name: str) -> None:
    """A smoother also removes the observations of the forgotten landmarks."""
    estimator = driven(name)
    before, cov = joint_state(estimator)
    forgotten = before.ids[[1, 3]].tolist()
    estimator.forget(forgotten)
    after, cov_after = joint_state(estimator)
    assert after.ids.tolist() == before.ids[[0, 2, 4]].tolist()
    if family(name).forgets_evidence:
        assert_same((after, cov_after), joint_state(driven(name, unseen=forgotten)), 1e-7)
    else:
        index = [0, 1, 2, 3, 4, 7, 8, 11, 12]
        # An information filter marginalises, with rounding errors.
        assert np.allclose(cov_after, cov[np.ix_(index, index)], rtol=0.0, atol=1e-12)
        assert np.allclose(after.pose.array(), before.pose.array(), rtol=0.0, atol=1e-9)
        assert np.allclose(after.landmarks, before.landmarks[[0, 2, 4]], rtol=0.0, atol=1e-9)
    assert len(estimator.trajectory()) == 8
    estimator.update(sight(Pose(2.0, 1.0, 1.0), [0, 3], np.random.default_rng(0)))  # they may be added again
    assert len(estimator.estimate().ids) == 5


@LAWS.law
def forgetting_no_landmark_changes_nothing(name: str) -> None:
    estimator = driven(name)
    before = joint_state(estimator)
    estimator.forget([])
    assert_same(before, joint_state(estimator))


@LAWS.law
def forgetting_all_landmarks_leaves_the_pose(name: str) -> None:
    estimator = driven(name)
    pose_cov = estimator.estimate().pose_cov
    estimator.forget(range(5))
    estimate, joint = joint_state(estimator)
    assert estimate.ids.size == 0 and estimate.landmarks.shape == (0, 2) and joint.shape == (3, 3)
    assert np.linalg.eigvalsh(joint - pose_cov).min() > -1e-12
    for k in range(3):
        estimator.predict(step())
        estimator.update(sight(Pose(2.0 + k, 1.0, 1.0), [0, 3], np.random.default_rng(k)))
    assert np.isfinite(joint_state(estimator)[1]).all()


@LAWS.law
def a_forgotten_landmark_seen_again_is_new(name: str) -> None:
    """Its position and covariance depend only on the new observation, even far from the old position."""
    estimator = driven(name)
    estimator.forget([1])
    before = estimator.estimate()
    observation = Observation(Kind.END, np.array([-4.0, 2.5]), np.eye(2) * 0.01)
    estimator.update({1: observation})
    mean, own, with_pose = expected_new_landmark(name, before, observation)
    after, joint = estimator.estimate(), estimator.joint_covariance([1])
    assert after.ids[-1] == 1 and np.allclose(after.landmarks[-1], mean, atol=1e-8)
    slack = family(name).step_rounding  # the same rounding as above
    assert np.allclose(joint[3:, 3:], own, atol=slack) and np.allclose(joint[3:, :3], with_pose, atol=slack)
    assert np.allclose(after.pose.array(), before.pose.array(), atol=1e-8)


@LAWS.law
def forgetting_an_unknown_landmark_is_a_key_error_and_changes_nothing(name: str) -> None:
    estimator = driven(name)
    estimator.forget([1])
    before = joint_state(estimator)
    for ids in ([1], [99], [0, 1], [0, 99, 4]):
        with raises(KeyError):
            estimator.forget(ids)
        assert_same(before, joint_state(estimator))
