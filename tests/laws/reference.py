"""A posterior that is updated in information form, beside batch least squares."""

from __future__ import annotations

import math

import numpy as np

from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.testing.batch import Posterior, jacobian, observation_jacobian, to_robot


def _linearized(state: Array, observation: Observation) -> tuple[Array, Array, Array]:
    """Jacobian (2, 5) of an observation by pose and landmark, its innovation (2,), and the covariance (2, 2) of that.

    The error of a wall's observation is a turn about the place where direction and offset are independent, and a shift.
    """
    pose, landmark = state[:3], state[3:]
    if not observation.is_wall:
        H = observation_jacobian(pose, landmark, False)
        return H, observation.z - to_robot(pose, landmark, False), observation.cov
    alpha, d = (float(value) for value in observation.z)
    (var, mixed), (_, of_offset) = observation.cov.tolist()
    place = np.array([d * math.cos(alpha), d * math.sin(alpha)])
    place += mixed / var * np.array([-math.sin(alpha), math.cos(alpha)])

    def residual(x: Array) -> Array:
        line = to_robot(x[:3], x[3:], True)
        gap = math.cos(line[0]) * place[0] + math.sin(line[0]) * place[1] - line[1]
        return np.array([wrap_angle(alpha - float(line[0])), gap])

    return -jacobian(residual, state), residual(state), np.diag([var, of_offset - mixed**2 / var])


def corrected(prior: Posterior, observations: dict[LandmarkId, Observation]) -> Posterior:
    """A prior after observations of its landmarks, in information form: adds H^T R^-1 H, linearized at the prior."""
    information = np.linalg.inv(prior.cov)
    gradient = np.zeros(len(prior.mean))
    for i, observation in observations.items():
        k = prior.ids.index(i)
        at = np.append(np.arange(3), 3 + 2 * k + np.arange(2))
        H, innovation, cov = _linearized(prior.mean[at], observation)
        weight = np.linalg.inv(cov)
        information[np.ix_(at, at)] += H.T @ weight @ H
        gradient[at] += H.T @ weight @ innovation
    cov = np.linalg.inv(information)
    return Posterior(prior.ids, prior.mean + cov @ gradient, 0.5 * (cov + cov.T), prior.angles)
