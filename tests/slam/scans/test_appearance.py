"""What places look like, whatever pose they are seen from."""

import math

import numpy as np
import pytest

from sixthsense.slam.scans.places import BINS, appearance


def place(seed, walls=9, points=30):
    """(N, 4) points on walls of random length and direction, with their normals."""
    rng, rows = np.random.default_rng(seed), []
    for _ in range(walls):
        middle, angle, length = rng.uniform(-6, 6, 2), rng.choice([0.3, 0.3 + math.pi / 2, 1.1]), rng.uniform(1, 6)
        along = np.array([math.cos(angle), math.sin(angle)])
        t = rng.uniform(-0.5, 0.5, points)[:, None] * length
        rows.append(np.column_stack([middle + t * along, np.tile([-along[1], along[0]], (points, 1))]))
    return np.vstack(rows)


def moved(surfaces, x, y, theta):
    c, s = math.cos(theta), math.sin(theta)
    turn = np.array([[c, -s], [s, c]])
    return np.column_stack([surfaces[:, :2] @ turn.T + [x, y], surfaces[:, 2:] @ turn.T])


@pytest.mark.parametrize("seed", range(3))
def test_a_place_looks_the_same_from_any_pose(seed):
    here = place(seed)
    assert appearance(here) @ appearance(moved(here, 4.3, -7.1, 2.2)) > 0.999


@pytest.mark.parametrize("seed", range(3))
def test_a_place_looks_more_like_its_own_half_than_like_other_places(seed):
    here = place(seed)
    part = appearance(here[np.random.default_rng(seed).uniform(size=len(here)) < 0.6])
    assert appearance(here) @ part > max(appearance(place(other)) @ part for other in range(20, 40))


def test_pairs_are_counted_as_a_plain_loop_counts_them():
    surfaces = place(5, walls=4, points=8)
    surfaces[3, 2:] = 0.0
    expected = np.zeros((24, 3, 3))
    for i in range(len(surfaces)):
        for j in range(i + 1, len(surfaces)):
            (p, n), (q, m) = ((surfaces[k, :2], surfaces[k, 2:]) for k in (i, j))
            if not n.any() or not m.any():
                continue
            distance = np.linalg.norm(q - p)
            row = min(distance // 0.75, 23)
            across = abs(n @ (q - p) / distance) + abs(m @ (q - p) / distance)
            expected[int(row), np.digitize(abs(n @ m), [1 / 3, 2 / 3]), np.digitize(across, [2 / 3, 4 / 3])] += 1
    found = appearance(surfaces)
    assert len(found) == BINS and found**2 * expected.sum() == pytest.approx(expected.ravel(), abs=1e-9)
