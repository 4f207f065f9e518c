"""Lines are cut where they are not straight."""

import math

import numpy as np
import pytest
from scanned import look

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.slam.features import extract
from sixthsense.slam.features.line_fit import LaserSigmas, across_line, cut_gains, fit_line, straight_pieces

SIGMAS = LaserSigmas(0.01, 0.001)
BEARINGS = np.radians(np.arange(-60.0, 60.0, 1.5))
ALL = np.arange(len(BEARINGS))


def seen(distances, rng, sigma=0.01):
    """Returns (N, 2) of a wall ahead whose distance along the x axis at each bearing is `distances` (N,)."""
    ranges = distances / np.cos(BEARINGS) + rng.normal(0.0, sigma, len(BEARINGS))
    return ranges[:, None] * np.column_stack([np.cos(BEARINGS), np.sin(BEARINGS)])


def straight(rng, sigma=0.01):
    return seen(np.full(len(BEARINGS), 2.0), rng, sigma)


def bent(rng, degrees, sigma=0.01):
    """A wall 2 m ahead that turns away to the left of the laser."""
    slope = np.tan(BEARINGS)
    turned = 2.0 / (1.0 - math.tan(math.radians(degrees)) * slope)
    return seen(np.where(slope > 0.0, turned, 2.0), rng, sigma)


def weighted(points, index, line, sigmas):
    rows = np.array([across_line(*points[i], line, sigmas) for i in index])
    return rows[:, 0], rows[:, 1], 1.0 / rows[:, 2]


def pieces_of(points, index, sigmas, false_alarm, least):
    return straight_pieces(points, index, fit_line(points, index, sigmas), sigmas, false_alarm, least)


def left_over(off, columns, weights):
    """Chi-square of offsets (n,) after the weighted fit of `columns` (n, k)."""
    root = np.sqrt(weights)
    solution = np.linalg.lstsq(columns * root[:, None], off * root, rcond=None)[0]
    return float((weights * (off - columns @ solution) ** 2).sum())


def test_the_gain_of_a_cut_is_what_two_separate_fits_explain_more():
    points = bent(np.random.default_rng(1), 2.0)
    index = ALL[::4]
    line = fit_line(points, index, SIGMAS)
    off, arm, weights = weighted(points, index, line, SIGMAS)
    columns = np.column_stack([np.ones(len(index)), arm])
    one = left_over(off, columns, weights)

    def side(part):
        kept = columns[part] if len(off[part]) > 2 else columns[part][:, :1]
        return left_over(off[part], kept, weights[part])

    expected = [one - side(slice(0, k)) - side(slice(k, None)) for k in range(1, len(index))]
    assert cut_gains(points, index, line, SIGMAS) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("false_alarm", [0.01, 0.1])
@pytest.mark.parametrize("step", [1, 8])
def test_a_straight_wall_is_cut_as_seldom_as_it_is_set_to(false_alarm, step):
    rng, index = np.random.default_rng(2), ALL[::step]
    runs = 4000
    pieces = [pieces_of(straight(rng), index, LaserSigmas(0.01, 0.0), false_alarm, 1) for _ in range(runs)]
    share = sum(len(found) > 1 for found in pieces) / runs
    assert 0.5 * false_alarm < share < 1.6 * false_alarm


def test_a_bend_of_a_degree_and_a_half_is_cut_where_it_is():
    rng = np.random.default_rng(3)
    bend = int(np.searchsorted(BEARINGS, 0.0))
    found = [pieces_of(bent(rng, 3.0, 0.005), ALL, LaserSigmas(0.005, 0.0), 0.01, 6) for _ in range(100)]
    assert sum(len(pieces) == 2 for pieces in found) >= 95
    assert np.median([abs(pieces[0, 1] - bend) for pieces in found]) <= 6


def walls_observed(walls, config, rng):
    scan = look(Pose(), walls, config.laser, config.assumed.laser.range_m, rng)
    return [s for s in extract(scan, config.assumed, config.features).observations if s.is_wall]


def test_no_line_spans_two_walls_that_meet_at_one_and_a_half_degrees():
    bend = math.radians(1.4)
    walls = np.array([[(2.0, -5.0), (2.0, 0.0)], [(2.0, 0.0), (2.0 + 5.0 * math.tan(bend), 5.0)]])
    config, rng = preset(laser={"beams": 1440}), np.random.default_rng(4)
    for _ in range(30):
        observations = walls_observed(walls, config, rng)
        turns = np.array([math.remainder(s.z[0] - math.pi, 2.0 * math.pi) for s in observations])
        off = np.abs(turns[:, None] - np.array([0.0, -bend])) / np.sqrt([[s.cov[0, 0]] for s in observations])
        assert (off.min(axis=1) < 4.5).all()
        assert set(off.argmin(axis=1).tolist()) == {0, 1}
