"""The contract of every estimator; a new back end is tested by adding its name to ESTIMATORS."""

import math

import numpy as np
import pytest

from sixthsense.estimators import ESTIMATORS, make_estimator
from sixthsense.geometry import Pose, rotation, wrap_angle
from sixthsense.landmarks import Kind, Sighting, born_point, predict_points
from sixthsense.motion import Odometry, compose_jacobians

POINTS = np.array([[3.0, 1.0], [-1.0, 2.0], [2.0, -2.0], [4.0, 3.0], [-2.0, -1.0]])
START_COV = np.diag([0.02, 0.03, 0.01]) + 0.002


@pytest.fixture(params=ESTIMATORS)
def name(request):
    return request.param


def sight(pose, ids, rng=None, sigma=0.05, points=POINTS):
    """Sightings of known points from a pose; exact without a generator."""
    z, _, _ = predict_points(pose, points[list(ids)])
    noise = np.zeros_like(z) if rng is None else rng.normal(0, sigma, z.shape)
    return {i: Sighting(Kind.CORNER, z[k] + noise[k], np.eye(2) * sigma**2) for k, i in enumerate(ids)}


def step(x=0.2, theta=0.1, sigma=0.02):
    return Odometry(Pose(x, 0.0, theta), np.diag([sigma**2, sigma**2, (0.5 * sigma) ** 2]))


def driven(name, start=None, steps=8, transform=None):
    """An estimator after a short drive with sightings, the world moved by `transform`."""
    T = transform or Pose()
    start = start or Pose(0.3, -0.2, 0.4)
    turn = np.eye(3)
    turn[:2, :2] = rotation(T.theta)
    estimator = make_estimator(name, T @ start, turn @ START_COV @ turn.T)
    rng, true = np.random.default_rng(0), start
    for k in range(steps):
        estimator.predict(step())
        true = true @ step().motion
        estimator.update(sight(true, [0, 1, 2] if k % 2 else [1, 3, 4], rng))
    return estimator


def everything(estimator):
    estimate = estimator.estimate()
    return estimate, estimator.joint_covariance(estimate.ids.tolist())


def test_zero_motion_at_zero_noise_changes_nothing(name):
    estimator = driven(name)
    before, cov = everything(estimator)
    estimator.predict(Odometry(Pose(), np.zeros((3, 3))))
    after, cov_after = everything(estimator)
    assert before.pose == after.pose
    assert np.allclose(cov, cov_after, atol=1e-15) and np.allclose(before.landmarks, after.landmarks)


def test_predict_never_shrinks_the_joint_covariance(name):
    estimator = driven(name)
    for motion in (step(), step(0.0, 0.5), step(-0.3, 0.0), step(1.0, -1.0, 0.001)):
        before = np.linalg.slogdet(everything(estimator)[1])[1]
        estimator.predict(motion)
        assert np.linalg.slogdet(everything(estimator)[1])[1] >= before - 1e-9


def test_a_sighting_with_zero_innovation_moves_nothing_and_grows_no_marginal(name):
    estimator = driven(name)
    estimator.predict(step())
    before, cov = everything(estimator)
    z, _, _ = predict_points(before.pose, before.landmarks[[0, 2]])
    ids = before.ids[[0, 2]].tolist()
    estimator.update({i: Sighting(Kind.END, z[k], np.eye(2) * 1e-3) for k, i in enumerate(ids)})
    after, cov_after = everything(estimator)
    assert np.allclose(before.pose.array(), after.pose.array(), atol=1e-9)
    assert (np.diag(cov_after) <= np.diag(cov) + 1e-12).all()
    assert np.linalg.eigvalsh(cov - cov_after).min() > -1e-10  # not only the marginals: no direction gets worse


