"""The laws of the contracts of `Extractor` and `FrontEnd`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from sixthsense.config import Config, preset
from sixthsense.config.parts import EXTRACTORS, FRONT_ENDS
from sixthsense.config.tree import make_part
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Command
from sixthsense.simulation.world import World
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import make_estimator
from sixthsense.slam.features import Extractor
from sixthsense.slam.features.extractor import features_fault
from sixthsense.slam.front_end import Evidence, Finished, FrontEnd, FrontEndSetup
from sixthsense.slam.motion_source import make_motion
from sixthsense.testing.laws import Laws, agree, at_most, equal

EXTRACTOR_LAWS, FRONT_END_LAWS = Laws(), Laws()

_CORNERS = np.array([(-3.1, -2.2), (3.7, -2.2), (3.7, 2.6), (0.9, 2.6), (0.9, 4.3), (-3.1, 4.3)])
_FREE_WALLS = np.array([[[-1.2, -2.2], [-1.2, -0.7]], [[1.9, 0.4], [1.9, 1.4]]])
ROOM = np.concatenate([np.stack([_CORNERS, np.roll(_CORNERS, -1, axis=0)], axis=1), _FREE_WALLS])
"""(8, 2, 2) a room with a nook, and two walls with free ends"""
_POINTS = np.concatenate([_CORNERS, [(-1.2, -0.7), (1.9, 0.4), (1.9, 1.4)]])
_POSES = [Pose(-2.1, -1.3, 0.4), Pose(0.6, -0.9, 2.2), Pose(-1.4, 1.7, -1.1), Pose(2.7, 1.9, 3.0)]
_START = Pose(-2.2, -0.1, 0.3)
_SCANS = 25
"""from each pose, with other noise each"""
_LARGEST = 25.0
"""squared Mahalanobis distance beyond which an observation is of nothing that is there"""
_DRIVES = 12
_FALSE_ALARM = 1e-3
"""probability with which a part that is right breaks a law of statistics"""


def extractor_of(part: Any, config: Config) -> Extractor:
    """An extractor by its name or its class."""
    options = config.features if part == "lines" else None
    made: Extractor = make_part(EXTRACTORS, part, config.assumed, options=options)
    return made


def _scan(pose: Pose, config: Config, rng: np.random.Generator) -> Scan:
    mount = Pose(*config.laser.mount)
    ranges = cast_rays(pose @ mount, beam_bearings(config.laser), ROOM, config.laser.max_range)
    return Scan.from_config(ranges + rng.normal(0.0, config.assumed.laser.range_m, len(ranges)), config.laser)


def _seen(part: Any) -> list[tuple[Pose, Observation]]:
    """What an extractor finds in all scans, with the robot's pose."""
    config = preset(laser={"mount": (0.15, -0.08, 0.5)})
    extractor, rng, found = extractor_of(part, config), np.random.default_rng(8), []
    for _ in range(_SCANS):
        for pose in _POSES:
            features = extractor.extract(_scan(pose, config, rng))
            assert not features_fault(features), features_fault(features)
            found += [(pose, observation) for observation in features.observations]
    return found


def _error(pose: Pose, observation: Observation) -> float:
    """Smallest squared Mahalanobis distance of an observation from what is there."""
    if observation.kind == Kind.WALL:
        places = np.array([_wall_from(pose, wall) for wall in ROOM])
    else:
        places = pose.inverse() @ _POINTS
    off = observation.z - places
    if observation.kind == Kind.WALL:
        off[:, 0] = wrap_angle(off[:, 0])
    return float(np.einsum("ni,ij,nj->n", off, np.linalg.inv(observation.cov), off).min())


def _wall_from(pose: Pose, wall: Array) -> Array:
    """(alpha, d) of a wall in the robot's frame; its normal points to the robot."""
    a, b = pose.inverse() @ wall
    normal = np.array([a[1] - b[1], b[0] - a[0]]) / np.linalg.norm(b - a)
    normal = normal if normal @ a <= 0.0 else -normal
    return np.array([np.arctan2(normal[1], normal[0]), normal @ a])


@EXTRACTOR_LAWS.law()
def what_is_observed_is_there(part: Any) -> None:
    errors = np.array([_error(*each) for each in _seen(part)])
    assert len(errors), "found no observation, allowed: some"
    at_most("share of observations of nothing that is there", float(np.mean(errors > _LARGEST)), 0.02)


@EXTRACTOR_LAWS.law()
def covariances_are_as_large_as_errors(part: Any) -> None:
    errors = np.array([_error(*each) for each in _seen(part)])
    errors = errors[errors <= _LARGEST]
    # Errors of one place are alike in all its scans, where walls are at the same angle: the band is that of the places.
    mean, places = (float(errors.mean()) if len(errors) else 2.0), 4 * len(_POSES)
    at_most("mean squared Mahalanobis distance", mean, chi2.isf(0.5 * _FALSE_ALARM, 2 * places) / places)


@EXTRACTOR_LAWS.law()
def an_empty_scan_has_no_observation(part: Any) -> None:
    config = preset()
    scan = Scan.from_config(np.full(config.laser.beams, np.inf), config.laser)
    found = extractor_of(part, config).extract(scan)
    assert not features_fault(found), features_fault(found)
    equal("observations", len(found.observations), 0)


