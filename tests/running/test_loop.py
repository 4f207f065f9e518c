import itertools

import numpy as np
import pytest

from sixthsense.config import Config, KeyframeConfig, merge, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry
from sixthsense.core.source import Command, Tick
from sixthsense.evaluation.measure import measure
from sixthsense.loop.run import run
from sixthsense.record.trace import Trace
from sixthsense.simulation.world import World
from sixthsense.slam.front_end import is_due

ROOM = np.array([[[-2, -2], [2, -2]], [[2, -2], [2, 2]], [[2, 2], [-2, 2]], [[-2, 2], [-2, -2]]], dtype=np.float64)
ORIGIN = Pose()
SHORT = preset().replaced(scene="rectangle", task="tour", max_time=10.0)


def numbers(trace: Trace) -> list[Array]:
    """Everything that a run believed and did."""
    rows = [np.array(trace.truths), np.array(trace.estimates), np.array(trace.odometry), trace.trajectory]
    assert trace.grid is not None
    return [*rows, trace.joint_cov, trace.final.landmarks, *trace.plans, *trace.walls_found, trace.grid.hits]


def same(a: Trace, b: Trace) -> bool:
    pairs = itertools.zip_longest(numbers(a), numbers(b))
    return all(x is not None and y is not None and np.array_equal(x, y) for x, y in pairs)


def world(config: Config, seed: int = 0, start: Pose = ORIGIN) -> World:
    return World(ROOM, start, 0.2, config, np.random.default_rng(seed))


def ticks(source: World, commands: list[Command]) -> list[Tick]:
    out = [source.step(command) for command in commands]
    return [tick for tick in out if tick is not None]


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


ELSEWHERE = [
    {"features": {"split": {"epsilon_m": 0.2}, "landmarks": "both"}},
    {"association": {"match_gate": 20.0}, "keyframes": {"distance_m": 0.0, "turn_rad": 0.0}},
    {"assumed": {"motion": {"speed": 0.5}}, "grid": {"cell_m": 0.1}, "follow": {"distance_slack_m": 0.03}},
]


@pytest.mark.parametrize("changes", ELSEWHERE)
def test_what_is_changed_elsewhere_leaves_the_worlds_noise_alone(changes: dict[str, object]) -> None:
    rng = np.random.default_rng(5)
    commands = [
        Command(float(v), float(w)) for v, w in zip(rng.uniform(-0.3, 0.3, 100), rng.normal(0, 1, 100), strict=True)
    ]
    for base in (preset(), preset("worn")):
        for one, two in zip(ticks(world(base), commands), ticks(world(merge(base, changes)), commands), strict=True):
            assert one.truth == two.truth
            assert one.odometry == two.odometry
            if one.scan is not None:
                assert two.scan is not None
                assert np.array_equal(one.scan.ranges, two.scan.ranges)


def due(motion: Pose, distance_m: float = 0.25, turn_rad: float = 0.15) -> bool:
    return is_due(motion, Odometry(motion, np.zeros((3, 3))), KeyframeConfig(distance_m=distance_m, turn_rad=turn_rad))


@pytest.mark.parametrize(
    ("motion", "expected"),
    [
        (Pose(0.2, -0.149, 0.1), False),  # 0.2494 m
        (Pose(0.2, -0.151, 0.1), True),  # 0.2506 m
        (Pose(0.03, 0.02, -0.1499), False),
        (Pose(0.03, 0.02, -0.1501), True),
    ],
)
def test_a_keyframe_comes_after_enough_way_or_turn_since_the_last(motion: Pose, expected: bool) -> None:
    assert due(motion) is expected
