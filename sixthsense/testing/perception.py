"""The laws of the contracts of `Extractor`, `FrontEnd` and `PlaceSearch`."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.stats import chi2

from sixthsense.config import Config, preset
from sixthsense.config.parts import EXTRACTORS, FRONT_ENDS, PLACE_SEARCHES
from sixthsense.config.tree import make_part
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import Kind, Observation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.se2 import between
from sixthsense.core.source import Command
from sixthsense.simulation.world import World
from sixthsense.slam.association.associator import Associator
from sixthsense.slam.estimators import Estimate, make_estimator
from sixthsense.slam.estimators.motion_source import make_motion
from sixthsense.slam.features import Extractor
from sixthsense.slam.features.extractor import check_features
from sixthsense.slam.front_end import Evidence, FrontEnd, FrontEndSetup
from sixthsense.slam.scans.graph import PlacedScans
from sixthsense.slam.scans.known_places import KnownPlaces
from sixthsense.slam.scans.place_search import Candidate, ExpectedPoses, PlaceQuery, is_same_place
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.testing.laws import Laws, agree, at_most, equal

EXTRACTOR_LAWS, FRONT_END_LAWS, PLACE_LAWS = Laws(), Laws(), Laws()

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
    made: Extractor = make_part(EXTRACTORS, part, config.assumed, options=config.features if part == "lines" else None)
    return made


def _scan(pose: Pose, config: Config, rng: np.random.Generator) -> Scan:
    ranges = cast_rays(pose @ Pose(*config.laser.mount), beam_bearings(config.laser), ROOM, config.laser.max_range)
    return Scan.from_config(ranges + rng.normal(0.0, config.assumed.laser.range_m, len(ranges)), config.laser)


def _seen(part: Any) -> list[tuple[Pose, Observation]]:
    """What an extractor finds in all scans, with the robot's pose."""
    config = preset(laser={"mount": (0.15, -0.08, 0.5)})
    extractor, rng, found = extractor_of(part, config), np.random.default_rng(8), []
    for _ in range(_SCANS):
        for pose in _POSES:
            features = extractor.extract(_scan(pose, config, rng))
            check_features("extractor", features)
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
    check_features("extractor", found)
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

    has_written: bool
    """whether it has changed the ranges of a scan"""
    indices: list[int]
    """of its keyframes"""
    truth: Array
    """(3,) pose at the end"""
    since_cov: Array
    """(3, 3) before the end"""
    trajectory: Array
    """(K, 3)"""
    final: Estimate


def front_end_of(part: Any, seed: int) -> tuple[FrontEnd, FrontEndSetup]:
    """A front end by its name or its class, with what it was made of."""
    config = preset(estimator="isam2", seed=seed)
    estimator = make_estimator("isam2", _START, np.zeros((3, 3)), config.isam2)
    setup = FrontEndSetup(config, estimator, _START, Associator(config.association), make_motion(config, estimator))
    return make_part(FRONT_ENDS, part, setup), setup


