"""The laws of `link` and `unlink`, of smoothers."""

from __future__ import annotations

import math

import numpy as np
from point_world import assert_same, joint_state, make
from scipy.optimize import least_squares

from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators import Link, Smoother
from sixthsense.testing.laws import Laws, raises

LAWS = Laws()

_START_COV = np.diag([1e-6, 1e-6, 1e-6])
_MOTION = Odometry(Pose(0.8, 0.1, 0.6), np.array([[4e-4, 1e-4, 0.0], [1e-4, 2e-4, 0.0], [0.0, 0.0, 1e-4]]))


def _seen(before: int, after: int, offset: Array, cov: Array) -> Link:
    """A link of the drive of `linked` that contradicts its odometry by an offset (3,), m and rad."""
    motion = Pose()
    for _ in range(after - before):
        motion = motion @ _MOTION.motion
    return Link(before, after, Odometry(motion @ Pose.from_array(offset), cov))


_LINKS = [
    _seen(0, 3, np.array([0.02, -0.01, 0.004]), np.diag([1e-4, 2e-4, 4e-5])),
    _seen(1, 6, np.array([-0.01, 0.03, -0.006]), np.array([[3e-4, 1e-4, 0.0], [1e-4, 2e-4, 0.0], [0.0, 0.0, 5e-5]])),
]


def linked(name: str, poses: int = 8) -> Smoother:
    """An estimator after a drive without an observation."""
    estimator = make(name, Pose(0.5, -0.2, 0.3), _START_COV)
    assert isinstance(estimator, Smoother)
    for k in range(poses):
        if k:
            estimator.predict(_MOTION)
        estimator.update({})
    return estimator


@LAWS.law()
def a_link_of_no_information_changes_almost_nothing(name: str) -> None:
    estimator = linked(name)
    before = joint_state(estimator)
    estimator.link([Link(0, 5, Odometry(Pose(3.0, -2.0, 1.0), 1e6 * np.eye(3)))])
    assert_same(before, joint_state(estimator), 1e-5)


@LAWS.law()
def links_give_the_least_squares_solution(name: str) -> None:
    estimator = linked(name)
    estimator.link(_LINKS)
    solved = _least_squares(8, _LINKS)
    off = estimator.trajectory() - solved
    assert np.abs(off[:, :2]).max() < 1e-3 and np.abs(wrap_angle(off[:, 2])).max() < 5e-4


@LAWS.law()
def links_given_one_by_one_are_links_given_at_once(name: str) -> None:
    one, two = linked(name), linked(name)
    one.link(_LINKS)
    for link in _LINKS:
        two.link([link])
    assert_same(joint_state(one), joint_state(two), 1e-6)
    assert np.allclose(one.trajectory(), two.trajectory(), atol=1e-6)


@LAWS.law()
def a_link_with_a_loss_gives_way_to_the_others(name: str) -> None:
    estimator, wrong = linked(name), Odometry(Pose(9.0, 9.0, 1.0), 1e-4 * np.eye(3))
    before = estimator.trajectory()
    estimator.link([Link(1, 6, wrong, loss_scale=1.0)])
    assert np.abs(estimator.trajectory() - before).max() < 0.05


@LAWS.law()
def removed_links_leave_no_trace(name: str) -> None:
    for loss in (math.inf, 3.0):
        plain, estimator = linked(name), linked(name)
        ids = estimator.link([Link(link.before, link.after, link.relative, loss) for link in _LINKS])
        assert len(set(ids)) == len(_LINKS)
        estimator.predict(_MOTION)
        plain.predict(_MOTION)
        estimator.update({})
        plain.update({})
        more = estimator.link([Link(2, 8, Odometry(Pose(0.1, 2.4, -2.7), 1e-3 * np.eye(3)))])
        assert not set(more) & set(ids)
        estimator.unlink([*ids, *more])
        assert np.allclose(estimator.trajectory(), plain.trajectory(), atol=1e-5)
        assert_same(joint_state(estimator), joint_state(plain), 1e-5)


@LAWS.law()
def an_unknown_link_or_pose_is_a_key_error_and_changes_nothing(name: str) -> None:
    estimator = linked(name)
    ids = estimator.link(_LINKS)
    before = joint_state(estimator)
    good = Odometry(Pose(), np.eye(3))
    for unknown in ([max(ids) + 1], [ids[0], -1]):
        with raises(KeyError):
            estimator.unlink(unknown)
    for pair in ((0, 8), (-1, 2), (99, 1)):
        with raises(KeyError):
            estimator.link([Link(0, 1, good), Link(*pair, good)])
    assert_same(before, joint_state(estimator))
    estimator.unlink(ids[:1])
    with raises(KeyError):
        estimator.unlink(ids[:1])


