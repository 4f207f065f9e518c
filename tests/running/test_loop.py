import itertools

import numpy as np
import pytest

from sixthsense.config import merge, preset
from sixthsense.core.geometry import Array
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import run
from sixthsense.record.trace import Trace

SHORT = preset().replaced(scene="rectangle", task="tour", max_time=10.0)


def numbers(trace: Trace) -> list[Array]:
    """Everything that a run believed and did."""
    rows = [np.array(trace.truths), np.array(trace.estimates), np.array(trace.odometry), trace.trajectory]
    assert trace.grid is not None
    return [*rows, trace.joint_cov, trace.final.landmarks, *trace.plans, *trace.walls_found, trace.grid.hits]


def same(a: Trace, b: Trace) -> bool:
    pairs = itertools.zip_longest(numbers(a), numbers(b))
    return all(x is not None and y is not None and np.array_equal(x, y) for x, y in pairs)


@pytest.mark.parametrize("name", ["default", "worn"])
def test_one_configuration_gives_one_run_bit_for_bit(name: str) -> None:
    config = preset(name).replaced(scene="rectangle", task="tour", max_time=10.0)
    assert same(run(config), run(config))


@pytest.mark.parametrize("scene", ["rectangle", "block"])
def test_without_noise_the_estimate_is_the_truth(scene: str) -> None:
    trace = run(preset("noiseless", scene=scene, task="goal", features={"landmarks": "corners"}))
    values = measure(trace)
    assert values["outcome"] == "goal reached"
    assert values["ate_rmse_m"] < 0.02
    assert values["dead_reckoning_ate_rmse_m"] < 1e-9
    assert values["landmark_rmse_m"] < 0.02


def test_a_collision_ends_the_run_with_that_outcome() -> None:
    config = merge(SHORT, {"laser": {"max_range": 0.05}, "world": {"drift_rad_per_m": 1.0}})
    trace = run(config)
    assert trace.outcome == "collided"
    assert measure(trace)["collisions"] == 1
