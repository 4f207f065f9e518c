"""Runs that begin with the map of an earlier run: from a known pose and from a rough one, and what is refused."""

import dataclasses
import math

import numpy as np
import pytest
from laws.nees import assert_consistent, error_of, normalised

from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Pose
from sixthsense.evaluation.measure import measure
from sixthsense.loop import run as loop
from sixthsense.record.folder import RunFolder
from sixthsense.record.store import read_prior_map
from sixthsense.simulation.scene import load_scene
from sixthsense.slam.prior_map import KeyScans, PriorStart

SECONDS = 20.0
ROOM = np.array([[0.0, 0.0], [5.0, 0.0], [5.0, 4.0], [3.0, 4.0], [3.0, 3.0], [0.0, 3.0]])
"""a room that looks like itself from no other side"""
DIVIDER = np.array([[1.8, 1.0], [1.8, 2.0]])


def scene_of(*segments, corners=ROOM):
    outline = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    walls = np.concatenate([outline, *(np.reshape(s, (1, 2, 2)) for s in segments)])
    base = load_scene("rectangle")
    tour = ((4.2, 0.8), (4.2, 3.2), (2.6, 2.4), (0.8, 2.2), (0.8, 0.8))
    return dataclasses.replace(base, walls=walls, start=Pose(0.8, 0.8, 0.3), tour=tour, region=(0.0, 0.0, 5.0, 4.0))


def config_of(seed, estimator="ekf-invariant", **fields):
    own = {"scene": "rectangle", "task": "tour", "max_time": SECONDS}
    return preset(**{**own, "seed": seed, "estimator": estimator, **fields})


def driven(scene, seed, folder=None, prior=None, **fields):
    config = config_of(seed, **fields)
    out = None if folder is None else RunFolder(folder, config)
    trace = loop.run(config, None if out is None else out.record, scene, prior)
    if out is not None:
        out.write(trace, measure(trace))
        out.finish()
    return trace


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """The folder of a run in the room with the divider."""
    folder = tmp_path_factory.mktemp("runs") / "first"
    driven(scene_of(DIVIDER), 1, folder)
    return folder


def walls_at(trace, alpha_is_x, at):
    """Ids of walls that lie on x = `at` or y = `at`."""
    final = trace.final
    found = []
    for i, (alpha, d), wall in zip(final.ids.tolist(), final.landmarks.tolist(), final.walls.tolist(), strict=True):
        across = abs(math.cos(alpha)) if alpha_is_x else abs(math.sin(alpha))
        if wall and across > 0.99 and abs(abs(d) - at) < 0.1:
            found.append(i)
    return found


def test_landmarks_keep_their_ids_and_become_more_certain(first):
    prior = read_prior_map(first)
    trace = driven(scene_of(DIVIDER), 2, prior=PriorStart(prior))
    before = dict(zip(prior.landmarks.ids.tolist(), np.diag(prior.landmarks.cov).reshape(-1, 2), strict=True))
    after = dict(zip(trace.final.ids.tolist(), np.diag(trace.joint_cov)[3:].reshape(-1, 2), strict=True))
    both = sorted(set(before) & set(after))
    assert len(both) >= 0.8 * len(before) and len(after) <= len(before) + 3
    shrunk = [np.prod(after[i]) < np.prod(before[i]) for i in both]
    assert np.mean(shrunk) > 0.9
    assert measure(trace)["pose_nees_world_mean"] < 8.0


def test_the_map_at_the_end_holds_what_the_run_before_has_seen(first):
    trace = driven(scene_of(DIVIDER), 2, prior=PriorStart(read_prior_map(first)), max_time=2.0)
    earlier = read_prior_map(first).evidence
    assert trace.grid is not None
    seen = trace.grid.submap()
    places = set(map(tuple, seen.cells[seen.seen].tolist()))
    assert set(map(tuple, earlier.cells[earlier.seen].tolist())) <= places


def test_a_wall_that_was_removed_is_unlearnt_and_one_that_is_new_is_learnt(first, tmp_path):
    moved = DIVIDER + np.array([1.6, 0.0])
    prior = PriorStart(read_prior_map(first))
    kept = driven(scene_of(DIVIDER), 3, prior=prior)
    assert walls_at(kept, True, 1.8)
    trace = driven(scene_of(moved), 3, prior=prior)
    assert not walls_at(trace, True, 1.8) and walls_at(trace, True, 3.4)
    obstacles, origin = trace.grid.obstacles, np.array(trace.grid.origin)
    for x, is_there in ((1.8, False), (3.4, True)):
        cells = np.floor((np.array([[x, y] for y in np.arange(1.2, 1.8, 0.05)]) - origin) / 0.05).astype(int)
        near = [obstacles[r, c - 1 : c + 2].any() for c, r in cells]
        assert np.mean(near) > 0.9 if is_there else not any(near)


def test_a_run_that_begins_with_a_map_can_be_the_map_of_the_next(first, tmp_path):
    second = driven(scene_of(DIVIDER), 2, tmp_path / "second", PriorStart(read_prior_map(first)))
    prior = read_prior_map(tmp_path / "second")
    assert prior.landmarks.ids.tolist() == second.final.ids.tolist()
    third = driven(scene_of(DIVIDER), 3, prior=PriorStart(prior))
    assert third.prior_map["name"] == "second" and third.prior_map["digest"] == prior.digest


def test_from_rough_poses_drawn_from_their_sigmas_pose_and_first_keyframe_are_consistent(first):
    prior, sigma, nees = read_prior_map(first), (0.25, 0.25, 0.15), []
    scene = scene_of(DIVIDER)
    for seed in range(12):
        error = np.array(sigma) * np.random.default_rng(seed).standard_normal(3)
        pose = Pose.from_array(scene.start.array() + error)
        trace = driven(scene, 50 + seed, prior=PriorStart(prior, pose, sigma), max_time=3.0)
        off = error_of(trace.key_estimates[0], Pose.from_array(trace.key_truths[0]))
        nees.append(normalised(off, trace.key_estimates[0].pose_cov))
        assert np.hypot(*off[:2]) < 0.05
    assert_consistent(nees, 3, confidence=0.999)


def test_a_map_of_another_building_is_refused_at_the_first_scan(first):
    other = scene_of(corners=np.array([[-3.0, -3.0], [9.0, -3.0], [9.0, 7.5], [-3.0, 7.5]]))
    for sigma in ((0.0, 0.0, 0.0), (0.2, 0.2, 0.1)):
        with pytest.raises(InputError, match=r"^prior_map: found first, of which the first scan shows \d+ %, allowed"):
            driven(other, 1, prior=PriorStart(read_prior_map(first), None, sigma))


def test_a_place_that_looks_like_another_one_is_refused(explored, tmp_path):
    """The empty rectangle is the same after half a turn."""
    folder = RunFolder(tmp_path / "rectangle", explored.trace.config)
    folder.write(explored.trace, explored.metrics)
    folder.finish()
    scan = explored.trace
    scans = KeyScans.of(scan.key_scans, scan.trajectory)
    known = dataclasses.replace(read_prior_map(tmp_path / "rectangle"), scans=scans)
    prior = PriorStart(known, Pose(0.0, 0.0, 0.5 * math.pi), (1.0, 0.5, 2.0))
    with pytest.raises(InputError, match="two places of rectangle that the first scan fits"):
        loop.run(scan.config, prior=prior)
