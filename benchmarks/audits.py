"""`sixthsense audit` on errors that are drawn from a known covariance.

A robot drives a circle. Its errors are Gaussian with an anisotropic covariance that is correlated between axes, white
or AR(1), in SE(2) and in SE(3). The stated covariance is 0.5, 1 or 2 times the true one: a right verdict is
overconfident, consistent or cautious. The effective number of samples of AR(1) errors is N (1 - rho^2) / (1 + rho^2) in
theory.
"""

from __future__ import annotations

import math

import numpy as np
from runs import Figures, Setting
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

import sixthsense as ss
from sixthsense.core.geometry import Array

POSES, STEP_S, TURN_RATE = 10_000, 0.1, 0.05
SIGMAS = {3: (0.08, 0.03, 0.01), 6: (0.08, 0.03, 0.05, 0.004, 0.006, 0.01)}
RHO = {"white": 0.0, "AR(1) 0.99": 0.99}
EXPECTED = {"0.5": "overconfident", "1": "consistent", "2": "cautious"}
"""verdict on a covariance so many times the true one"""


def covariance(dof: int) -> Array:
    """(dof, dof) of the errors: neighbouring axes are correlated by 0.4."""
    correlation = np.eye(dof) + 0.4 * (np.eye(dof, k=1) + np.eye(dof, k=-1))
    return np.asarray(correlation * np.outer(SIGMAS[dof], SIGMAS[dof]))


def errors(rng: np.random.Generator, rho: float, dof: int) -> Array:
    """(POSES, dof) stationary AR(1) errors."""
    white = rng.standard_normal((POSES, dof))
    white[1:] *= math.sqrt(1.0 - rho**2)
    return np.asarray(lfilter([1.0], [1.0, -rho], white, axis=0) @ np.linalg.cholesky(covariance(dof)).T)


def circle(dof: int) -> tuple[Array, Array]:
    """Stamps and true poses, (POSES, 3) or (POSES, 7)."""
    stamps_s = STEP_S * np.arange(POSES)
    theta = TURN_RATE * stamps_s
    place = np.column_stack([8.0 * np.sin(theta), -8.0 * np.cos(theta), np.sin(3.0 * theta)])
    if dof == 3:
        return stamps_s, np.column_stack([place[:, :2], theta])
    tilt = Rotation.from_euler("zyx", np.column_stack([theta, 0.2 * np.sin(theta), 0.1 * np.cos(theta)]))
    return stamps_s, np.column_stack([place, tilt.as_quat()])


def erroneous(poses: Array, error: Array) -> Array:
    """Poses with errors in the axes of the world."""
    if error.shape[1] == 3:
        return poses + error
    turned = Rotation.from_rotvec(error[:, 3:]) * Rotation.from_quat(poses[:, 3:])
    return np.column_stack([poses[:, :3] + error[:, :3], turned.as_quat()])


def audit(setting: Setting, seed: int) -> Figures:
    """Whether the verdict is right, and its interval holds the factor."""
    rho, dof, stated = RHO[setting[0]], 3 if setting[1] == "SE(2)" else 6, float(setting[2])
    stamps_s, truth = circle(dof)
    poses = erroneous(truth, errors(np.random.default_rng(seed), rho, dof))
    covs = np.broadcast_to(stated * covariance(dof), (POSES, dof, dof))
    found = ss.audit((stamps_s, poses, covs), (stamps_s, truth)).findings
    low, high = found.pose.interval
    return {
        "right": int(found.outcome == EXPECTED[setting[2]]), "held": int(low <= 1.0 / stated <= high),
        "factor": found.factor, "width": high / low, "samples": found.pose.samples,
        "in_theory": POSES * (1.0 - rho**2) / (1.0 + rho**2),
    }  # fmt: skip
