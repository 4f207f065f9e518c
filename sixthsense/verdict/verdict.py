"""`Verdict`: whether a map is right, how probable it is that it is not, and why."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from sixthsense.core.geometry import Array

Level = Literal["good", "doubtful", "broken", "unjudged"]


class Cause(NamedTuple):
    """Something that makes a map wrong, where the evidence tells it."""

    name: str
    """`mirrored`, `mount`, `clocks`, `slip`, `carried`, `alike`, `blind`, `untied`, `wheels` or `doubled`;
    of a good map `odometry_scale` or `wheels_reversed`"""
    sentence: str
    """what was found, with time and place"""
    from_s: float
    """seconds since the first scan"""
    to_s: float
    places: Array
    """(n, 2) m, world frame, where it is to be seen; none for one that is everywhere"""


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a map is right."""

    level: Level
    """`good`, `doubtful` or `broken`; `unjudged` where nothing speaks for the map or against it"""
    probability: float | None
    """that the map is wrong; None if it is not judged"""
    keyframes: Array
    """(K,) probability that each keyframe's pose is off by more than 0.5 m or 10 degrees from those 10 m before it"""
    causes: tuple[Cause, ...]
    """in the order of `causes_of`; none where the evidence tells none; of a good map what is odd with its wheels"""
    evidence: Mapping[str, float]
    """what was found, by name; what is not known is left out"""
    reason: str = ""
    """why the map is not judged"""

    @property
    def cause(self) -> str:
        """Name of the first cause; empty where the evidence tells none."""
        return self.causes[0].name if self.causes else ""

    def __repr__(self) -> str:
        if self.probability is None:
            return f"<Verdict {self}>"
        return f"<Verdict {self}; the map is wrong with a probability of {self.probability:.2g}>"

    def __str__(self) -> str:
        if self.level == "unjudged":
            return f"not judged: {self.reason}"
        told = "; ".join(cause.sentence for cause in self.causes[:2])
        return f"{self.level}: {told}" if told else self.level
