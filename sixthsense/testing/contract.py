"""The contract of every estimator, a law each; `estimators/base.py` states it."""

from __future__ import annotations

import numpy as np

from sixthsense.core.geometry import Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Sighting, predict_points
from sixthsense.core.motion import Odometry
from sixthsense.testing.estimation import (
    assert_same,
    driven,
    everything,
    exact,
    expected_birth,
    family,
    make,
    sight,
    step,
    turned_pose_cov,
)
from sixthsense.testing.laws import Laws, refused

LAWS = Laws()


@LAWS.law
def zero_motion_at_zero_noise_changes_nothing(name: str) -> None:
    estimator = driven(name)
    before = everything(estimator)
    estimator.predict(Odometry(Pose(), np.zeros((3, 3))))
    assert_same(before, everything(estimator))


@LAWS.law
def zero_motion_at_zero_noise_before_a_scan_is_as_none(name: str) -> None:
    one, two = driven(name), driven(name)
    one.predict(Odometry(Pose(), np.zeros((3, 3))))
    for estimator in (one, two):
        estimator.update(sight(Pose(1.0, 1.0, 1.0), [0, 2, 4], np.random.default_rng(5)))
    assert_same(everything(one), everything(two))


@LAWS.law
def predict_never_shrinks_the_joint_covariance(name: str) -> None:
    estimator = driven(name)
    for motion in (step(), step(0.0, 0.5), step(-0.3, 0.0), step(1.0, -1.0, 0.001), step(2.0, 1.0, 0.0)):
        before = np.linalg.slogdet(everything(estimator)[1])[1]
        estimator.predict(motion)
        assert np.linalg.slogdet(everything(estimator)[1])[1] >= before - 1e-9


@LAWS.law
def predicting_in_pieces_is_predicting_at_once(name: str) -> None:
    asked, pieces, once = (driven(name) for _ in range(3))
    folded = step()
    for estimator in (asked, pieces):
        estimator.predict(step())
    for k in range(5):
        part = step(0.1 * k, -0.2)
        folded = folded.then(part)
        pieces.predict(part)
        asked.predict(part)
        asked.estimate()
    once.predict(folded)
    for after in ({}, sight(Pose(1.0, 1.0, 1.0), [0, 2, 4], np.random.default_rng(5))):
        for estimator in (asked, pieces):
            assert_same(everything(estimator), everything(once), 1e-12)
        for estimator in (asked, pieces, once):
            estimator.update(after)
    for estimator in (asked, pieces):
        assert_same(everything(estimator), everything(once), 1e-9)
    assert np.allclose(asked.trajectory(), once.trajectory(), atol=1e-9)


@LAWS.law
def a_sighting_with_zero_innovation_moves_nothing_and_grows_no_marginal(name: str) -> None:
    estimator = driven(name)
    estimator.predict(step())
    before, cov = everything(estimator)
    z, _, _ = predict_points(before.pose, before.landmarks[[0, 2]])
    ids = before.ids[[0, 2]].tolist()
    estimator.update({i: exact(name, z[k], np.eye(2) * 1e-3) for k, i in enumerate(ids)})
    after, cov_after = everything(estimator)
    assert np.allclose(before.pose.array(), after.pose.array(), atol=1e-9)
    assert np.allclose(before.landmarks, after.landmarks, atol=1e-9)
    assert (np.diag(cov_after) <= np.diag(cov) + 1e-12).all()
    assert np.linalg.eigvalsh(cov - cov_after).min() > -1e-10  # not only the marginals: no direction gets worse


@LAWS.law
def a_new_landmark_appears_where_it_is_born(name: str) -> None:
    estimator = driven(name)
    estimator.predict(step())
    before, cov = everything(estimator)
    sighting = Sighting(Kind.END, np.array([1.0, 0.5]), np.array([[0.01, 0.004], [0.004, 0.02]]))
    estimator.update({77: sighting})
    after, joint = everything(estimator)
    mean, own, with_pose = expected_birth(name, before, sighting)
    assert after.ids[-1] == 77 and np.allclose(after.landmarks[-1], mean, atol=1e-9)
    assert np.allclose(joint[-2:, -2:], own, atol=1e-9) and np.allclose(joint[-2:, :3], with_pose, atol=1e-9)
    # It tells nothing of all that was there before.
    assert np.allclose(joint[:-2, :-2], cov, atol=1e-9) and np.allclose(after.landmarks[:-1], before.landmarks)


