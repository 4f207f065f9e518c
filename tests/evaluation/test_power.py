"""Short tours show whether the whole pipeline is consistent, and would show a covariance that is wrong.

The band of the mean over the runs follows from the spread between runs, which `benchmarks/consistency_power.py`
measured on the seeds 0 to 99, other seeds than those judged here. Six means are judged, three statistics of two
estimators. A consistent pipeline leaves any of the bands with a probability of `FALSE_ALARM`. A scaled covariance moves
the statistic that shows it by at least six standard errors of `SABOTAGED_SEEDS` beyond the limit of the band.
"""

import functools
import importlib
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import norm

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"

ESTIMATORS = ("ekf-invariant", "isam2")
SEEDS = range(1000, 1012)
SABOTAGED_SEEDS = SEEDS[:4]

SPREAD = {"nees": 1.1, "nis": 0.045, "increment": 0.40}
"""standard deviation between runs, the larger one of the two estimators, of 100 runs"""

FALSE_ALARM = 1e-3
"""of all six means together"""

SHOWN_BY = {"observations x 0.7": "nis", "observations x 1.5": "nis", "odometry x 0.5": "increment"}
"""statistic whose power the choice of runs and of their length rests on"""


@pytest.fixture
def tours(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("consistency_power")


@functools.cache
def driven(estimator, seed):
    """Ticks and keyframes of a tour, once per process."""
    script = importlib.import_module("consistency_power")
    return script.driven(script.short_tour(estimator, seed))


def half_width(statistic, runs):
    """Of the band of the mean over `runs`."""
    sigmas = norm.isf(0.5 * FALSE_ALARM / (len(ESTIMATORS) * len(SPREAD)))
    return sigmas * SPREAD[statistic] / np.sqrt(runs)


def deviations(tours, rows):
    """Distance of each mean over runs from its expectation, in half widths of its band: within 1 is consistent."""
    return {
        name: (np.mean([row[name] for row in rows]) - expected) / half_width(name, len(rows))
        for name, expected in tours.EXPECTED.items()
    }


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_short_tours_are_consistent(tours, estimator):
    rows = [tours.statistics(driven(estimator, seed)[1]) for seed in SEEDS]
    found = deviations(tours, rows)
    assert max(map(abs, found.values())) < 1.0, found


@pytest.mark.parametrize("estimator", ESTIMATORS)
@pytest.mark.parametrize("sabotage", SHOWN_BY)
def test_the_band_excludes_short_tours_with_a_wrong_covariance(tours, estimator, sabotage):
    """A third of the runs suffice, and the mean leaves the band by more than its width."""
    rows = []
    for seed in SABOTAGED_SEEDS:
        wrong = tours.scaled(*tours.SABOTAGES[sabotage])
        run = tours.replayed(driven(estimator, seed)[0], tours.short_tour(estimator, seed), wrong)
        rows.append(tours.statistics(run))
    found = deviations(tours, rows)
    assert abs(found[SHOWN_BY[sabotage]]) > 2.0, found


def test_a_replay_of_the_recorded_ticks_is_the_run_itself(tours):
    ticks, own = driven("ekf-invariant", SEEDS[0])
    again = tours.replayed(ticks, tours.short_tour("ekf-invariant", SEEDS[0]))
    for one, other in zip(own, again, strict=True):
        np.testing.assert_array_equal(one, other)
