"""The laws of the contract of `PlaceSearch`."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import preset
from sixthsense.config.parts import PLACE_SEARCHES
from sixthsense.config.tree import make_part
from sixthsense.core.geometry import Array, Pose, rotation
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.se2 import between
from sixthsense.slam.scans.place_search import (
    Candidate,
    ExpectedPoses,
    PlaceQuery,
    candidates_fault,
    is_same_place,
    surfaces_around,
)
from sixthsense.slam.scans.places import VOXEL_M, Pyramid, appearance, pyramid, submap_points
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


class Around:
    """The scans of one room."""

    def __init__(self, places: Places, rows: NDArray[np.int64]) -> None:
        self._places, self._rows = places, rows

    def partners(self, key: int, at: Array, most: int) -> NDArray[np.int64]:
        """The nearest of them."""
        off = self._places.poses[self._rows, :2] - at[:2]
        return self._rows[np.argsort((off**2).sum(axis=1), kind="stable")][:most]


class Places:
    """Scans with a laser at known poses in three rooms, each of which is a place, and one that was taken again."""

    usual_agreement = 0.9

    def __init__(self, room: int, again: Pose) -> None:
        config, rng = preset("log"), np.random.default_rng(11)
        self.store, poses, self._rooms = ScanStore(config.scans.max_range_m), [], []
        for number, (turn, origin, size) in _ROOMS.items():
            walls = ROOM * size @ rotation(turn).T + origin
            for pose in (*_WAY, *((again,) if number == room else ())):
                x, y = rotation(turn) @ (size * pose.position) + origin
                at = Pose(float(x), float(y), pose.theta + turn)
                ranges = cast_rays(at, beam_bearings(config.laser), walls, config.laser.max_range)
                noisy = ranges + rng.normal(0.0, 0.01, len(ranges))
                poses.append((number, pose is again, at.array(), Scan.from_config(noisy, config.laser)))
        poses.sort(key=lambda row: row[1])  # the newest scan is the last row
        for number, _, _, scan in poses:
            self.store.put(scan)
            self.store.keep()
            self._rooms.append(number)
        self.poses = np.array([at for _, _, at, _ in poses])
        self.key = len(poses) - 1
        self.travelled_m = np.append(np.arange(self.key) * 1.5, 400.0)
        self._first = [self._rooms.index(number) for number in _ROOMS]

    @property
    def anchors(self) -> Array:
        """The first scan of each room."""
        return self.poses[self._first]

    @property
    def looks(self) -> Array:
        """What the rooms look like."""
        found = []
        for number in _ROOMS:
            rows = self._of_room(number)
            at = between(self.poses[self._first[number]], self.poses[rows])
            found.append(appearance(surfaces_around(self, rows, at)[0]))
        return np.array(found)

    def _of_room(self, number: int) -> NDArray[np.int64]:
        return np.flatnonzero(np.array(self._rooms[: self.key]) == number)

    def submap(self, place: int, range_m: float) -> Pyramid:
        """The submap of a room."""
        rows = self._of_room(place)
        at = between(self.poses[self._first[place]], self.poses[rows])
        return pyramid(submap_points(self.store.returns, rows, at, VOXEL_M, range_m))

    def surroundings(self, place: int) -> Around:
        """The scans of a room."""
        return Around(self, self._of_room(place))

    def query(self) -> PlaceQuery:
        """Where the newest scan is, of which the track says little."""
        true = between(self.anchors, self.poses[self.key])
        count = len(_ROOMS)
        expected = ExpectedPoses(true + _OFF, np.full(count, _SIGMA_M), np.full(count, _SIGMA_RAD))
        return PlaceQuery(self, self.key, self.travelled_m, self, expected, 0.5)


def _answers(part: Any) -> list[tuple[Places, list[Candidate]]]:
    search, found = make_part(PLACE_SEARCHES, part), list[tuple[Places, list[Candidate]]]()
    for room in _ROOMS:
        for again in _AGAIN:
            places = Places(room, again)
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
        assert not candidates_fault(found), candidates_fault(found)
        for k, one in enumerate(found):
            alike = [other for other in found[:k] if is_same_place(one.pose, other.pose)]
            assert not alike, f"found two candidates at {np.round(one.pose, 2).tolist()}, allowed: one"


@LAWS.law()
def where_nothing_is_known_nothing_is_proposed(part: Any) -> None:
    places = Places(1, _AGAIN[0])
    query = places.query()._replace(places=_Nothing(places), expected=ExpectedPoses.anywhere(0))
    equal("candidates", len(make_part(PLACE_SEARCHES, part).propose(query)), 0)


class _Nothing:
    """No place."""

    def __init__(self, places: Places) -> None:
        self.anchors, self.looks = np.zeros((0, 3)), places.looks[:0]

    def submap(self, place: int, range_m: float) -> Pyramid:
        raise IndexError(place)

    def surroundings(self, place: int) -> Around:
        raise IndexError(place)


@LAWS.law()
def the_same_query_gives_the_same_candidates_and_leaves_the_scans_alone(part: Any) -> None:
    (_, one), (places, other) = (_answers(part)[0] for _ in range(2))
    equal("scores", [c.score for c in one], [c.score for c in other])
    agree("poses", [c.pose for c in one], [c.pose for c in other])
    points, poses = places.store.returns.points.copy(), places.poses.copy()
    make_part(PLACE_SEARCHES, part).propose(places.query())
    agree("points of the scans", places.store.returns.points, points)
    agree("poses of the scans", places.poses, poses)