@EXTRACTOR_LAWS.law()
def the_same_scans_give_the_same_observations_and_stay_as_they_are(part: Any) -> None:
    (one, other), scan = (_seen(part), _seen(part)), _scan(_POSES[0], preset(), np.random.default_rng(2))
    equal("number of observations", len(one), len(other))
    for (_, first), (_, second) in zip(one, other, strict=True):
        agree("z", first.z, second.z)
        agree("covariance", first.cov, second.cov)
    before = scan.ranges.copy()
    extractor_of(part, preset()).extract(scan)
    assert np.array_equal(scan.ranges, before, equal_nan=True), "found ranges of a scan that were written to"


class Driven(NamedTuple):
    """What a front end made of a drive."""

    faults: list[str]
    """what is wrong with its keyframes"""
    keyframes: int
    poses: Array
    """(T, 3) after each tick"""
    truths: Array
    """(T, 3)"""
    since_cov: Array
    """(3, 3) before the end"""
    trajectory: Array
    """(K, 3)"""
    finished: Finished


def front_end_of(part: Any, seed: int) -> tuple[FrontEnd, FrontEndSetup]:
    """A front end by its name or its class, with what it was made of."""
    config = preset(estimator="isam2", seed=seed)
    estimator = make_estimator("isam2", _START, np.zeros((3, 3)), config.isam2)
    setup = FrontEndSetup(config, estimator, _START, Associator(config.association), make_motion(config, estimator))
    return make_part(FRONT_ENDS, part, setup), setup


def _driven(part: Any, seed: int, count: int = 400) -> Driven:
    """A drive on an eight through the room."""
    front_end, setup = front_end_of(part, seed)
    config, motion, faults, keyframes = setup.config, setup.motion, list[str](), 0
    world = World(ROOM, _START, 0.15, config, np.random.default_rng(seed))
    tick = world.step(Command())
    poses, truths, last = list[Array](), list[Array](), None
    while tick is not None and len(poses) < count:
        increment = None
        if last is not None:
            increment = motion.increment(last.odometry, tick, config.robot.control_period_s, front_end.since.motion)
        before = None if tick.scan is None else tick.scan.ranges.copy()
        keyframe = front_end.take(Evidence(increment, tick.scan, tick.scan, {}))
        if before is not None and tick.scan is not None and not np.array_equal(before, tick.scan.ranges):
            faults.append("found ranges of a scan that were written to")
        if keyframe is not None:
            if keyframe.index != keyframes:
                faults.append(f"found a keyframe with index {keyframe.index}, allowed: {keyframes}")
            keyframes += 1
            motion.at_keyframe(None)
        poses.append(front_end.pose.array())
        truths.append((tick.truth or Pose()).array())
        last, tick = tick, world.step(Command(0.45, 0.5 if len(poses) < count // 2 else -0.45))
    since_cov, rows = front_end.since.cov, setup.estimator.trajectory()
    finished = front_end.finish()
    return Driven(faults, keyframes, np.array(poses), np.array(truths), since_cov, rows, finished)


@FRONT_END_LAWS.law()
def the_covariance_of_the_pose_is_as_large_as_its_errors(part: Any) -> None:
    total = 0.0
    for seed in range(_DRIVES):
        driven = _driven(part, seed)
        error = driven.finished.estimate.pose.array() - driven.truths[-1]
        error[2] = wrap_angle(error[2])
        total += float(error @ np.linalg.solve(driven.finished.estimate.pose_cov, error))
    at_most("mean NEES", total / _DRIVES, chi2.isf(_FALSE_ALARM, 3 * _DRIVES) / _DRIVES)


@FRONT_END_LAWS.law()
def keyframes_count_from_0_and_are_the_rows_of_the_trajectory(part: Any) -> None:
    driven = _driven(part, 1)
    assert not driven.faults, driven.faults[0]
    assert driven.keyframes > 0, "found no keyframe, allowed: some"
    equal("rows of the trajectory", len(driven.trajectory), driven.keyframes)


@FRONT_END_LAWS.law()
def the_pose_follows_the_robot(part: Any) -> None:
    driven = _driven(part, 2)
    at_most("distance from the truth, m", float(np.hypot(*(driven.poses - driven.truths)[:, :2].T).max()), 1.0)


@FRONT_END_LAWS.law()
def the_motion_since_the_last_keyframe_has_a_covariance(part: Any) -> None:
    cov = _driven(part, 3).since_cov
    equal("shape", cov.shape, (3, 3))
    agree("transpose", cov.T, cov, atol=1e-12)
    at_most("negative eigenvalue", -float(np.linalg.eigvalsh(cov)[0]), 1e-12)


@FRONT_END_LAWS.law()
def the_same_ticks_give_the_same_bits(part: Any) -> None:
    one, other = (_driven(part, 4) for _ in range(2))
    agree("trajectory", one.trajectory, other.trajectory)
    agree("pose_cov", one.finished.estimate.pose_cov, other.finished.estimate.pose_cov)
