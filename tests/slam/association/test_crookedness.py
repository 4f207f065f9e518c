"""Walls that are not straight determine less, by the innovations of their stretches that are seen anew."""

import numpy as np
import pytest

from sixthsense.core.landmarks import Kind, Observation
from sixthsense.slam.association.records import Crookedness, Record, less_certain, unit_cov

COV = np.array([[4e-6, 1e-6], [1e-6, 9e-6]])
EXTENT = (-0.7, 1.6)
LOOKS = 30


def building(sigma_m, walls=40, looks=LOOKS, seed=0):
    """How crooked walls are found to be, and the records of walls whose stretches are off by `sigma_m`."""
    rng, unit = np.random.default_rng(seed), unit_cov(*EXTENT, True)
    crookedness, records = Crookedness(), [Record(Kind.WALL, 1, 0, 0) for _ in range(walls)]
    for _ in range(looks):
        for record in records:
            value = rng.multivariate_normal(np.zeros(2), COV + sigma_m**2 * unit)
            crookedness.add(record, value, COV, unit)
        crookedness.update(records)
    return crookedness, records


@pytest.mark.parametrize("sigma_m", [0.0, 0.0015, 0.003, 0.006])
def test_the_estimate_of_a_variance_is_its_posterior_mean_and_no_lower_bound(sigma_m):
    """An excess of 0.2 to 5 of the innovations is found to a quarter after 30 looks at 40 walls, and straight is 0."""
    _, records = building(sigma_m)
    mean = float(np.mean([record.square_m2 for record in records]))
    assert mean == pytest.approx(sigma_m**2, rel=0.25, abs=(1.5e-4) ** 2)


def test_a_new_wall_is_as_crooked_as_those_of_the_building_and_a_point_is_not():
    crookedness, records = building(0.004)
    assert crookedness.square_m2(Record(Kind.WALL, 1, 0, 0)) == pytest.approx(16e-6, rel=0.25)
    assert crookedness.square_m2(Record(Kind.END, 1, 0, 0)) == 0.0
    assert 0.0 < Crookedness().square_m2(Record(Kind.WALL, 1, 0, 0)) < (2e-4) ** 2
    crookedness.update([])
    assert crookedness.square_m2(records[0]) < 17e-6


def test_one_crooked_wall_among_straight_ones_is_less_certain_alone():
    rng, unit = np.random.default_rng(5), unit_cov(*EXTENT, True)
    crookedness, records = Crookedness(), [Record(Kind.WALL, 1, 0, 0) for _ in range(20)]
    for _ in range(LOOKS):
        for k, record in enumerate(records):
            value = rng.multivariate_normal(np.zeros(2), COV + (0.005**2 if k == 7 else 0.0) * unit)
            crookedness.add(record, value, COV, unit)
        crookedness.update(records)
    squares = np.array([record.square_m2 for record in records])
    assert squares[7] > 10e-6 and np.delete(squares, 7).max() < 1e-6


def test_looks_at_one_stretch_determine_its_wall_as_their_mean_does():
    record = Record(Kind.WALL, 1, 0, 0, square_m2=25e-6)
    wall = Observation(Kind.WALL, np.array([0.3, 2.0]), COV, EXTENT)
    information = np.zeros((2, 2))
    for k in range(8):
        ends = np.array([[0.1 * k, 0.0], [2.0 + 0.1 * k, 0.0]])
        assert record.look(ends, k) == (k == 0)
        information += np.linalg.inv(less_certain(wall, record).cov)
        record.last_scan = k
        assert np.linalg.inv(information) == pytest.approx(25e-6 * unit_cov(*EXTENT, True) + COV / (k + 1), rel=1e-6)


@pytest.mark.parametrize(("ends", "scan", "is_anew"), [
    ([[0.0, 0.0], [2.0, 0.0]], 4, False), ([[0.9, 0.0], [2.9, 0.0]], 4, False), ([[1.5, 0.0], [3.5, 0.0]], 4, True),
    ([[2.0, 0.0], [0.0, 0.0]], 28, False), ([[0.0, 0.0], [2.0, 0.0]], 29, True),
])  # fmt: skip
def test_a_look_is_at_another_stretch_where_little_of_it_was_seen_or_after_a_pause(ends, scan, is_anew):
    record = Record(Kind.WALL, 5, 0, 3, looks=5, stretch=np.array([[0.0, 0.0], [2.0, 0.0]]))
    assert record.look(np.array(ends), scan) == is_anew
    assert record.looks == (1 if is_anew else 6)
