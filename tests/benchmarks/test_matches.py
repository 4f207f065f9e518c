"""Matches of observations judged by the truth, where they can be of the wrong wall, or of two."""

import importlib
from pathlib import Path

import numpy as np
import pytest
from evaluation import test_true_identities as made
from evaluation.test_true_identities import BELOW, COV, SCENE, between, wall

from sixthsense.config import LaserConfig
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.true_identities import TrueLaser, true_identities


@pytest.fixture
def judged(monkeypatch):
    monkeypatch.syspath_prepend(str(Path(__file__).resolve().parents[2] / "benchmarks"))
    matches = importlib.import_module("matches")

    def judge(scans, poses, scene=SCENE):
        return matches.judge_matches(scans, np.array([pose.array() for pose in poses]), scene, made.LASER)

    return judge


def test_a_match_of_a_parallel_face_five_centimetres_away_is_wrong_whatever_covariance_it_states(judged):
    step = np.array([[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.05], [4.0, 0.05]]])
    scene, pose = true_identities(step), Pose(2.0, 1.5, -1.0)
    first = wall(pose, between([0.2, 0.0], [1.9, 0.0], 30))
    places = between([2.1, 0.05], [3.8, 0.05], 30)
    for scale in (1.0, 1e2, 1e4):
        found = judged([{0: first}, {0: wall(pose, places, COV * scale)}], [pose, pose], scene)
        assert found.wrong == ((1, 0),)
        assert found.left_out == ()


def test_an_observation_over_two_faces_spans_and_is_not_right_whatever_covariance_it_states(judged):
    step = np.array([[[0.0, 0.0], [2.0, 0.0]], [[2.0, 0.05], [4.0, 0.05]]])
    scene, pose = true_identities(step), Pose(2.0, 1.5, -1.0)
    both = np.concatenate([between([0.5, 0.0], [2.0, 0.0], 20), between([2.0, 0.05], [3.5, 0.05], 20)])
    one = wall(pose, between([0.5, 0.0], [1.9, 0.0], 20))
    found = judged([{0: wall(pose, both, COV * 1e4)}, {0: one}, {0: wall(pose, both)}], [pose] * 3, scene)
    assert found.spanning == ((0, 0), (2, 0))
    assert found.wrong == ()


@pytest.mark.parametrize("mount", [made.MOUNT, (1.6, -1.2, 0.7)])
def test_an_observation_over_a_bend_spans_unless_its_fit_is_too_short_to_show_it(judged, mount, monkeypatch):
    monkeypatch.setattr(made, "MOUNT", mount)
    monkeypatch.setattr(made, "LASER", TrueLaser(LaserConfig(mount=mount), made.LASER.noise))
    turn = np.deg2rad(1.4)
    tip = np.array([3.0, 0.0]) + 3.0 * np.array([np.cos(turn), np.sin(turn)])
    scene, pose = true_identities(np.array([[[0.0, 0.0], [3.0, 0.0]], [[3.0, 0.0], tip]])), Pose(3.0, 2.0, 0.3)
    assert len(scene.lines) == 2
    long = np.concatenate([between([0.2, 0.0], [3.0, 0.0], 40), between([3.0, 0.0], tip, 40)])
    near = np.array([3.0, 0.0]) + 0.3 * (tip - [3.0, 0.0]) / 3.0
    short = np.concatenate([between([2.7, 0.0], [3.0, 0.0], 5), between([3.0, 0.0], near, 5)])
    found = judged([{0: wall(pose, long)}, {0: wall(pose, short)}], [pose] * 2, scene)
    assert found.spanning == ((0, 0),) and found.left_out == ((1, 0),)
    beyond, before = wall(pose, between([3.0, 0.0], near, 8)), wall(pose, between([2.7, 0.0], [3.0, 0.0], 8))
    found = judged([{0: before}, {0: beyond}], [pose] * 2, scene)
    assert found.wrong == ()
    assert found.left_out == ((1, 0),)


def test_an_observation_of_another_wall_is_a_wrong_match(judged):
    thin, floor = (wall(BELOW, between(*ends, 20)) for ends in (([1, 1.5], [2, 1.5]), ([1, 0], [2, 0])))
    found = judged([{7: thin, 8: floor}, {7: thin}, {7: floor, 8: thin}, {7: floor}], [BELOW] * 4)
    assert found.observations == 6
    assert found.wrong == ((2, 7), (2, 8), (3, 7))
    assert found.unexplained == found.spanning == found.left_out == ()