def test_a_new_landmark_appears_where_it_is_born(name):
    estimator = driven(name)
    estimator.predict(step())
    before = estimator.estimate()
    sighting = Sighting(Kind.END, np.array([1.0, 0.5]), np.array([[0.01, 0.004], [0.004, 0.02]]))
    estimator.update({77: sighting})
    after, mean = estimator.estimate(), born_point(before.pose, sighting.z)
    assert after.ids[-1] == 77 and np.allclose(after.landmarks[-1], mean[0])
    joint = estimator.joint_covariance([77])
    expected = mean[1] @ before.pose_cov @ mean[1].T + mean[2] @ sighting.cov @ mean[2].T
    assert np.allclose(joint[3:, 3:], expected) and np.allclose(joint[3:, :3], mean[1] @ before.pose_cov)


def test_an_empty_update_leaves_the_covariance_alone(name):
    estimator = driven(name)
    before, cov = everything(estimator)
    estimator.update({})
    after, cov_after = everything(estimator)
    assert np.array_equal(cov, cov_after) and before.pose == after.pose
    assert len(estimator.trajectory()) == 9


def test_the_joint_covariance_is_symmetric_positive_and_in_the_order_asked(name):
    estimator = driven(name)
    estimate, joint = everything(estimator)
    assert np.array_equal(joint, joint.T) and np.linalg.eigvalsh(joint).min() > 0.0
    assert np.array_equal(joint[:3, :3], estimate.pose_cov)
    other = estimator.joint_covariance([4, 0])
    place = {i: 3 + 2 * k for k, i in enumerate(estimate.ids.tolist())}
    index = [0, 1, 2, place[4], place[4] + 1, place[0], place[0] + 1]
    assert np.array_equal(other, joint[np.ix_(index, index)])
    assert estimator.joint_covariance([]).shape == (3, 3)
    with pytest.raises(KeyError):
        estimator.joint_covariance([99])


@pytest.mark.parametrize("transform", [Pose(0, 0, 2.5), Pose(1000.0, -300.0, 0.0), Pose(-40.0, 7.0, -1.2)])
def test_moving_the_world_moves_everything_with_it(name, transform):
    plain, cov = everything(driven(name))
    moved, cov_moved = everything(driven(name, transform=transform))
    assert np.allclose((transform @ plain.pose).position, moved.pose.position, atol=1e-8)
    assert abs(wrap_angle((transform @ plain.pose).theta - moved.pose.theta)) < 1e-9
    assert np.allclose(transform @ plain.landmarks, moved.landmarks, atol=1e-8)
    turn = np.eye(len(cov))
    for k in (0, *range(3, len(cov), 2)):
        turn[k : k + 2, k : k + 2] = rotation(transform.theta)
    assert np.allclose(turn @ cov @ turn.T, cov_moved, atol=1e-9)


def test_what_is_handed_out_is_a_copy(name):
    estimator = driven(name)
    before, cov = everything(estimator)
    for array in (before.landmarks, before.pose_cov, before.ids, estimator.trajectory(), cov):
        array[:] = 99
    after, cov_after = everything(estimator)
    assert after.landmarks.max() < 50 and cov_after.max() < 1 and after.ids.max() < 50
    assert estimator.trajectory().max() < 50


def test_integers_answer_as_floats_do(name):
    results = []
    for number in (int, float):
        estimator = make_estimator(name, Pose(number(0), number(1), number(0)), np.zeros((3, 3)).astype(number))
        estimator.predict(Odometry(Pose(number(1), number(0), number(1)), np.eye(3).astype(number)))
        estimator.update({0: Sighting(Kind.CORNER, np.array([2, 1], number), np.eye(2).astype(number))})
        estimator.update({0: Sighting(Kind.CORNER, np.array([2, 1.5]), np.eye(2))})
        results.append(everything(estimator))
    assert np.array_equal(results[0][1], results[1][1]) and results[0][0].pose == results[1][0].pose


def test_the_same_input_gives_the_same_bits(name):
    (one, cov), (two, cov_again) = everything(driven(name)), everything(driven(name))
    assert one.pose == two.pose and np.array_equal(cov, cov_again) and np.array_equal(one.landmarks, two.landmarks)


