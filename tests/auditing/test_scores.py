"""Coverage, log scores and errors of trajectories: against closed forms, scipy and evo."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

import sixthsense as ss

N = 1500
STAMPS = 0.1 * np.arange(N) + 3.0
COV = np.array([[64.0, 8.0, 0.0], [8.0, 9.0, 1.0], [0.0, 1.0, 1.0]]) * 1e-4


def planar(times=1.0, seed=0):
    rng = np.random.default_rng(seed)
    heading = 0.05 * STAMPS + 0.4
    truth = np.column_stack([8.0 * np.sin(heading), 3.0 - 8.0 * np.cos(heading), heading])
    error = times * rng.multivariate_normal(np.zeros(3), COV, N)
    return truth, error


def audited(truth, error, cov=COV, **options):
    return ss.audit((STAMPS, truth + error, np.broadcast_to(cov, (N, *cov.shape))), (STAMPS, truth), **options)


def test_the_log_score_is_the_mean_of_the_stated_density_and_the_factor_makes_it_least():
    truth, error = planar(1.6, seed=3)
    found = audited(truth, error)
    wrapped = np.column_stack([error[:, :2], (error[:, 2] + np.pi) % (2.0 * np.pi) - np.pi])

    def by_scipy(scale):
        return -multivariate_normal(np.zeros(3), scale * COV).logpdf(wrapped).mean()

    score = found.findings.score
    assert score.log_score == pytest.approx(by_scipy(1.0), abs=1e-6)
    assert score.scaled_log_score == pytest.approx(min(map(by_scipy, np.geomspace(1.0, 5.0, 400))), abs=1e-3)


def in_space(seed=1):
    rng = np.random.default_rng(seed)
    t = 0.05 * np.arange(N)
    positions = np.column_stack([5.0 * np.sin(0.3 * t), 4.0 * np.cos(0.2 * t), 1.0 + 0.3 * np.sin(0.7 * t)])
    turns = Rotation.from_euler("zyx", np.column_stack([0.3 * t, 0.2 * np.sin(t), 0.1 * np.cos(0.4 * t)]))
    off = Rotation.from_rotvec(rng.normal(0.0, 0.01, (N, 3)))
    frame = Rotation.from_euler("zyx", [0.8, -0.3, 0.2])
    found = np.array([7.0, -3.0, 0.6]) + frame.apply(positions + rng.normal(0.0, 0.03, (N, 3)))
    truth = np.column_stack([positions, turns.as_quat()])
    return truth, np.column_stack([found, (frame * off * turns).as_quat()])


def of_plane():
    truth, error = planar(seed=5)
    found = np.array([(ss.Pose(7.0, -3.0, 0.8) @ ss.Pose(*pose)).array() for pose in truth + error])
    return truth, found


def tum(poses):
    if poses.shape[1] == 7:
        return poses
    half, zero = 0.5 * poses[:, 2], np.zeros(len(poses))
    return np.column_stack([poses[:, :2], zero, zero, zero, np.sin(half), np.cos(half)])


@pytest.mark.parametrize("poses", [in_space, of_plane])
def test_errors_of_trajectories_are_those_of_evo(poses):
    from evo.core import metrics
    from evo.core.trajectory import PoseTrajectory3D

    truth, found = poses()
    size = 6 if truth.shape[1] == 7 else 3
    cov = np.broadcast_to(np.eye(size) * 1e-3, (N, size, size))
    own = ss.audit((STAMPS, found, cov), (STAMPS, truth), align="all").trajectory

    def of_evo(rows):
        return PoseTrajectory3D(rows[:, :3], np.roll(rows[:, 3:], 1, axis=1), STAMPS)

    def statistic(metric, data):
        metric.process_data(data)
        return metric.get_statistic(metrics.StatisticsType.rmse)

    true, estimate = of_evo(tum(truth)), of_evo(tum(found))
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    assert own.ate_m == pytest.approx(statistic(ape, (true, estimate)), abs=1e-6)
    estimate.align(true)
    expected = statistic(metrics.APE(metrics.PoseRelation.translation_part), (true, estimate))
    assert own.aligned_ate_m == pytest.approx(expected, abs=1e-6) and expected < 0.1 < own.ate_m
