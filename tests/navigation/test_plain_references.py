"""What is visible, and how tours are shortened, against plain references."""

import itertools
import math

import numpy as np
import pytest
from scipy import ndimage

from sixthsense.navigation.gridsearch import costs_from
from sixthsense.navigation.gridsearch.prices import cheapest_way
from sixthsense.navigation.tour import TileWays, shorten, tour_length
from sixthsense.navigation.unseen_places import widest_ways
from sixthsense.navigation.visibility import expected_gain, line_of_sight, visible_cells


def crossed(row, col, angle, reach):
    """Cells that a ray from a cell's centre crosses, by dense samples, none twice, without the cell itself."""
    steps = np.arange(0.0, reach, 0.001)
    cells = np.floor(np.column_stack([row + 0.5 + steps * math.sin(angle), col + 0.5 + steps * math.cos(angle)]))
    return [tuple(map(int, cell)) for cell in dict.fromkeys(map(tuple, cells))][1:]


@pytest.mark.parametrize("seed", range(4))
def test_a_line_of_sight_crosses_no_obstacle(seed):
    rng = np.random.default_rng(seed)
    obstacles = rng.random((19, 26)) < 0.15
    visible = visible_cells(obstacles, np.ones_like(obstacles), 8, 11, 9.5)
    for r, c in np.ndindex(*obstacles.shape):
        down, across = r - 8, c - 11
        if math.hypot(down, across) > 9.5:
            assert not visible[r, c]
            continue
        scale = math.gcd(down, across) or 1
        assert line_of_sight(obstacles, 8, 11, r, c) == line_of_sight(obstacles, r, c, 8, 11)
        if down // scale % 2 and across // scale % 2:
            continue  # it meets corners
        between = crossed(8, 11, math.atan2(down, across), math.hypot(down, across))
        free = not any(obstacles[cell] for cell in between if cell != (r, c))
        assert line_of_sight(obstacles, 8, 11, r, c) == visible[r, c] == free


@pytest.mark.parametrize("reach, depth", [(6.3, 3), (14.0, 5)])
def test_the_gain_of_a_view_is_what_its_rays_cross(reach, depth):
    rng = np.random.default_rng(4)
    obstacles, unseen = rng.random((17, 23)) < 0.06, rng.random((17, 23)) < 0.5
    for row, col, first in ((7, 9, -4), (2, 20, 36)):
        found, counts = set(), []  # cells, and how many after each ray
        for i in [first] + [first + side * k for k in range(1, 19) for side in (1, -1)]:
            left = depth
            for r, c in crossed(row, col, 2.0 * math.pi * i / 37, reach):
                if not (0 <= r < 17 and 0 <= c < 23) or obstacles[r, c] or left == 0:
                    break
                if unseen[r, c]:
                    left -= 1
                    found.add((r, c))
            counts.append(len(found))
        asked = obstacles, unseen, row, col, (37, first), reach, depth
        assert expected_gain(*asked) == len(found)
        for enough in (0, counts[5], len(found) - 1):
            assert expected_gain(*asked, enough) == enough + 1
        assert expected_gain(*asked, len(found)) == len(found)


@pytest.mark.parametrize("seed", range(8))
def test_no_reversed_or_moved_part_makes_a_shortened_tour_shorter(seed):
    points = np.random.default_rng(seed).uniform(0.0, 30.0, (9, 2))
    lengths = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    tour = np.array([0, *np.random.default_rng(seed + 50).permutation(7) + 1, 8])
    shorten(lengths, tour)
    assert tour[0] == 0 and tour[-1] == 8 and sorted(tour) == list(range(9))
    length = tour_length(lengths, tour)
    assert length == pytest.approx(sum(math.dist(points[a], points[b]) for a, b in itertools.pairwise(tour)))
    for i in range(1, 8):
        for j in range(i + 1, 9):
            part, rest = tour[i:j], np.concatenate([tour[:i], tour[j:]])
            others = [np.concatenate([tour[:i], part[::-1], tour[j:]])]
            if j - i <= 3:
                places = range(1, len(rest))
                others += [np.concatenate([rest[:k], p, rest[k:]]) for k in places for p in (part, part[::-1])]
            assert min(tour_length(lengths, other) for other in others) > length - 2e-6


def test_ways_over_tiles_are_kept_up_to_date_as_if_drawn_anew():
    rng = np.random.default_rng(3)
    free = rng.random((64, 88)) < 0.75
    ways = TileWays(6)
    ways.update(free)
    for _ in range(12):
        free = free.copy()
        top, left = int(rng.integers(56)), int(rng.integers(80))
        before, part = free.copy(), (slice(top, top + 9), slice(left, left + 9))
        free[part] = rng.random(free[part].shape) < rng.choice([0.1, 0.9])
        ways.update(free, (free != before).reshape(8, 8, 11, 8).any(axis=(1, 3)))
        anew = TileWays(6)
        anew.update(free)
        cells = np.argwhere(free)[rng.integers(np.count_nonzero(free), size=8)]
        assert np.array_equal(ways.matrix(cells), anew.matrix(cells))


@pytest.mark.parametrize("seed", range(4))
def test_the_cheapest_way_over_dear_cells_costs_what_is_said(seed):
    rng = np.random.default_rng(seed)
    prices = rng.choice(np.array([0, 1, 1, 4, 30], np.uint8), (17, 24))
    prices[3, 5] = 1
    costs = costs_from(prices, 3, 5)
    for row, col in np.argwhere(costs > 0)[::17]:
        way = cheapest_way(prices, costs, row, col)
        assert way[0].tolist() == [3, 5] and way[-1].tolist() == [row, col]
        cost = 0
        for (r, c), (to_r, to_c) in itertools.pairwise(way):
            touched = prices[min(r, to_r) : max(r, to_r) + 1, min(c, to_c) : max(c, to_c) + 1].astype(int)
            assert max(abs(to_r - r), abs(to_c - c)) == 1 and prices[to_r, to_c] > 0
            if r != to_r and c != to_c:
                entered = [touched[k] for k in np.ndindex(2, 2) if (k[0] + min(r, to_r), k[1] + min(c, to_c)) != (r, c)]
                assert min(entered) > 0
                cost += 7 * max(entered)
            else:
                cost += 5 * int(prices[to_r, to_c])
        assert cost == costs[row, col]
    assert len(cheapest_way(prices, costs, *np.argwhere(costs < 0)[0])) == 0


@pytest.mark.parametrize("seed", range(4))
def test_the_widest_way_to_a_cell_is_that_of_the_largest_threshold_above_which_it_is_connected(seed):
    rng = np.random.default_rng(seed)
    away = np.where(rng.random((17, 23)) < 0.45, 0.0, rng.uniform(0.1, 3.0, (17, 23)))
    sources = rng.random(away.shape) < 0.02
    expected = np.zeros_like(away)
    for value in np.unique(away[away > 0.0]):
        parts, _ = ndimage.label(away >= value, np.ones((3, 3)))
        own = np.unique(parts[sources & (parts > 0)])
        expected[np.isin(parts, own) & (parts > 0)] = value
    found = widest_ways(away, sources)
    np.testing.assert_array_equal(found, expected)
    assert (found > 0.0).any() and (found[away > 0.0] == 0.0).any()
