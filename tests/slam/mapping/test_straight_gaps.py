"""Gaps between returns of one wall, and those that are a way."""

import math

import numpy as np
import pytest

from sixthsense.config import LaserConfig
from sixthsense.config.platform import LaserNoise
from sixthsense.core.geometry import Array
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.slam.mapping.straight_gaps import straight_gaps

NOISE = LaserNoise(range_m=0.01)
SHORTEST_M, LONGEST_M = 0.05, 0.4


def walls_seen(*walls: tuple[float, float, float]) -> Array:
    """The gaps in a noisy scan of walls along y = distance for x from one number to another."""
    config = LaserConfig()
    bearings = beam_bearings(config)
    ranges = np.full(len(bearings), np.inf)
    for distance, low, high in walls:
        with np.errstate(divide="ignore"):
            r = distance / np.sin(bearings)
        hit = (r > 0.0) & (r * np.cos(bearings) > low) & (r * np.cos(bearings) < high)
        ranges[hit] = np.minimum(ranges[hit], r[hit])
    noisy = ranges + np.random.default_rng(3).normal(0.0, NOISE.range_m, len(ranges))
    return straight_gaps(Scan.from_config(noisy, config), NOISE, SHORTEST_M, LONGEST_M)


@pytest.mark.parametrize("distance", [0.3, 0.6, 1.0])
def test_a_wall_at_a_grazing_angle_is_closed_as_far_as_its_gaps_are_narrow(distance: float) -> None:
    gaps = walls_seen((distance, -9.0, 9.0))
    far = math.sqrt(LONGEST_M / math.radians(1.0) * distance) - LONGEST_M  # the gap is range squared / distance
    near = math.sqrt(SHORTEST_M / math.radians(1.0) * distance) + SHORTEST_M
    x = np.arange(near, far, 0.01)
    closed = (gaps[:, :, 0].min(axis=1) <= x[:, None]) & (x[:, None] <= gaps[:, :, 0].max(axis=1))
    assert closed.any(axis=1).mean() > 0.98
    assert np.abs(gaps[..., 1] - distance).max() < 0.05


def test_a_door_in_a_wall_is_no_gap() -> None:
    gaps = walls_seen((0.6, -9.0, 1.5), (0.6, 2.0, 9.0))
    assert len(gaps) > 0
    assert not ((gaps[:, :, 0].min(axis=1) < 1.75) & (gaps[:, :, 0].max(axis=1) > 1.75)).any()


def test_the_step_between_two_walls_is_no_gap() -> None:
    gaps = walls_seen((0.6, -9.0, 1.5), (0.8, 1.5, 9.0))
    assert (np.abs(gaps[:, 0, 1] - gaps[:, 1, 1]) < 0.1).all()


def test_a_scan_without_returns_has_none() -> None:
    assert walls_seen().shape == (0, 2, 2)
