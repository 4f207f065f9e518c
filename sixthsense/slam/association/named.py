"""Observations that name their landmark, where names are misread, robots pushed, and landmarks put into wrong places.

A name is rarely misread. A look that contradicts the map is taken for misread, as long as others agree with it. What
more looks contradict than agree with is wrong itself: a landmark that was misread at its first look. Where looks at
different landmarks contradict the map and none agrees, the robot is not where it is believed to be, if they agree with
each other. The same landmark counts once, since what is misread is misread again in the next picture.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from sixthsense.core.covariance import chi_square_quantile, difference_covariance
from sixthsense.core.geometry import Array, Pose, rotation, wrap_angle
from sixthsense.core.landmarks import LandmarkId, Observation
from sixthsense.core.motion import Odometry
from sixthsense.slam.association.records import Record
from sixthsense.slam.association.slip import SLIP_SIGMAS
from sixthsense.slam.estimators.base import Estimate, Estimator

_MISREAD = 0.01
"""share of names that are misread"""
_CONFIRMED = 2
"""looks that agree with a landmark, from which on it says something of the robot: one may be misread"""


@dataclass(frozen=True, slots=True)
class Contradiction:
    """The last look at a landmark of a row of looks that contradict the map."""

    point: Array
    """(2,) where it was seen, world frame, by the estimate then"""
    cov: Array
    """(2, 2) of the look, world frame"""
    pose_cov: Array
    """(3, 3) of the pose then"""


class Contradictions:
    """Looks that contradict the map since the last one that agreed with it."""

    def __init__(self, probability: float) -> None:
        """Looks contradict the map, and slips are too large to be one, outside of the gate of this probability."""
        self._confirmed_gate = float(chi_square_quantile(probability, 2))
        # A second look outside of it tells rather that the first one was misread.
        first = min(probability, 1.0 - _MISREAD) if probability < 1.0 else probability
        self._first_gate = float(chi_square_quantile(first, 2))
        self._gate = float(chi_square_quantile(probability, 4))  # of a slip, and of the distance of two landmarks
        self._last: dict[LandmarkId, Contradiction] = {}
        self._looks: dict[LandmarkId, int] = {}
        self._against: dict[LandmarkId, int] = {}
        """looks that contradicted a landmark while others agreed, of all landmarks"""

    def gate(self, record: Record) -> float:
        """The largest squared distance of a look that agrees with a landmark; infinite for a probability of 1."""
        return self._first_gate if record.observations < _CONFIRMED else self._confirmed_gate

    @property
    def is_robot_doubtful(self) -> bool:
        """Whether different landmarks are contradicted, and none agrees."""
        return len(self._last) > 1

    def agreed(self) -> None:
        """A look agrees with the map: what was contradicted before is the landmarks', not the robot's place."""
        for i, looks in self._looks.items():
            self._against[i] = self._against.get(i, 0) + looks
        self.explained()

    def add(
        self, observations: Mapping[LandmarkId, Observation], estimate: Estimate, records: Mapping[LandmarkId, Record]
    ) -> None:
        """More looks that contradict the map, at an estimate."""
        turn = rotation(estimate.pose.theta)
        for i, seen in observations.items():
            self._looks[i] = self._looks.get(i, 0) + 1
            if records[i].observations < _CONFIRMED:
                continue
            cov = turn @ seen.cov @ turn.T
            self._last[i] = Contradiction(estimate.pose @ seen.z, cov, estimate.pose_cov)

    def explained(self) -> None:
        """A slip explains what was contradicted since the last look that agreed."""
        self._last.clear()
        self._looks.clear()

    def disproved(self, records: Mapping[LandmarkId, Record]) -> list[LandmarkId]:
        """Landmarks that more looks contradict than agree with; they are forgotten here."""
        self._against = {i: against for i, against in self._against.items() if i in records}
        gone = [i for i, against in self._against.items() if against > records[i].observations]
        for i in gone:
            del self._against[i]
        return gone

    def slip(self, estimate: Estimate, estimator: Estimator) -> tuple[Odometry, Collection[LandmarkId]] | None:
        """The motion that the wheels have missed, by the two contradicted landmarks that tell it best, and these.

        None if no two are as far from each other as in the map, after a slip that is not too large to be one.
        """
        rows = {i: k for k, i in enumerate(estimate.ids.tolist())}
        ids = [i for i in self._last if i in rows]
        if len(ids) < 2:
            return None
        joint = estimator.joint_covariance(ids)[3:, 3:]
        best, least = None, self._gate
        for first, second in itertools.combinations(range(len(ids)), 2):
            pair = ids[first], ids[second]
            true = estimate.landmarks[[rows[i] for i in pair]]
            slip, squared = self._by_pair(estimate, pair, true, difference_covariance(joint, first, second))
            if squared < least:
                best, least = (slip, pair), squared
        return best

    def _by_pair(
        self, estimate: Estimate, ids: tuple[LandmarkId, LandmarkId], true: Array, map_cov: Array
    ) -> tuple[Odometry, float]:
        """The slip by two landmarks that lie at `true` (2, 2), and its squared distance from what is believed, 4 dof.

        `map_cov` (2, 2) is that of the landmarks relative to each other. The distance is infinite if they are too near
        to each other to tell a heading.
        """
        seen = np.array([self._last[i].point for i in ids])
        cov = np.sum([self._cov_now(i, estimate) for i in ids], axis=0)
        apart, apart_true = seen[1] - seen[0], true[1] - true[0]
        length, length_true = float(np.hypot(*apart)), float(np.hypot(*apart_true))
        along, along_true = apart / length, apart_true / length_true
        turn = math.atan2(along[0] * along_true[1] - along[1] * along_true[0], float(along @ along_true))
        middle = true.mean(axis=0)
        moved = middle - rotation(turn) @ seen.mean(axis=0)
        found = Pose(moved[0], moved[1], turn) @ estimate.pose
        of_turn = float(np.trace(cov)) / length**2
        of_place = 0.25 * float(np.trace(cov)) + float(np.sum((found.position - middle) ** 2)) * of_turn
        error = np.diag(SLIP_SIGMAS**2 + [of_place, of_place, of_turn])
        off = found.array() - estimate.pose.array()
        off[2] = wrap_angle(off[2])
        squared = float(off @ np.linalg.solve(estimate.pose_cov + error, off))
        squared += (length - length_true) ** 2 / float(along @ cov @ along + along_true @ map_cov @ along_true)
        is_told = of_turn < SLIP_SIGMAS[2] ** 2
        return Odometry(estimate.pose.inverse() @ found, error), squared if is_told else math.inf

    def _cov_now(self, i: LandmarkId, estimate: Estimate) -> Array:
        """(2, 2) of where a landmark was seen relative to where the robot is now, world frame."""
        last = self._last[i]
        grown = np.maximum(np.diag(estimate.pose_cov - last.pose_cov), 0.0)
        lever = float(np.sum((last.point - estimate.pose.position) ** 2))
        return np.asarray(last.cov + (0.5 * float(grown[0] + grown[1]) + grown[2] * lever) * np.eye(2))
