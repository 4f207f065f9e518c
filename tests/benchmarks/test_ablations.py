import importlib
import json
import math
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from sixthsense.config import merge, preset
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.metrics import true_landmarks
from sixthsense.sources.scene import load_scene

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"
ROOM = np.array([[-2.0, -1.5], [2.0, -1.5], [2.0, 1.5], [-2.0, 1.5]])
WALLS = np.stack([ROOM, np.roll(ROOM, -1, axis=0)], axis=1)


@pytest.fixture
def ablations(monkeypatch) -> ModuleType:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return importlib.import_module("ablations")


def visible(ablations: ModuleType, pose: Pose, walls: np.ndarray, **laser: object) -> int:
    return len(ablations.visible_landmarks(pose, true_landmarks(walls), walls, preset(laser=laser).laser))


def test_all_corners_of_an_empty_room_are_visible_from_anywhere_in_it(ablations) -> None:
    rng = np.random.default_rng(0)
    for x, y, theta in rng.uniform((-0.3, -0.3, -3.0), (0.3, 0.3, 3.0), (50, 3)):
        assert visible(ablations, Pose(x, y, theta), WALLS) == 4


def test_a_screen_hides_landmarks_behind_it_and_its_ends_are_visible(ablations) -> None:
    screen = np.concatenate([WALLS, [[[1.0, -1.0], [1.0, 1.0]]]])
    assert visible(ablations, Pose(0.5, 0.0, 0.0), screen) == 2 + 2


def test_landmarks_behind_the_robot_or_far_away_are_not_visible(ablations) -> None:
    assert visible(ablations, Pose(0.0, 0.0, 0.0), WALLS, fov=math.pi) == 2
    assert visible(ablations, Pose(0.0, 0.0, 0.0), 2.0 * WALLS) == 0


def test_a_perfect_scan_of_a_room_has_no_false_and_no_missed_landmark(ablations) -> None:
    tour = {"task": "tour", "tour": ((0.5, 0.0), (0.0, 0.0))}
    config = preset("noiseless", scene="rectangle", max_time=3.0, features={"landmarks": "corners"}, **tour)
    _, views = ablations.collect(config)
    figures = ablations.detection_figures(views, load_scene("rectangle").walls, config)
    assert len(views) == 4
    assert figures["false_per_scan"] == 0.0
    assert figures["missed_per_scan"] < figures["visible_per_scan"]
    assert figures["observation_rmse_mm"] < 20.0 and figures["wall_rmse_mm"] < 1.0


def test_a_landmark_without_a_true_one_is_false_and_an_unseen_one_is_missed(ablations) -> None:
    config = preset("noiseless", scene="rectangle", max_time=3.0, features={"landmarks": "corners"})
    _, views = ablations.collect(config)
    far = load_scene("rectangle").walls + 50.0
    seen = ablations.detection_figures(views, far, config)
    assert seen["false_per_scan"] > 1.0 and seen["observation_rmse_mm"] == 0.0
    blind = merge(config, {"features": {"points": {"corners": False, "ends": False}}})
    missed = ablations.detection_figures(views, load_scene("rectangle").walls, blind)
    assert missed["missed_per_scan"] == missed["visible_per_scan"] > 0.0


def test_every_switch_has_figures_and_a_row_and_every_claim_a_sentence(ablations) -> None:
    figures = ablations.ablation_figures("default", 1, "rectangle", 4.0)
    assert all(math.isfinite(value) for value in figures.values())
    json.dumps(figures)
    for switch in ablations.SWITCHES:
        cells = ablations.row("default", switch, figures)
        assert cells[:2] == [f"default.{switch}", "1 out of time"]
        assert len(cells) == 2 + len(ablations.COLUMNS)
    for claim in ablations.CLAIMS:
        line = ablations.sentence("default", claim, figures)
        assert line.startswith(f"default: {claim.text}: ")
        assert ("holds" in line) != ("does not hold" in line)


def test_every_switch_changes_a_setting_of_every_preset(ablations) -> None:
    for name in ablations.PRESETS:
        base = preset(name)
        for switch, changes in ablations.SWITCHES.items():
            assert (merge(base, changes) == base) == (switch == ablations.BASELINE)
    assert {claim.switch for claim in ablations.CLAIMS} == set(ablations.SWITCHES) - {ablations.BASELINE}
