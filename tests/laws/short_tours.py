"""Short tours of the whole pipeline, replayed with a covariance that is wrong or from a start that is uncertain.

Each tour begins at a place of the scene's tour, at a heading drawn from the seed, and is driven in closed loop. Its
ticks can be replayed through `Slam` with one covariance scaled: that of every observation, or that of the odometry. A
run gives three statistics:

nees        pose NEES after the update (3 is consistent), mean over the keyframes
nis         NIS of all matches before the update, per degree of freedom (1)
increment   NEES of the motion from an update to the next prediction (3), by the covariance that the prediction adds,
            mean over the keyframes

Successive poses share the errors of the map, so the keyframes of a run are not independent samples; runs are. The band
of a mean over runs is the expectation plus and minus standard errors, from the spread between runs.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from functools import partial
from typing import NamedTuple
from unittest import mock

import numpy as np

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import Scan
from sixthsense.core.motion import Odometry, compose_jacobians
from sixthsense.core.source import Tick
from sixthsense.evaluation.metrics import full_rank_from, nees_world
from sixthsense.loop.run import run
from sixthsense.record.trace import Trace
from sixthsense.simulation.scene import load_scene
from sixthsense.slam.estimators import motion_source
from sixthsense.slam.features import Features, extraction
from sixthsense.slam.slam import Slam

SCENES = ("apartment", "office")
SECONDS = 20.0

EXPECTED = {"nees": 3.0, "nis": 1.0, "increment": 3.0}
"""of each statistic, for a consistent estimator"""


class Keyframes(NamedTuple):
    """What the statistics of a run are computed from, a row per keyframe."""

    truths: Array
    """(K, 3) true pose"""
    poses: Array
    """(K, 3) after the update"""
    covs: Array
    """(K, 3, 3) of these, world frame"""
    predicted: Array
    """(K, 3) before the update"""
    predicted_covs: Array
    """(K, 3, 3)"""
    nis: Array
    """(K, 2) of all matches, and its degrees of freedom"""


def short_tour(estimator: str, seed: int, seconds: float = SECONDS) -> Config:
    """The configuration of a short tour: scenes in turn, place and heading of the start drawn from the seed."""
    scene = SCENES[seed % len(SCENES)]
    rng = np.random.default_rng(seed)
    tour = load_scene(scene).tour
    x, y = tour[int(rng.integers(len(tour)))]
    start = (x, y, float(rng.uniform(-math.pi, math.pi)))
    return preset(scene=scene, estimator=estimator, task="tour", max_time=seconds, seed=seed, start=start)


def driven(config: Config) -> tuple[list[Tick], Keyframes]:
    """Drive a tour in closed loop; returns its ticks and its keyframes."""
    ticks: list[Tick] = []
    trace = run(config, on_tick=lambda tick, _: ticks.append(tick))
    return ticks, of_trace(trace)


def of_trace(trace: Trace) -> Keyframes:
    """The keyframes of a record."""
    return Keyframes(
        np.array(trace.key_truths),
        np.array([e.pose.array() for e in trace.key_estimates]),
        np.array([e.pose_cov for e in trace.key_estimates]),
        np.array([e.pose.array() for e in trace.key_predicted]),
        np.array([e.pose_cov for e in trace.key_predicted]),
        np.array([(a.nis, a.dof) for a in trace.associations]),
    )


def replayed(
    ticks: Sequence[Tick],
    config: Config,
    sabotage: AbstractContextManager[object] | None = None,
    start: Pose | None = None,
    start_cov: Array | None = None,
) -> Keyframes:
    """The keyframes of recorded ticks, processed by a new `Slam` within `sabotage`; it starts at the truth by default.

    `start_cov` (3, 3) is the covariance that `Slam` assumes of `start`, exactly known by default.
    """
    rows: list[tuple[object, ...]] = []
    with sabotage or nullcontext(), Slam(config, start or ticks[0].truth, start_cov=start_cov) as slam:
        for tick in ticks:
            keyframe = slam.take(tick).keyframe
            if keyframe is not None and tick.truth is not None:
                estimate, predicted, a = keyframe.estimate, keyframe.predicted, keyframe.association
                rows.append((tick.truth.array(), estimate.pose.array(), estimate.pose_cov, predicted.pose.array(),
                             predicted.pose_cov, (a.nis, a.dof)))  # fmt: skip
    return Keyframes(*(np.array(column) for column in zip(*rows, strict=True)))


def scaled(what: str, factor: float) -> AbstractContextManager[object]:
    """A context in which `Slam` scales the covariance of all "observations", or that of the "odometry", by `factor`."""
    if what == "observations":
        return mock.patch.object(extraction, "extract", partial(_scaled_observations, extraction.extract, factor))
    measured = partial(_scaled_odometry, motion_source.odometry_of_noise, factor)
    return mock.patch.object(motion_source, "odometry_of_noise", measured)


def _scaled_observations(extract: Callable[..., Features], factor: float, scan: Scan, *rest: object) -> Features:
    features = extract(scan, *rest)
    observations = tuple(dataclasses.replace(s, cov=factor * s.cov) for s in features.observations)
    return dataclasses.replace(features, observations=observations)


def _scaled_odometry(odometry: Callable[..., Odometry], factor: float, *arguments_: object) -> Odometry:
    increment = odometry(*arguments_)
    return Odometry(increment.motion, factor * increment.cov)


def statistics(run: Keyframes) -> dict[str, float]:
    """The statistics of one run, by the names of `EXPECTED`."""
    first = full_rank_from(run.covs)
    error = run.poses - run.truths
    nis, dof = run.nis.sum(axis=0)
    return {
        "nees": float(nees_world(error[first:], run.covs[first:]).mean()),
        "nis": float(nis / dof),
        "increment": float(increment_nees(run).mean()),
    }


def increment_nees(run: Keyframes) -> Array:
    """(K - 1,) NEES of the motion from each update to the next prediction, in the frame of its end."""
    error, cov = np.empty((len(run.poses) - 1, 3)), np.empty((len(run.poses) - 1, 3, 3))
    for k in range(len(error)):
        pose = Pose.from_array(run.poses[k])
        motion = pose.inverse() @ Pose.from_array(run.predicted[k + 1])
        truly = Pose.from_array(run.truths[k]).inverse() @ Pose.from_array(run.truths[k + 1])
        error[k] = (truly.inverse() @ motion).array()
        by_pose, by_motion = compose_jacobians(pose.theta, motion)
        added = run.predicted_covs[k + 1] - by_pose @ run.covs[k] @ by_pose.T
        cov[k] = by_motion.T @ added @ by_motion  # a rotation: its inverse is its transpose
    return nees_world(error, cov)
