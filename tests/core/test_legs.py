"""Rays and legs: the kernel against a plain reference."""

import numpy as np
import pytest
from scanned import box

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.ray_casting import Moving, beams_of, cast_among, cast_rays, cast_sweep

ROOM = box(-4, -3, 8, 6)
RANGE = 10.0


def plain(pose: Pose, bearings: Array, legs: Array) -> Array:
    """Distances to the nearest leg, all beams against all legs; inf for none."""
    angles = bearings + pose.theta
    off = legs[:, :2] - pose.position  # (L, 2)
    along = off @ np.stack([np.cos(angles), np.sin(angles)])  # (L, N)
    under = along**2 - (off**2).sum(axis=1)[:, None] + (legs[:, 2] ** 2)[:, None]
    inside = np.hypot(*off.T) <= legs[:, 2]
    hit = np.where((along > 0.0) & (under >= 0.0), along - np.sqrt(np.maximum(under, 0.0)), np.inf)
    return np.where(inside[:, None], 0.0, hit).min(axis=0, initial=np.inf)


def some_legs(rng: np.random.Generator, count: int) -> Array:
    return np.column_stack([rng.uniform(-3.5, 3.5, (count, 2)), rng.uniform(0.02, 0.4, count), np.zeros((count, 2))])


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("beams", [7, 360])
def test_rays_end_at_the_nearest_leg_or_wall(seed: int, beams: int) -> None:
    rng = np.random.default_rng(seed)
    pose = Pose(*rng.uniform(-2.5, 2.5, 2), rng.uniform(-np.pi, np.pi))
    bearings, legs = np.linspace(-np.pi, np.pi, beams, endpoint=False), some_legs(rng, 8)
    expected = np.minimum(cast_rays(pose, bearings, ROOM, RANGE), plain(pose, bearings, legs))
    assert np.allclose(cast_among(pose, beams_of(bearings), ROOM.reshape(-1, 4), RANGE, legs), expected, atol=1e-9)


def test_during_a_sweep_each_beam_meets_a_leg_where_it_is_then() -> None:
    bearings, times = np.zeros(3), np.array([-0.2, -0.1, 0.0])
    moving = Moving(np.array([[2.0, 0.0, 0.1, 5.0, 0.0]]), times)
    swept = cast_sweep(np.zeros((3, 3)), bearings, ROOM, RANGE, moving)
    assert swept == pytest.approx([0.9, 1.4, 1.9])