@LAWS.law()
def an_invalid_link_is_a_value_error_and_changes_nothing(name: str) -> None:
    estimator = linked(name)
    before, pose = joint_state(estimator), Pose(1.0, 0.0, 0.0)
    skew = np.eye(3) + np.eye(3, k=1)
    for cov in (np.diag([1.0, -1.0, 1.0]), np.full((3, 3), np.nan), skew, np.eye(2)):
        with raises(ValueError, "link 1"):
            estimator.link([_LINKS[0], Link(0, 2, Odometry(pose, cov))])
    for link in (Link(3, 3, _MOTION), Link(0, 2, _MOTION, loss_scale=0.0), Link(0, 2, _MOTION, loss_scale=math.nan)):
        with raises(ValueError, "link 0"):
            estimator.link([link])
    assert_same(before, joint_state(estimator))


@LAWS.law()
def poses_at_some_updates_are_rows_of_the_trajectory(name: str) -> None:
    estimator = linked(name)
    for links in ([], _LINKS[:1], _LINKS[1:]):
        estimator.link(links)
        estimator.predict(_MOTION)
        estimator.update({})
        few = [len(estimator.trajectory()) - 1, 3, 0]
        estimator.link([Link(2, 4, Odometry(Pose(1.5, 1.2, 1.2), 0.1 * np.eye(3)))])
        found = estimator.poses_at(few)  # before the trajectory is read
        assert np.allclose(found, estimator.trajectory()[few], rtol=0.0, atol=1e-12)
        assert np.array_equal(estimator.poses_at(few), estimator.trajectory()[few])
    assert estimator.poses_at([]).shape == (0, 3)
    for unknown in (-1, len(estimator.trajectory())):
        with raises(KeyError):
            estimator.poses_at([0, unknown])


@LAWS.law()
def without_links_the_covariance_between_two_poses_is_that_of_the_motions_between_them(name: str) -> None:
    estimator, way = linked(name), _MOTION
    for after in (3, 4, 5):
        found = estimator.relative_covariances(np.array([[2, after]]))
        assert np.allclose(found[0], way.cov, rtol=1e-4, atol=1e-9)
        way = way.then(_MOTION)
    with raises(KeyError):
        estimator.relative_covariances(np.array([[2, 8]]))


@LAWS.law()
def a_pose_that_is_taken_out_loses_its_links_and_leaves_its_motion_and_its_row(name: str) -> None:
    less, whole = linked(name), linked(name)
    links = [*_LINKS, _seen(2, 4, np.array([0.01, 0.0, 0.0]), 1e-3 * np.eye(3))]
    ids = less.link(links)
    whole.link(links[1:2])
    assert sorted(less.take_out([2, 3])) == sorted([ids[0], ids[2]])
    assert_same(joint_state(whole), joint_state(less), 1e-5)
    assert less.trajectory().shape == (8, 3)
    with raises(KeyError):
        less.unlink(ids[:1])
    for wrong in ([0], [7], [2], [5, 4]):
        with raises(KeyError):
            less.take_out(wrong)


def _least_squares(poses: int, links: list[Link]) -> Array:
    """(poses, 3) solution of the drive of `linked` with `links`, by scipy."""
    terms = [Link(k, k + 1, _MOTION) for k in range(poses - 1)] + links
    start = np.array([0.5, -0.2, 0.3])
    first = [Pose.from_array(start)]
    for _ in range(poses - 1):
        first.append(first[-1] @ _MOTION.motion)

    def residuals(flat: Array) -> Array:
        rows = flat.reshape(-1, 3)
        out = [(rows[0] - start) / 1e-3]
        for term in terms:
            seen = Pose.from_array(rows[term.before]).inverse() @ Pose.from_array(rows[term.after])
            off = (term.relative.motion.inverse() @ seen).array()
            out.append(np.linalg.solve(np.linalg.cholesky(term.relative.cov), off))
        return np.concatenate(out)

    found = least_squares(residuals, np.concatenate([pose.array() for pose in first]), xtol=1e-12, ftol=1e-12)
    return np.asarray(found.x).reshape(-1, 3)
