"""Which observations are near enough to which landmarks for a gate on the innovation, or far enough to be new."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import AssociationConfig
from sixthsense.core.geometry import Array
from sixthsense.core.landmarks import Observation
from sixthsense.slam.association.wall_alignment import Alignment
from sixthsense.slam.association.wall_extents import ends, nearness
from sixthsense.slam.estimators.base import Estimate

Mask = NDArray[np.bool_]

_ANGLE_LIMITS_RAD = (0.15, 0.6)
"""Between two walls: always plausible below the first, never above the second."""
_OFFSET_LIMIT_M = 0.3
"""Between two walls: always plausible below."""


@dataclass(frozen=True, slots=True)
class PreGate:
    """m observations compared with n landmarks by geometry."""

    plausible: Mask
    """(m, n) near enough for a gate on the innovation"""
    apart: Mask
    """(m, n) far enough apart for the observation to be of another landmark"""
    sigmas: Array
    """(m,) upper bound of the sigma of a point, or of a wall's middle, in the world; m"""
    covered: Array
    """(m, n) share of an observed wall that lies on what is known of the landmark; 1 for points"""
    coverable: Array
    """(m, n) likewise, if the robot is as far from its estimate as two sigmas"""


def pre_gate(
    observations: Sequence[Observation],
    estimate: Estimate,
    aligned: Alignment,
    sigmas: Array,
    extents: Array,
    gate_sigmas: float,
    cfg: AssociationConfig,
) -> PreGate:
    """Compare observations with all landmarks of the estimate, as seen from the aligned pose.

    `sigmas` (n,) upper bounds for points, metres; `extents` (n, 2, 2) ends of walls; `gate_sigmas` the widest gate.
    The sigma of a difference is at most the sum of both sigmas, however they are correlated, so a point that is left
    out here could not pass a gate. The factor of 2 allows for sigmas that grow when the smoother relinearizes.
    Walls of an aligned scan need no such allowance.
    """
    shape = len(observations), len(estimate.ids)
    plausible, apart = np.zeros(shape, dtype=bool), np.ones(shape, dtype=bool)
    covered, coverable = np.ones(shape), np.ones(shape)
    own = _world_sigmas(observations, estimate)
    pose, is_aligned = aligned.pose, aligned.explained >= cfg.align.enough
    walls = np.array([s.is_wall for s in observations], dtype=bool)
    rows, cols = np.flatnonzero(~walls), np.flatnonzero(~estimate.walls)
    if len(rows) and len(cols):
        positions = pose @ np.array([observations[k].z for k in rows.tolist()])
        gap = positions[:, None, :] - estimate.landmarks[None, cols, :]
        distance = np.hypot(gap[..., 0], gap[..., 1])
        reach = np.minimum(cfg.pre_gate_m, gate_sigmas * (own[rows, None] + 2.0 * sigmas[None, cols]))
        plausible[np.ix_(rows, cols)] = distance < reach
        apart[np.ix_(rows, cols)] = distance > cfg.new_separation_m
    rows, cols = np.flatnonzero(walls), np.flatnonzero(estimate.walls)
    if len(rows) and len(cols):
        observed = np.array([ends(pose, observations[k]) for k in rows.tolist()])
        alphas = np.array([observations[k].z[0] for k in rows.tolist()]) + pose.theta
        near = nearness(observed, alphas, estimate.landmarks[cols], extents[cols])
        angle, offset, in_line = np.abs(near.angle), np.abs(near.offset), near.gap < cfg.wall_gap_m
        turn, reach = _ANGLE_LIMITS_RAD[0], np.full(len(rows), _OFFSET_LIMIT_M)
        if not is_aligned:
            turn = float(np.clip(gate_sigmas * math.sqrt(estimate.pose_cov[2, 2]), *_ANGLE_LIMITS_RAD))
            reach = np.clip(gate_sigmas * own[rows], _OFFSET_LIMIT_M, cfg.pre_gate_m)
        plausible[np.ix_(rows, cols)] = in_line & (angle < turn) & (offset < reach[:, None])
        apart[np.ix_(rows, cols)] = ~(in_line & (angle < _ANGLE_LIMITS_RAD[0]) & (offset <= cfg.new_separation_m))
        length = np.hypot(*(observed[:, 1] - observed[:, 0]).T)[:, None]
        covered[np.ix_(rows, cols)] = np.clip(-near.gap / length, 0.0, 1.0)
        coverable[np.ix_(rows, cols)] = np.clip((2.0 * own[rows, None] - near.gap) / length, 0.0, 1.0)
    return PreGate(plausible, apart, own, covered, coverable)


def _world_sigmas(observations: Sequence[Observation], estimate: Estimate) -> Array:
    """(m,) upper bound of the sigma of points, or of walls' middles, in the world; m."""
    cov = estimate.pose_cov
    out = np.empty(len(observations))
    for k, s in enumerate(observations):
        if s.is_wall:
            middle = 0.5 * (s.extent[0] + s.extent[1])
            own = s.cov[1, 1] - 2.0 * middle * s.cov[0, 1] + middle**2 * s.cov[0, 0]
            reach = math.hypot(float(s.z[1]), middle)
        else:
            own, reach = s.cov[0, 0] + s.cov[1, 1], math.hypot(*s.z)
        out[k] = math.sqrt(max(own, 0.0)) + reach * math.sqrt(cov[2, 2])
    return out + math.sqrt(cov[0, 0] + cov[1, 1])
