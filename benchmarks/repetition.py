"""Loop closures in buildings that repeat themselves, with worn wheels: wrong ones accepted, true ones found.

A link to an old keyframe is false if its relative pose is off from the truth by more than 0.3 m or 5 degrees, and by
more than its covariance allows: along a bare corridor a link says nothing. A true loop closure is a keyframe and an old
one, at least 10 m driven between, that share half of their views by the truth. It is closed if the pair is right to 0.3
m and 5 degrees at the end, and if a keyframe within 5 m is linked to an old one.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from repetition_scenes import SCENES, log_of
from runs import Figures, Setting

from sixthsense.config import preset
from sixthsense.core.geometry import Array, wrap_angle
from sixthsense.core.laser import Scan
from sixthsense.core.se2 import between
from sixthsense.slam.slam import Slam

Link = tuple[int, int, Array, Array]
"""keyframes target and source, pose (3,) of the source in the target's frame, and its information (3, 3)"""

_WRONG_M, _WRONG_RAD = 0.3, math.radians(5.0)
_WRONG_SQUARED = 20.0  # squared Mahalanobis distance, 3 degrees of freedom
_DRIVEN_M, _OVERLAP, _LINKED_WITHIN_M = 10.0, 0.5, 5.0
_NEAR_M, _NEAREST = 4.0, 4
_SURFACE_M = 0.12  # between returns of one surface


def old_links(slam: Slam) -> list[Link]:
    """Links to old keyframes that stand at the end; this alone knows how the front end keeps them."""
    links = slam._front_end._graph.links  # type: ignore[union-attr]
    return [(*map(int, row["ends"]), row["pose"], np.linalg.inv(row["cov"])) for row in links[links["is_old"]]]


def drive_figures(setting: Setting, seed: int) -> Figures:
    """Replay a drive through a building that repeats itself, and compare its loop closures with the truth."""
    config, log = preset("log"), log_of(SCENES[setting[0]], seed)
    truths, scans = [], []
    assert log.ticks[0].truth is not None
    with Slam(config, log.ticks[0].truth) as slam:
        for tick in log.ticks:
            step = slam.take(tick)
            if step.keyframe is not None:
                assert tick.truth is not None and step.scan is not None
                truths.append(tick.truth.array())
                scans.append(step.scan)
        views = Views(scans, config.scans.max_range_m)
        return judged(slam.trajectory(), np.array(truths), old_links(slam), views)


class Views:
    """Returns of the scans of keyframes, to see which of them share a view."""

    def __init__(self, scans: Sequence[Scan], max_range_m: float) -> None:
        """Take the scans of one laser; returns beyond `max_range_m` are not used."""
        ranges = np.array([scan.ranges for scan in scans], dtype=np.float64)  # (K, beams)
        self._bearings, self._closed = scans[0].bearings, scans[0].closed
        self._spacing = float(scans[0].angle_increment)
        self._ranges = np.where(ranges < max_range_m, ranges, np.inf)
        direction = np.column_stack([np.cos(self._bearings), np.sin(self._bearings)])
        with np.errstate(invalid="ignore"):
            self._points = self._ranges[:, :, None] * direction  # (K, beams, 2) laser frame

    def overlap(self, target: int, source: int, pose: Array) -> float:
        """Share of the returns of `source` that lie on a return of `target`; `pose` (3,) in the target's frame."""
        points = self._points[source][np.isfinite(self._ranges[source])]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        x, y = pose[0] + c * points[:, 0] - s * points[:, 1], pose[1] + s * points[:, 0] + c * points[:, 1]
        beams, distance = len(self._bearings), np.hypot(x, y)
        turned = (np.arctan2(y, x) - self._bearings[0]) % (2.0 * np.pi)
        near = np.rint(turned / self._spacing).astype(np.int64)[:, None] + np.array([-1, 0, 1])  # (n, 3) beams
        is_inside = self._closed | (near >= 0) & (near < beams)
        near %= beams
        there = self._points[target, near]
        with np.errstate(invalid="ignore"):
            gap = np.hypot(x[:, None] - there[:, :, 0], y[:, None] - there[:, :, 1])
            gap = np.fmin(gap, np.abs(distance[:, None] - self._ranges[target, near]))
            return float(((gap < _SURFACE_M) & is_inside).any(axis=1).sum() / max(len(points), 1))


def judged(poses: Array, truths: Array, links: list[Link], views: Views) -> Figures:
    """Errors of the poses (K, 3) of keyframes and of links between them."""
    steps = np.hypot(*np.diff(truths[:, :2], axis=0).T)
    travelled = np.concatenate([[0.0], np.cumsum(steps)])
    off = np.hypot(*(poses - truths)[:, :2].T)
    pairs = true_loop_closures(truths, travelled, views)
    linked = np.array([j for i, j, _, _ in links if travelled[j] - travelled[i] >= _DRIVEN_M], dtype=np.int64)
    error = between(between(truths[pairs[:, 0]], truths[pairs[:, 1]]), between(poses[pairs[:, 0]], poses[pairs[:, 1]]))
    right = (np.hypot(error[:, 0], error[:, 1]) < _WRONG_M) & (np.abs(error[:, 2]) < _WRONG_RAD)
    apart = np.abs(travelled[pairs[:, 1], None] - travelled[linked])
    closed = right & (apart < _LINKED_WITHIN_M).any(axis=1)
    false = sum(is_false(truths, link) for link in links)
    ate_m = float(np.sqrt(np.mean(off**2)))
    return {"false": false, "true": len(pairs), "closed": int(closed.sum()), "ate_m": ate_m}


def is_false(truths: Array, link: Link) -> bool:
    """Whether a link is off from the truth by more than its covariance allows."""
    target, source, pose, information = link
    off = pose - between(truths[target], truths[source])
    off[2] = wrap_angle(off[2])
    is_off = np.hypot(off[0], off[1]) > _WRONG_M or abs(off[2]) > _WRONG_RAD
    return bool(is_off and off @ information @ off > _WRONG_SQUARED)


def true_loop_closures(truths: Array, travelled: Array, views: Views) -> NDArray[np.int64]:
    """(n, 2) old keyframe and keyframe that share half of their views, the nearest one of each keyframe."""
    pairs = []
    for j in range(len(truths)):
        old = np.flatnonzero(travelled[:j] <= travelled[j] - _DRIVEN_M)
        off = between(truths[old], truths[j])
        distance = np.hypot(off[:, 0], off[:, 1])
        for k in np.argsort(distance + np.abs(off[:, 2]))[:_NEAREST]:
            if distance[k] > _NEAR_M:
                continue
            there = views.overlap(int(old[k]), j, off[k])
            back = views.overlap(j, int(old[k]), between(truths[j], truths[old[k]]))
            if min(there, back) >= _OVERLAP:
                pairs.append((int(old[k]), j))
                break
    return np.array(pairs, dtype=np.int64).reshape(-1, 2)
