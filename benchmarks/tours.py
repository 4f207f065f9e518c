"""Shared by the benchmarks of tours: what is measured of a tour, and short drives by given commands."""

from __future__ import annotations

import numpy as np
from harness import Figures
from matches import judge_matches
from repetition_scenes import out_and_back

from sixthsense.config import Config
from sixthsense.config.sections import DEFAULT_ROBOT_RADIUS_M
from sixthsense.core.geometry import Pose
from sixthsense.core.random_streams import random_streams
from sixthsense.core.source import Command
from sixthsense.evaluation.metrics import full_rank_from, nees_world
from sixthsense.evaluation.true_identities import TrueLaser, true_identities
from sixthsense.figures.run import Run
from sixthsense.simulation.scene import load_scene
from sixthsense.simulation.world import World
from sixthsense.slam.slam import Slam

METRICS = {
    "outcome": "outcome", "collisions": "collisions", "nees": "pose_nees_world_mean", "nis": "nis_mean_per_dof",
    "landmark_nees": "landmark_nees_mean", "discarded_share": "discarded_share", "ate_m": "ate_rmse_m",
}  # fmt: skip
"""figure by figure, the metric that it is"""
TURNING_S, CORRIDOR_M = 20.0, 6.0
"""of short drives: time of turning to and fro, and way along a corridor"""


def tour_figures(made: Run) -> Figures:
    """Outcome, errors and consistency of a run in a scene, and how many of its observations were matched wrongly."""
    trace, metrics = made.trace, made.metrics
    assert trace.scene is not None
    laser = TrueLaser(trace.config.laser, trace.config.assumed.laser)
    scene, truths = true_identities(trace.scene.walls), np.array(trace.key_truths)
    matches = judge_matches([a.observations for a in trace.associations], truths, scene, laser)
    figures = {name: metrics[key] for name, key in METRICS.items() if key in metrics}
    return figures | {"observations": matches.observations, "wrong": len(matches.wrong)}


def short_drive(where: str, config: Config) -> float:
    """Mean NEES over the keyframes of a drive of some seconds by given commands.

    `standing` turns to and fro at the start of `apartment`, since a robot without any motion gets no keyframe.
    `corridor` drives straight along a corridor with few doors, drawn by the seed as the place in it.
    """
    robot, rng = config.robot, np.random.default_rng(config.seed)
    if where == "standing":
        scene = load_scene("apartment")
        assert scene.start is not None
        walls, start = scene.walls, scene.start
        phases = np.arange(0.0, TURNING_S, robot.control_period_s) % 4.0  # a second left, two right, a second left
        commands = [Command(turn_rate=robot.turn_rate * (-1.0 if 1.0 <= phase < 3.0 else 1.0)) for phase in phases]
    else:
        walls, ((near, middle), (far, _), *_) = out_and_back(rng)
        start = Pose(rng.uniform(near + CORRIDOR_M, far - 2.0 * CORRIDOR_M), middle)
        commands = [Command(robot.speed)] * round(CORRIDOR_M / robot.speed / robot.control_period_s)
    world = World(walls, start, DEFAULT_ROBOT_RADIUS_M, config, random_streams(config.seed).world)
    errors, covs = [], []
    with Slam(config, start) as slam:
        for command in commands:
            tick = world.step(command)
            if tick is None or tick.truth is None:
                raise RuntimeError(f"{where}, seed {config.seed}: found a collision, allowed: a free way")
            if (keyframe := slam.take(tick).keyframe) is not None:
                errors.append(keyframe.estimate.pose.array() - tick.truth.array())
                covs.append(keyframe.estimate.pose_cov)
    first = full_rank_from(np.array(covs))
    return float(nees_world(np.array(errors)[first:], np.array(covs)[first:]).mean())