@LAWS.law
def new_and_known_landmarks_in_one_scan_update_first_and_are_born_then(name: str) -> None:
    one, two = driven(name), driven(name)
    sightings = sight(Pose(1.0, 1.0, 1.0), [0, 2], np.random.default_rng(5))
    new = {77: Sighting(Kind.END, np.array([1.0, 0.5]), np.eye(2) * 0.01)}
    one.update(new | sightings)
    two.update(sightings)
    two.update(new)
    # Beside a motion of a micrometre Cholesky's method keeps some five digits of a covariance.
    assert_same(everything(one), everything(two), max(1e-7, family(name).step_rounding))


@LAWS.law
def an_empty_update_leaves_the_covariance_alone(name: str) -> None:
    estimator = driven(name)
    before = everything(estimator)
    estimator.update({})
    assert_same(before, everything(estimator))
    assert len(estimator.trajectory()) == 9


@LAWS.law
def the_joint_covariance_is_symmetric_positive_and_in_the_order_asked(name: str) -> None:
    estimator = driven(name)
    estimate, joint = everything(estimator)
    assert np.array_equal(joint, joint.T) and np.linalg.eigvalsh(joint).min() > 0.0
    assert np.array_equal(joint[:3, :3], estimate.pose_cov)
    other = estimator.joint_covariance([4, 0])
    place = {i: 3 + 2 * k for k, i in enumerate(estimate.ids.tolist())}
    index = [0, 1, 2, place[4], place[4] + 1, place[0], place[0] + 1]
    slack = family(name).rounding * np.abs(joint).max()
    assert np.abs(other - joint[np.ix_(index, index)]).max() <= slack
    assert np.array_equal(estimator.joint_covariance([]), estimate.pose_cov)
    with refused(KeyError):
        estimator.joint_covariance([99])


@LAWS.law_for([Pose(0, 0, 2.5), Pose(1000.0, -300.0, 0.0), Pose(-40.0, 7.0, -1.2)])
def moving_the_world_moves_everything_with_it(name: str, transform: Pose) -> None:
    plain, cov = everything(driven(name))
    estimator = driven(name, transform=transform)
    moved, cov_moved = everything(estimator)
    assert np.allclose((transform @ plain.pose).position, moved.pose.position, atol=1e-8)
    assert abs(wrap_angle((transform @ plain.pose).theta - moved.pose.theta)) < 1e-9
    assert np.allclose(transform @ plain.landmarks, moved.landmarks, atol=1e-8)
    assert np.allclose(turned_pose_cov(transform.theta, cov), cov_moved, atol=1e-9)
    rows = [(transform @ Pose.from_array(row)).array() for row in driven(name).trajectory()]
    difference = np.array(rows) - estimator.trajectory()
    assert np.abs(difference[:, :2]).max() < 1e-8 and np.abs(wrap_angle(difference[:, 2])).max() < 1e-9


@LAWS.law
def what_is_handed_out_is_a_copy(name: str) -> None:
    estimator = driven(name)
    for pending in (False, True):
        if pending:
            estimator.predict(step())
        before, cov = everything(estimator)
        alone = estimator.joint_covariance([])
        for array in (before.landmarks, before.pose_cov, before.ids, estimator.trajectory(), cov, alone):
            array[:] = 99
        after, cov_after = everything(estimator)
        assert after.landmarks.max() < 50 and cov_after.max() < 1 and after.ids.max() < 50
        assert estimator.trajectory().max() < 50


@LAWS.law
def what_is_handed_in_may_change_afterwards(name: str) -> None:
    one, two = driven(name), driven(name)
    motion, seen = step(), sight(Pose(1.0, 1.0, 1.0), [0, 2], np.random.default_rng(5))
    for estimator in (one, two):
        estimator.predict(motion)
        if estimator is two:
            motion.cov[:] = 7.0
    one.update(seen)
    two.update(seen)
    for sighting in seen.values():
        sighting.z[:], sighting.cov[:] = 9.0, 9.0
    assert_same(everything(one), everything(two))


