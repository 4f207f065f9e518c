"""The way by nearest frontiers, against ways that can be told by hand."""

import dataclasses
import importlib
import math
from pathlib import Path

import numpy as np
import pytest

from sixthsense.config import preset

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
CORRIDOR = """
region = [0.0, 0.0, 20.0, 2.0]
start = [1.0, 1.0, 0.0]
radius = 0.2

[[polygons]]
points = [[0.0, 0.0], [20.0, 0.0], [20.0, 2.0], [0.0, 2.0]]
"""


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("explored_worlds")


def test_along_a_corridor_the_robot_drives_until_the_end_is_within_range_and_back(script, tmp_path):
    scene = tmp_path / "corridor.toml"
    scene.write_text(CORRIDOR)
    config = dataclasses.replace(preset("default", scene=str(scene), laser={"max_range": 6.0}))
    there = math.sqrt(6.0**2 - 0.9**2)  # how far ahead the corners come into range
    assert script.nearest_frontier_travel(config, 1.0) == pytest.approx(2 * (19.0 - there), abs=0.8)
    assert script.nearest_frontier_travel(config, 0.3) < 0.5


def test_what_the_start_shows_needs_no_travel(script):
    assert script.nearest_frontier_travel(preset("default", scene="rectangle"), 0.99) == 0.0


def test_runs_without_a_way_to_compare_with_are_left_out(script):
    rows = [{"travel_m": 6.0, "reference_m": r} for r in (3.0, 0.0, math.nan)]
    assert script.over_reference(rows) == [2.0]
    assert np.isnan(script.summary([{key: 1.0 for key in (
        "nees", "outcome", "collisions", "coverage", "slow", "sim_s", "processor_s", "left_m2", "ate_m", "home_m",
        "keyframe_ms_p99", "memory_mb")} | rows[1]])["ratio"])  # fmt: skip
