"""Time of an EKF update over the size of the map, compared with one pass over its covariance."""

from __future__ import annotations

import math

import numpy as np
from harness import Figures, alternate
from numpy.typing import NDArray
from sixthsense.testing.sight import predict_points

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.estimators.ekf import EKF

SIZES = (30, 100, 300, 1000, 2000)
SEEN = 10
LIMITS = {"n30_m10_ms": "<= 0.06", "n1000_m10_passes": "<= 1.3"}

NOISE_M = 0.02
MOTION = Pose(0.1, 0.0, 0.01)
ODOMETRY = Odometry(MOTION, 1e-5 * np.eye(3))

Observations = dict[int, Observation]


def sight(ids: NDArray[np.int64], landmarks: Array, truth: Pose, rng: np.random.Generator) -> Observations:
    """Noisy observations of some of the landmarks (n, 2)."""
    exact, _, _ = predict_points(truth, landmarks[ids])
    noisy = exact + rng.normal(0.0, NOISE_M, exact.shape)
    return {int(i): Observation(Kind.CORNER, z, NOISE_M**2 * np.eye(2)) for i, z in zip(ids, noisy, strict=True)}


def update_figures(n: int, repeats: int, seen: int = SEEN) -> Figures:
    """Milliseconds of prediction and update with `n` landmarks and of one pass over the covariance, and their ratio.

    The pass reads and writes every number of a column-major (3 + 2n, 3 + 2n) array once. A filter with a dense
    covariance must do at least half of that, one triangle.
    """
    rng = np.random.default_rng(n)
    landmarks = rng.uniform(-50.0, 50.0, (n, 2))
    truth = Pose()
    # The start is uncertain so that all landmarks are correlated.
    ekf = EKF(truth, np.diag([1e-2, 1e-2, 1e-3]))
    ekf.update(sight(np.arange(n), landmarks, truth, rng))
    scans = []
    for _ in range(repeats + 3):
        truth = truth @ MOTION
        scans.append(sight(rng.choice(n, seen, replace=False), landmarks, truth, rng))
    whole = np.asfortranarray(rng.normal(size=(3 + 2 * n, 3 + 2 * n)))

    def update(observations: Observations) -> None:
        ekf.predict(ODOMETRY)
        ekf.update(observations)

    def one_pass(_: Observations) -> None:
        nonlocal whole
        whole *= 1.0000001

    ms = alternate(scans, update, one_pass)[3:]  # the first runs fault memory pages in
    error_m = math.hypot(*(ekf.estimate().pose.position - truth.position))
    assert error_m < 1.0, "the filter has diverged: its times mean nothing"
    update_ms, pass_ms = np.median(ms, axis=0)
    name = f"n{n}_m{seen}"
    return {
        f"{name}_ms": float(update_ms),
        f"{name}_pass_ms": float(pass_ms),
        f"{name}_passes": float(update_ms / pass_ms),
    }


def scaling_figures(sizes: tuple[int, ...] = SIZES, repeats: int = 100) -> Figures:
    """Figures of all map sizes."""
    figures: Figures = {}
    for n in sizes:
        figures |= update_figures(n, repeats)
    return figures