@LAWS.law
def integers_answer_as_floats_do(name: str) -> None:
    results = []
    for number in (int, float):
        estimator = make(name, Pose(number(0), number(1), number(0)), np.zeros((3, 3)).astype(number))
        estimator.predict(Odometry(Pose(number(1), number(0), number(1)), np.eye(3).astype(number)))
        estimator.update({0: Sighting(Kind.CORNER, np.array([2, 1], number), np.eye(2).astype(number))})
        estimator.update({0: Sighting(Kind.CORNER, np.array([2, 1.5]), np.eye(2))})
        results.append(everything(estimator))
    assert_same(results[0], results[1])


@LAWS.law
def the_same_input_gives_the_same_bits(name: str) -> None:
    one, two = driven(name), driven(name)
    assert_same(everything(one), everything(two))
    assert np.array_equal(one.trajectory(), two.trajectory())


@LAWS.law
def forgetting_a_landmark_leaves_the_others_as_they_were(name: str) -> None:
    """A smoother also takes their evidence back, as if they had never been seen."""
    estimator = driven(name)
    before, cov = everything(estimator)
    forgotten = before.ids[[1, 3]].tolist()
    estimator.forget(forgotten)
    after, cov_after = everything(estimator)
    assert after.ids.tolist() == before.ids[[0, 2, 4]].tolist()
    if family(name).takes_back:
        assert_same((after, cov_after), everything(driven(name, unseen=forgotten)), 1e-7)
    else:
        index = [0, 1, 2, 3, 4, 7, 8, 11, 12]
        # An information filter marginalises, and rounds.
        assert np.allclose(cov_after, cov[np.ix_(index, index)], rtol=0.0, atol=1e-12)
        assert np.allclose(after.pose.array(), before.pose.array(), rtol=0.0, atol=1e-9)
        assert np.allclose(after.landmarks, before.landmarks[[0, 2, 4]], rtol=0.0, atol=1e-9)
    assert len(estimator.trajectory()) == 8
    estimator.update(sight(Pose(2.0, 1.0, 1.0), [0, 3], np.random.default_rng(0)))  # and they may be born again
    assert len(estimator.estimate().ids) == 5


@LAWS.law
def forgetting_none_changes_nothing(name: str) -> None:
    estimator = driven(name)
    before = everything(estimator)
    estimator.forget([])
    assert_same(before, everything(estimator))


@LAWS.law
def forgetting_all_leaves_the_pose(name: str) -> None:
    estimator = driven(name)
    pose_cov = estimator.estimate().pose_cov
    estimator.forget(range(5))
    estimate, joint = everything(estimator)
    assert estimate.ids.size == 0 and estimate.landmarks.shape == (0, 2) and joint.shape == (3, 3)
    assert np.linalg.eigvalsh(joint - pose_cov).min() > -1e-12
    for k in range(3):
        estimator.predict(step())
        estimator.update(sight(Pose(2.0 + k, 1.0, 1.0), [0, 3], np.random.default_rng(k)))
    assert np.isfinite(everything(estimator)[1]).all()


@LAWS.law
def a_forgotten_landmark_seen_again_is_a_new_one(name: str) -> None:
    """Its place and its covariance come from the new sighting alone, however far off that is."""
    estimator = driven(name)
    estimator.forget([1])
    before = estimator.estimate()
    sighting = Sighting(Kind.END, np.array([-4.0, 2.5]), np.eye(2) * 0.01)
    estimator.update({1: sighting})
    mean, own, with_pose = expected_birth(name, before, sighting)
    after, joint = estimator.estimate(), estimator.joint_covariance([1])
    assert after.ids[-1] == 1 and np.allclose(after.landmarks[-1], mean, atol=1e-8)
    slack = family(name).step_rounding  # as above
    assert np.allclose(joint[3:, 3:], own, atol=slack) and np.allclose(joint[3:, :3], with_pose, atol=slack)
    assert np.allclose(after.pose.array(), before.pose.array(), atol=1e-8)


@LAWS.law
def forgetting_what_is_not_known_is_a_key_error_and_changes_nothing(name: str) -> None:
    estimator = driven(name)
    estimator.forget([1])
    before = everything(estimator)
    for ids in ([1], [99], [0, 1], [0, 99, 4]):
        with refused(KeyError):
            estimator.forget(ids)
        assert_same(before, everything(estimator))
