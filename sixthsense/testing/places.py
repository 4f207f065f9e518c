"""The laws of the contract of `PlaceSearch`."""

from __future__ import annotations

from typing import Any

import numpy as np

from sixthsense.config import preset
from sixthsense.config.parts import PLACE_SEARCHES
from sixthsense.config.tree import make_part
from sixthsense.core.geometry import Pose, rotation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.se2 import between
from sixthsense.slam.scans.known_places import KnownPlaces
from sixthsense.slam.scans.place_search import (
    Candidate,
    ExpectedPoses,
    PlaceQuery,
    is_same_place,
)
from sixthsense.slam.scans.returns import ScanStore
from sixthsense.testing.laws import Laws, agree, equal
from sixthsense.testing.perception import ROOM

LAWS = Laws()

_ROOMS = {0: (0.0, np.zeros(2), 1.0), 1: (1.2, np.array([24.0, 7.0]), 1.35), 2: (-0.6, np.array([-5.0, 31.0]), 0.8)}
"""turn, place and size of each of three rooms of one kind"""
_WAY = [Pose(-2.1, -1.3, 0.4), Pose(-1.9, 0.6, 1.3), Pose(-1.2, 2.4, 0.9), Pose(0.2, 1.1, -0.8), Pose(2.6, 0.2, 0.3)]
_AGAIN = [Pose(-1.7, -0.9, 1.9), Pose(-0.4, 1.6, -0.4), Pose(2.2, -0.7, 2.6)]
_OFF = np.array([0.15, -0.1, 0.03])
"""error of where the scan is expected, and"""
_SIGMA_M, _SIGMA_RAD = 0.4, 0.1


class Rooms:
    """Scans with a laser at known poses in three rooms, each of which is a place, and one that was taken again."""

    usual_agreement = 0.9

    def __init__(self, room: int, again: Pose) -> None:
        config, rng = preset("log"), np.random.default_rng(11)
        self.store, poses = ScanStore(config.scans.max_range_m), []
        rows = [(number, pose) for number in _ROOMS for pose in _WAY]
        for number, pose in (*rows, (room, again)):  # the newest scan is the last row
            turn, origin, size = _ROOMS[number]
            x, y = rotation(turn) @ (size * pose.position) + origin
            at = Pose(float(x), float(y), pose.theta + turn)
            walls = ROOM * size @ rotation(turn).T + origin
            ranges = cast_rays(at, beam_bearings(config.laser), walls, config.laser.max_range)
            self.store.put(Scan.from_config(ranges + rng.normal(0.0, 0.01, len(ranges)), config.laser))
            self.store.keep()
            poses.append(at.array())
        self.poses, self.key = np.array(poses), len(rows)
        # Rooms are so far apart on the way that each is a place of its own.
        way_m = 50.0 * np.arange(len(_ROOMS))[:, None] + 0.5 * np.arange(len(_WAY))
        self.travelled_m = np.append(way_m.ravel(), 400.0)

    def query(self) -> PlaceQuery:
        """Where the newest scan is, of which the track says little."""
        places, known = KnownPlaces(self), np.arange(self.key)
        places.seek(known, known)
        true = between(places.anchors, self.poses[self.key])
        count = len(places.anchors)
        expected = ExpectedPoses(true + _OFF, np.full(count, _SIGMA_M), np.full(count, _SIGMA_RAD))
        return PlaceQuery(self, self.key, places, expected, 0.5)


def _answers(part: Any) -> list[tuple[Rooms, list[Candidate]]]:
    search, found = make_part(PLACE_SEARCHES, part), list[tuple[Rooms, list[Candidate]]]()
    for room in _ROOMS:
        for again in _AGAIN:
            places = Rooms(room, again)
            found.append((places, list(search.propose(places.query()))))
    return found


@LAWS.law()
def the_place_where_the_robot_is_is_among_what_is_proposed(part: Any) -> None:
    answers = _answers(part)
    found = sum(any(is_same_place(c.pose, places.poses[places.key]) for c in found) for places, found in answers)
    assert 2 * found >= len(answers), f"found the place in {found} of {len(answers)} queries, allowed: half of them"


@LAWS.law()
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


@LAWS.law()
def where_nothing_is_known_nothing_is_proposed(part: Any) -> None:
    rooms, nothing = Rooms(1, _AGAIN[0]), np.zeros(0, dtype=np.int64)
    query, places = rooms.query(), KnownPlaces(rooms)
    places.seek(nothing, nothing)
    query = query._replace(places=places, expected=ExpectedPoses.anywhere(0))
    equal("candidates", len(make_part(PLACE_SEARCHES, part).propose(query)), 0)


@LAWS.law()
def the_same_query_gives_the_same_candidates_and_leaves_the_scans_alone(part: Any) -> None:
    (_, one), (places, other) = (_answers(part)[0] for _ in range(2))
    equal("scores", [c.score for c in one], [c.score for c in other])
    agree("poses", [c.pose for c in one], [c.pose for c in other])
    points, poses = places.store.returns.points.copy(), places.poses.copy()
    make_part(PLACE_SEARCHES, part).propose(places.query())
    agree("points of the scans", places.store.returns.points, points)
    agree("poses of the scans", places.poses, poses)