def _driven(part: Any, seed: int, count: int = 400) -> Driven:
    """A drive on an eight through the room."""
    front_end, setup = front_end_of(part, seed)
    period_s, motion, has_written, indices = setup.config.robot.control_period_s, setup.motion, False, list[int]()
    world, last, truth = World(ROOM, _START, 0.15, setup.config, np.random.default_rng(seed)), None, _START.array()
    for k in range(count):
        tick = world.step(Command(0.45, 0.5 if k < count // 2 else -0.45))
        assert tick is not None
        increment = last and motion.increment(last.odometry, tick, period_s)
        before = None if tick.scan is None else tick.scan.ranges.copy()
        keyframe = front_end.take(Evidence(increment, tick.scan, tick.scan, {}))
        if before is not None and tick.scan is not None:
            has_written |= not np.array_equal(before, tick.scan.ranges)
        if keyframe is not None:
            indices.append(keyframe.index)
            motion.at_keyframe(None)
        last, truth = tick, (tick.truth or Pose()).array()
    since_cov, rows = front_end.since.cov, setup.estimator.trajectory()
    return Driven(has_written, indices, truth, since_cov, rows, front_end.finish().estimate)


@FRONT_END_LAWS.law()
def the_covariance_of_the_pose_is_as_large_as_its_errors(part: Any) -> None:
    total = 0.0
    for seed in range(_DRIVES):
        driven = _driven(part, seed)
        error = driven.final.pose.array() - driven.truth
        error[2] = wrap_angle(error[2])
        total += float(error @ np.linalg.solve(driven.final.pose_cov, error))
    at_most("mean NEES", total / _DRIVES, chi2.isf(_FALSE_ALARM, 3 * _DRIVES) / _DRIVES)


@FRONT_END_LAWS.law()
def keyframes_count_from_0_and_are_the_rows_of_the_trajectory(part: Any) -> None:
    driven = _driven(part, 1)
    assert not driven.has_written, "found ranges of a scan that were written to"
    assert driven.indices, "found no keyframe, allowed: some"
    equal("indices of the keyframes", driven.indices, [*range(len(driven.trajectory))])


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
    agree("pose_cov", one.final.pose_cov, other.final.pose_cov)


_ROOMS = {0: (0.0, np.zeros(2), 1.0), 1: (1.2, np.array([24.0, 7.0]), 1.35), 2: (-0.6, np.array([-5.0, 31.0]), 0.8)}
"""turn, place and size of each of three rooms of one kind"""
_WAY = [Pose(-2.1, -1.3, 0.4), Pose(-1.9, 0.6, 1.3), Pose(-1.2, 2.4, 0.9), Pose(0.2, 1.1, -0.8), Pose(2.6, 0.2, 0.3)]
_AGAIN = [Pose(-1.7, -0.9, 1.9), Pose(-0.4, 1.6, -0.4), Pose(2.2, -0.7, 2.6)]
_OFF = np.array([0.15, -0.1, 0.03])
"""error of where the scan is expected, and"""
_SIGMA_M, _SIGMA_RAD = 0.4, 0.1


class Rooms(PlacedScans):
    """Scans with a laser at known poses in three rooms, each of which is a place, and one that was taken again."""

    def __init__(self, room: int, again: Pose) -> None:
        config, rng = preset("log"), np.random.default_rng(11)
        super().__init__(ScanStore(config.scans.max_range_m))
        rows = [(number, pose) for number in _ROOMS for pose in _WAY]
        for number, pose in (*rows, (room, again)):  # the newest scan is the last row
            turn, origin, size = _ROOMS[number]
            at = Pose.from_array(np.append(rotation(turn) @ (size * pose.position) + origin, pose.theta + turn))
            walls = ROOM * size @ rotation(turn).T + origin
            ranges = cast_rays(at, beam_bearings(config.laser), walls, config.laser.max_range)
            self.store.put(Scan.from_config(ranges + rng.normal(0.0, 0.01, len(ranges)), config.laser))
            self.store.keep()
            self.add(at.array())
        self.key = len(rows)
        # Rooms are so far apart on the way that each is a place of its own.
        way_m = 50.0 * np.arange(len(_ROOMS))[:, None] + 0.5 * np.arange(len(_WAY))
        self.travelled_m[:] = np.append(way_m.ravel(), 400.0)

    def query(self) -> PlaceQuery:
        """Where the newest scan is, of which the track says little."""
        places, known = KnownPlaces(self), np.arange(self.key)
        places.seek(known, known)
        true = between(places.anchors, self.poses[self.key])
        count = len(places.anchors)
        expected = ExpectedPoses(true + _OFF, np.full(count, _SIGMA_M), np.full(count, _SIGMA_RAD))
        return PlaceQuery(self, self.key, places, expected, 0.5, 0)


def _answers(part: Any) -> list[tuple[Rooms, list[Candidate]]]:
    search, found = make_part(PLACE_SEARCHES, part), list[tuple[Rooms, list[Candidate]]]()
    for room in _ROOMS:
        for again in _AGAIN:
            places = Rooms(room, again)
            found.append((places, list(search.propose(places.query()))))
    return found


@PLACE_LAWS.law()
def the_place_where_the_robot_is_is_among_what_is_proposed(part: Any) -> None:
    answers = _answers(part)
    found = sum(any(is_same_place(c.pose, places.poses[places.key]) for c in found) for places, found in answers)
    assert 2 * found >= len(answers), f"found the place in {found} of {len(answers)} queries, allowed: half of them"


@PLACE_LAWS.law()
def candidates_are_poses_of_different_places_with_scores_the_best_first(part: Any) -> None:
    for _, found in _answers(part):
        scores = [one.score for one in found]
        is_sorted = scores == sorted(scores, reverse=True) and all(0.0 <= score <= 1.0 for score in scores)
        assert is_sorted, f"found scores {scores}, allowed: 0 to 1, the best first"
        is_pose = [np.shape(one.pose) == (3,) and bool(np.isfinite(one.pose).all()) for one in found]
        assert all(is_pose), "found a pose that is not (3,) finite numbers"
        for k, one in enumerate(found):
            alike = [other for other in found[:k] if is_same_place(one.pose, other.pose)]
            assert not alike, f"found two candidates at {np.round(one.pose, 2).tolist()}, allowed: one"


@PLACE_LAWS.law()
def where_nothing_is_known_nothing_is_proposed(part: Any) -> None:
    rooms, nothing = Rooms(1, _AGAIN[0]), np.zeros(0, dtype=np.int64)
    query, places = rooms.query(), KnownPlaces(rooms)
    places.seek(nothing, nothing)
    query = query._replace(places=places, expected=ExpectedPoses.anywhere(0))
    equal("candidates", len(make_part(PLACE_SEARCHES, part).propose(query)), 0)


@PLACE_LAWS.law()
def the_same_query_gives_the_same_candidates_and_leaves_the_scans_alone(part: Any) -> None:
    (_, one), (places, other) = (_answers(part)[0] for _ in range(2))
    equal("scores", [c.score for c in one], [c.score for c in other])
    agree("poses", [c.pose for c in one], [c.pose for c in other])
    before = places.store.returns.points.copy()
    make_part(PLACE_SEARCHES, part).propose(places.query())
    agree("points of the scans", places.store.returns.points, before)
