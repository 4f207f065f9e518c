"""Votes: places that are verified some metres apart must agree before one of them is believed."""

from __future__ import annotations

from typing import NamedTuple

from sixthsense.core.geometry import Array
from sixthsense.core.se2 import between, compose
from sixthsense.slam.scans.evidence import PlacedScans
from sixthsense.slam.scans.links import Alignments
from sixthsense.slam.scans.places import Apart

NEW_M = 1.5  # travel that shows something new: between two votes that count both, and two searches of alike places
_LASTS_M = 10.0  # travel after which a vote is dropped
NEAR = Apart(0.35, 0.06)  # poses that agree about a place


class Vote(NamedTuple):
    """A place that was verified."""

    key: int
    pose: Array
    """(3,) of that scan, in the frame of what is known"""
    travelled_m: float
    links: list[tuple[Alignments, int]]


class Votes:
    """The votes of the last metres."""

    def __init__(self, scans: PlacedScans) -> None:
        self._scans = scans
        self._votes: list[Vote] = []

    def agreeing(self, vote: Vote) -> list[Vote]:
        """Count a vote: those that say the same, if they are far enough apart and more than half; otherwise none."""
        lasting = [each for each in self._votes if vote.travelled_m - each.travelled_m < _LASTS_M]
        self._votes = [*lasting, vote]
        agreeing = [each for each in self._votes if self._agree(each, vote)]
        span = vote.travelled_m - agreeing[0].travelled_m
        if span < NEW_M or 2 * len(agreeing) <= len(self._votes):
            return []
        self._votes = []
        return agreeing

    def _agree(self, one: Vote, newest: Vote) -> bool:
        """Whether two votes say the same of the newest scan's pose."""
        poses = self._scans.poses
        said = compose(one.pose, between(poses[one.key], poses[newest.key]))
        return bool(NEAR.same(between(said, newest.pose)))