def test_forgetting_a_landmark_leaves_the_others_as_they_were(name):
    estimator = driven(name)
    before, cov = everything(estimator)
    estimator.forget([before.ids[1], before.ids[3]])
    after, cov_after = everything(estimator)
    assert after.ids.tolist() == before.ids[[0, 2, 4]].tolist()
    index = [0, 1, 2, 3, 4, 7, 8, 11, 12]
    assert np.array_equal(cov_after, cov[np.ix_(index, index)])
    assert np.array_equal(after.landmarks, before.landmarks[[0, 2, 4]])
    estimator.forget([])
    estimator.update(sight(Pose(2.0, 1.0, 1.0), [0, 3]))  # and they may be born again
    assert len(estimator.estimate().ids) == 5
    with pytest.raises(KeyError):
        estimator.forget([99])


@pytest.mark.parametrize("motion", [step(), step(0.0, 0.3), step(0.3, 0.0), Odometry(Pose(), np.zeros((3, 3)))])
def test_driving_off_from_exact_knowledge_never_fails(name, motion):
    estimator, true = make_estimator(name, Pose(), np.zeros((3, 3))), Pose()
    for _ in range(30):
        estimator.predict(motion)
        true = true @ motion.motion
        estimator.update(sight(true, range(5)))
    estimate, joint = everything(estimator)
    assert np.isfinite(joint).all() and np.linalg.eigvalsh(joint).min() > -1e-12
    assert np.allclose(estimate.pose.array()[:2], true.position, atol=1e-6)


@pytest.mark.parametrize("sigma", [1e-2, 1e-4, 1e-6])
def test_as_the_noise_goes_to_zero_the_estimate_goes_to_the_truth(name, sigma):
    rng = np.random.default_rng(1)
    estimator, true = make_estimator(name, Pose(), np.zeros((3, 3))), Pose()
    for _ in range(40):
        odometry = step(sigma=sigma)
        error = rng.multivariate_normal(np.zeros(3), odometry.cov)
        true = true @ Pose.from_array(odometry.motion.array() + error)
        estimator.predict(odometry)
        estimator.update(sight(true, range(5), rng, sigma))
    estimate = estimator.estimate()
    assert math.dist(estimate.pose.position, true.position) < 5 * sigma
    assert abs(wrap_angle(estimate.pose.theta - true.theta)) < 5 * sigma
    order = np.argsort(estimate.ids)
    assert np.abs(estimate.landmarks[order] - POINTS).max() < 5 * sigma


def test_a_known_start_must_have_a_covariance_of_the_right_shape(name):
    with pytest.raises(ValueError, match=r"expected shape \(3, 3\)"):
        make_estimator(name, Pose(), np.zeros((2, 2)))


def test_an_unknown_estimator_lists_the_known_ones():
    with pytest.raises(ValueError, match="allowed: ekf"):
        make_estimator("ukf", Pose(), np.zeros((3, 3)))


