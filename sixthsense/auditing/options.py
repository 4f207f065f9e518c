"""How an audit is made."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from sixthsense.auditing.pairing import Align
from sixthsense.auditing.poses import AuditError, Frame
from sixthsense.config.section import shown
from sixthsense.config.suggestion import allowed_names, nearest

Order = Literal["translation", "rotation"]


@dataclass(frozen=True, slots=True)
class Options:
    """How the sources are read and compared; AuditError for a value that is not allowed."""

    topic: str = ""
    """of the estimate in a bag; by default the only one with covariances"""
    truth_topic: str = ""
    """of the truth in a bag: a topic of poses, or /tf"""
    truth_frames: tuple[str, str] | None = None
    """parent and child in /tf; by default those that the estimate names"""
    frame: Frame | None = None
    """whose axes the covariances have; by default that of the format, and else the world's"""
    order: Order = "translation"
    """which half of a covariance is first"""
    align: Align = "none"
    """how the estimate is brought into the frame of the truth"""
    time_offset: float | None = None
    """largest offset of the stamps to search, s; None: none is searched"""

    def __post_init__(self) -> None:
        for name, value, known in (
            ("frame", self.frame, Frame),
            ("order", self.order, Order),
            ("align", self.align, Align),
        ):
            names = get_args(known)
            if value is not None and value not in names:
                raise AuditError(f"{name}: found {shown(value)}, {allowed_names(names, nearest(str(value), names))}")
        offset = self.time_offset
        if offset is not None and not (isinstance(offset, (int, float)) and 0.0 < offset <= 1e6):
            raise AuditError(f"time offset: found {shown(offset)}, allowed: the largest one to search, s, above 0")
        frames = self.truth_frames
        if frames is not None and (isinstance(frames, str) or len(frames) != 2 or not all(frames)):
            raise AuditError(f"truth frames: found {shown(frames)}, allowed: two names, parent and child")
