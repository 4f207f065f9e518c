"""Each filter against a plain reference with full matrices in textbook coordinates."""

import numpy as np
import pytest
from point_world import START, START_COV, driven, fed, joint_state, make, random_log
from predicted import predict_points
from scipy.linalg import block_diag, expm

from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.landmarks import initialize_landmark
from sixthsense.core.motion import compose_jacobians

J = np.array([[0.0, -1.0], [1.0, 0.0]])
SEEDS = range(5)
DENSE = np.random.default_rng(3).uniform(-5, 5, (30, 2))


def joseph(P, H, R):
    """Gain and covariance after an update (report eq. 10)."""
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    A = np.eye(len(P)) - K @ H
    return K, A @ P @ A.T + K @ R @ K.T


def standard(log):
    """EKF-SLAM, Jacobians at the newest estimate: state, covariance and ids."""
    x, P, ids = START.array(), START_COV.copy(), []
    for odometry, observations in log:
        phi, g = compose_jacobians(x[2], odometry.motion)
        F = np.eye(len(x))
        F[:3, :3] = phi
        P = F @ P @ F.T
        P[:3, :3] += g @ odometry.cov @ g.T
        x[:3] = (Pose.from_array(x[:3]) @ odometry.motion).array()
        known = [i for i in observations if i in ids]
        if known:
            H, z = [], []
            for i in known:
                at = 3 + 2 * ids.index(i)
                predicted, by_pose, by_landmark = predict_points(Pose.from_array(x[:3]), x[None, at : at + 2])
                row = np.zeros((2, len(x)))
                row[:, :3], row[:, at : at + 2] = by_pose[0], by_landmark
                H.append(row)
                z.append(observations[i].z - predicted[0])
            K, P = joseph(P, np.vstack(H), block_diag(*(observations[i].cov for i in known)))
            x = x + K @ np.concatenate(z)
        for i in [i for i in observations if i not in ids]:
            mean, by_pose, by_z = initialize_landmark(Pose.from_array(x[:3]), observations[i])
            G = np.hstack([by_pose, np.zeros((2, len(x) - 3))])
            P = np.block([[P, P @ G.T], [G @ P, G @ P @ G.T + by_z @ observations[i].cov @ by_z.T]])
            x = np.concatenate([x, mean])
            ids.append(i)
    return x, P, ids


def exponential(xi):
    """exp of xi = (x, y, theta, x_1, y_1, ...) as a matrix of SE_{1+n}(2), [[R, p, l_1, ...], [0, I]]."""
    columns = np.vstack([xi[:2], xi[3:].reshape(-1, 2)]).T  # (2, 1 + n)
    generator = np.zeros((2 + columns.shape[1],) * 2)
    generator[:2, :2], generator[:2, 2:] = xi[2] * J, columns
    return expm(generator)


def to_world(positions):
    """A, (3 + 2n, 3 + 2n): the error in world coordinates is A xi; `positions` (1 + n, 2) of robot and landmarks."""
    A = np.eye(1 + 2 * len(positions))
    A[[i for i in range(len(A)) if i != 2], 2] = (positions @ J.T).ravel()
    return A


def group(theta, positions):
    X = np.eye(2 + len(positions))
    X[:2, :2], X[:2, 2:] = rotation(theta), positions.T
    return X


def right_invariant(log):
    """EKF-SLAM whose state is a matrix and whose error is xi, X = exp(xi) X_hat: theta, positions, covariance in xi."""
    theta, positions, ids = START.theta, START.position[None], []
    A = to_world(positions)
    P = np.linalg.inv(A) @ START_COV @ np.linalg.inv(A).T
    for odometry, observations in log:
        before, motion = theta, odometry.motion
        positions[0] += rotation(theta) @ motion.position
        theta += motion.theta
        noise = np.zeros((len(P), 3))  # in the world frame, at the pose after
        noise[:3] = block_diag(rotation(before), 1.0)
        G = np.linalg.inv(to_world(positions)) @ noise  # the adjoint's columns; the error itself stays, F = I
        P = P + G @ odometry.cov @ G.T
        R = rotation(theta)
        known = [i for i in observations if i in ids]
        if known:
            H = np.zeros((2 * len(known), len(P)))  # of R z - (l - p): the same at every estimate
            for k, i in enumerate(known):
                at = 3 + 2 * ids.index(i)
                H[2 * k : 2 * k + 2, :2], H[2 * k : 2 * k + 2, at : at + 2] = -np.eye(2), np.eye(2)
            z = [R @ observations[i].z - (positions[1 + ids.index(i)] - positions[0]) for i in known]
            K, P = joseph(P, H, block_diag(*(R @ observations[i].cov @ R.T for i in known)))
            X = exponential(K @ np.concatenate(z)) @ group(theta, positions)
            theta, positions = np.arctan2(X[1, 0], X[0, 0]), X[:2, 2:].T.copy()
        for i in [i for i in observations if i not in ids]:
            R = rotation(theta)
            G = np.hstack([np.eye(2), np.zeros((2, len(P) - 2))])
            P = np.block([[P, P @ G.T], [G @ P, G @ P @ G.T + R @ observations[i].cov @ R.T]])
            positions = np.vstack([positions, positions[0] + R @ observations[i].z])
            ids.append(i)
    A = to_world(positions)
    return np.concatenate([positions[0], [theta], positions[1:].ravel()]), A @ P @ A.T, ids


REFERENCES = {"ekf": standard, "ekf-invariant": right_invariant}


@pytest.mark.parametrize("name", REFERENCES)
@pytest.mark.parametrize("seed", SEEDS)
def test_the_filter_agrees_with_a_textbook_one(name, seed):
    log = random_log(seed, DENSE)
    x, P, ids = REFERENCES[name](log)
    estimate, joint = joint_state(fed(make(name), log))
    assert estimate.ids.tolist() == ids
    assert np.allclose(estimate.pose.position, x[:2], atol=1e-9)
    assert np.allclose(estimate.pose.theta, Pose(theta=x[2]).theta, atol=1e-9)
    assert np.allclose(estimate.landmarks.ravel(), x[3:], atol=1e-9)
    assert np.allclose(joint, P, atol=1e-9)


@pytest.mark.parametrize("name", REFERENCES)
def test_forgetting_removes_rows_and_columns_and_changes_no_bit_of_the_rest(name):
    estimator = driven(name)
    before, cov = joint_state(estimator)
    estimator.forget(before.ids[[1, 3]].tolist())
    after, cov_after = joint_state(estimator)
    index = [0, 1, 2, 3, 4, 7, 8, 11, 12]
    assert np.array_equal(cov_after, cov[np.ix_(index, index)])
    assert after.pose == before.pose and np.array_equal(after.landmarks, before.landmarks[[0, 2, 4]])
