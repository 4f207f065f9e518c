"""Landmarks: tours of scenes, generated worlds and plans; the landmark circle; MRCLAM."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from runs import Figures, Setting, chosen, data_path, replay, run
from worlds import plan, world

from sixthsense.config import preset
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.landmarks import LandmarkId
from sixthsense.evaluation.metrics import heading_rmse
from sixthsense.evaluation.true_identities import identify, landmark_identities, true_identities
from sixthsense.figures.run import Run
from sixthsense.logs.mrclam import read_mrclam
from sixthsense.logs.text_lines import read_table
from sixthsense.testing.circle import follow, simulate

TOUR_S, WORLD_S = 200.0, 80.0


def tour_figures(made: Run) -> Figures:
    """Outcome, errors and consistency of a run in a scene, and how many of its observations were matched wrongly."""
    trace = made.trace
    assert trace.scene is not None
    scene, truths = true_identities(trace.scene.walls), np.array(trace.key_truths)
    associations = [association.observations for association in trace.associations]
    known = landmark_identities(associations, truths, scene)
    wrong = sum(
        len(faces) == 1 and faces[0] != known.get(i, faces[0])
        for seen, truth in zip(associations, truths, strict=True)
        for i, faces in zip(seen, identify([*seen.values()], Pose.from_array(truth), scene), strict=True)
    )
    return chosen(made.metrics) | {"observations": sum(map(len, associations)), "wrong": wrong}


def tour(setting: Setting, seed: int) -> Figures:
    """A tour of a shipped scene, in closed loop with unknown association."""
    scene, estimator = setting
    return tour_figures(run(preset(scene=scene, estimator=estimator, task="tour", max_time=TOUR_S, seed=seed)))


def tour_of_world(setting: Setting, seed: int) -> Figures:
    """A tour of a generated world of a family, or of a plan."""
    kind, name = setting
    config = preset("default", estimator="ekf-invariant", task="tour", max_time=WORLD_S, seed=seed)
    scene = world(name if kind == "family" else plan(name), seed, WORLD_S, config.robot.speed)
    return tour_figures(run(config, scene))


def circle(setting: Setting, seed: int) -> Figures:
    """The landmark circle, 2,500 steps with known landmarks; the seed is the number of the run."""
    track = follow(setting[0], simulate(0, seed))
    return {
        "position_rmse_m": np.sqrt(np.mean(track.position_m**2)),
        "heading_rmse_deg": np.degrees(np.sqrt(np.mean(track.heading**2))),
        "nees": np.nanmean(track.nees3), "nees_heading": np.nanmean(track.nees_heading),
    }  # fmt: skip


def mrclam(setting: Setting, seed: int) -> Figures:
    """MRCLAM set 6, one robot, landmarks identified by barcodes, against Vicon; nothing is drawn."""
    assert seed == 0
    config, folder = preset("mrclam"), data_path("mrclam6")
    made = replay(read_mrclam(folder, config.assumed, int(setting[0])), config)
    table = read_table(folder / "Landmark_Groundtruth.dat", "subject x y sigma-x sigma-y").numbers
    trace, landmarks = made.trace, dict(zip(table[:, 0].astype(int).tolist(), table[:, 1:3], strict=True))
    truth, estimates = np.array(trace.truths), np.array(trace.estimates)
    figures = chosen(made.metrics) | {
        "per_axis_m": per_axis_rmse(estimates, truth), "heading_deg": math.degrees(heading_rmse(estimates, truth)),
        "misread": sum(association.discarded for association in trace.associations),
    }  # fmt: skip
    true = [k for k, i in enumerate(trace.final.ids.tolist()) if i in landmarks]
    ids = trace.final.ids[true].tolist()
    return figures | alignment(trace.final.landmarks[true], ids, landmarks, estimates, truth)


def alignment(
    found: Array, ids: list[LandmarkId], landmarks: Mapping[LandmarkId, Array], estimates: Array, truth: Array
) -> Figures:
    """How far the map (n, 2) is turned, and the error of poses (N, 3) after turning and moving it."""
    places = np.array([landmarks[i] for i in ids])
    ours, true = found - found.mean(axis=0), places - places.mean(axis=0)
    turn = math.atan2(float(np.sum(true[:, 0] * ours[:, 1] - true[:, 1] * ours[:, 0])), float(np.sum(true * ours)))
    aligned = (estimates[:, :2] - found.mean(axis=0)) @ rotation(turn) + places.mean(axis=0)
    return {"map_turn_deg": math.degrees(turn), "aligned_m": per_axis_rmse(aligned, truth)}


def per_axis_rmse(estimate: Array, truth: Array) -> float:
    """RMSE of the position along one axis, metres, of (N, 2) positions or (N, 3) poses."""
    return float(np.sqrt(np.mean(np.sum((estimate[:, :2] - truth[:, :2]) ** 2, axis=1)) / 2.0))