def joseph_reference(start, start_cov, log):
    """A dense EKF-SLAM that is all textbook: full matrices, one landmark order, Joseph form (report eq. 10)."""
    x, P, ids = start.array(), start_cov.copy(), []
    for odometry, sightings in log:
        phi, g = compose_jacobians(x[2], odometry.motion)
        F = np.eye(len(x))
        F[:3, :3] = phi
        P = F @ P @ F.T
        P[:3, :3] += g @ odometry.cov @ g.T
        x[:3] = (Pose.from_array(x[:3]) @ odometry.motion).array()
        known = [i for i in sightings if i in ids]
        if known:
            H, z, R = [], [], np.zeros((2 * len(known), 2 * len(known)))
            for k, i in enumerate(known):
                at = 3 + 2 * ids.index(i)
                predicted, by_pose, by_landmark = predict_points(Pose.from_array(x[:3]), x[None, at : at + 2])
                row = np.zeros((2, len(x)))
                row[:, :3], row[:, at : at + 2] = by_pose[0], by_landmark
                H.append(row)
                z.append(sightings[i].z - predicted[0])
                R[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = sightings[i].cov
            H = np.vstack(H)
            K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
            x = x + K @ np.concatenate(z)
            A = np.eye(len(x)) - K @ H
            P = A @ P @ A.T + K @ R @ K.T
        for i in sightings:
            if i not in ids:
                mean, by_pose, by_z = born_point(Pose.from_array(x[:3]), sightings[i].z)
                G = np.zeros((2, len(x)))
                G[:, :3] = by_pose
                P = np.block([[P, P @ G.T], [G @ P, G @ P @ G.T + by_z @ sightings[i].cov @ by_z.T]])
                x = np.concatenate([x, mean])
                ids.append(i)
    return x, P, ids


def test_the_ekf_agrees_with_a_textbook_filter_in_joseph_form():
    rng = np.random.default_rng(2)
    points = rng.uniform(-5, 5, (30, 2))
    estimator, true, log = make_estimator("ekf", Pose(), START_COV), Pose(), []
    for _ in range(60):
        odometry = step()
        true = true @ odometry.motion
        ids = rng.choice(30, rng.integers(0, 8), replace=False).tolist()
        log.append((odometry, sight(true, ids, rng, points=points)))
        estimator.predict(odometry)
        estimator.update(log[-1][1])
    x, P, ids = joseph_reference(Pose(), START_COV, log)
    estimate = estimator.estimate()
    assert estimate.ids.tolist() == ids
    assert np.allclose(estimate.pose.array()[:2], x[:2], atol=1e-9)
    assert np.allclose(estimate.landmarks.ravel(), x[3:], atol=1e-9)
    assert np.allclose(estimator.joint_covariance(ids), P, atol=1e-10)


def test_predicting_in_pieces_is_predicting_at_once():
    one, two = (make_estimator("ekf", Pose(), START_COV) for _ in range(2))
    folded = step()
    one.predict(step())
    for k in range(5):
        one.predict(step(0.1 * k, -0.2))
        folded = folded.then(step(0.1 * k, -0.2))
        one.estimate()
    two.predict(folded)
    assert np.allclose(one.estimate().pose_cov, two.estimate().pose_cov, atol=1e-14)
    assert np.allclose(one.estimate().pose.array(), two.estimate().pose.array())


def simulate(name, seed, steps=60, sigma=0.03):
    """One short random drive with known association: error and joint covariance at its end."""
    rng = np.random.default_rng(seed)
    estimator, true = make_estimator(name, Pose(), np.zeros((3, 3))), Pose()
    for k in range(steps):
        odometry = step(0.15, 0.05 * math.sin(0.2 * k), 0.01)
        error = rng.multivariate_normal(np.zeros(3), odometry.cov)
        true = true @ Pose.from_array(odometry.motion.array() + error)
        estimator.predict(odometry)
        estimator.update(sight(true, range(5), rng, sigma))
    estimate, joint = everything(estimator)
    error = np.concatenate([estimate.pose.array() - true.array(), (estimate.landmarks - POINTS[estimate.ids]).ravel()])
    error[2] = wrap_angle(error[2])
    return error, joint


def test_pose_and_landmarks_are_consistent_over_many_short_runs(name):
    """NEES of the pose (3) and of the whole state (13) within 4 sigma of their mean over 200 runs."""
    pose, whole = [], []
    for seed in range(200):
        error, joint = simulate(name, seed)
        pose.append(error[:3] @ np.linalg.solve(joint[:3, :3], error[:3]))
        whole.append(error @ np.linalg.solve(joint, error))
    for values, dof in ((pose, 3), (whole, 13)):
        assert abs(np.mean(values) - dof) < 4 * math.sqrt(2 * dof / 200)
