"""What has made a map wrong, where the evidence tells it, with time and place."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array, Pose
from sixthsense.logs.diagnose import beside_wheels
from sixthsense.verdict.disagreement import Turns
from sixthsense.verdict.evidence import Evidence, share
from sixthsense.verdict.probability import MIRROR_SIGMAS
from sixthsense.verdict.verdict import Cause
from sixthsense.verdict.views import FEWEST
from sixthsense.verdict.witnesses import Witnesses

_NOWHERE = np.zeros((0, 2))
_SIGMAS = 4.0  # of a fitted value, beyond which it is not chance
_LAG_S, _LAG_GAIN = 0.25, 0.3
_SLIP_M, _SLIP_RAD = 0.3, math.radians(10.0)  # of a motion that wheels and trajectory tell apart
_NEW_SHARE = 0.3  # of the returns of a scan that the scan before contradicts: it is of another place
_OLD_SHARE = 0.25  # the same of another pass
_BLIND_M = 2.0  # of travel without a return that is worth a word
_LEAST_OVERLAP = 0.3  # of the returns of a scan, confirmed by those before
_APART_S = 5.0  # between two events that are told apart
_FACTOR, _SPREAD, _ALIKE = 0.1, 0.15, 0.93
"""by which wheels are wrong that is worth a word, and scans no mount explains; correlation of turns by one factor"""


def causes_of(evidence: Evidence, found: Witnesses) -> tuple[Cause, ...]:
    """The causes: a mirrored laser alone; or clocks, mount and wheels first, then events, passes and ties."""
    if mirrored := (*_mirrored(evidence),):
        return mirrored
    mount = [each for each in _beside_wheels(evidence, found) if each.name != "odometry_scale"]
    events = [*_carried(evidence, found), *_blind(evidence, found), *_slips(evidence, found)]
    return (
        *_clocks(evidence),
        *mount,
        *_wheels(evidence),
        *events,
        *_walls(evidence, found),
        *_untied(evidence, found),
    )


def _mirrored(evidence: Evidence) -> Iterator[Cause]:
    seen, turns = evidence.mirror, evidence.turns
    if seen is not None and seen.sigmas > MIRROR_SIGMAS:
        first, last = seen.first, seen.last
    elif turns is not None and turns.slope + MIRROR_SIGMAS * turns.sigma < 0.0:
        first, last = 0, len(evidence.stamps_s) - 1
    else:
        return
    begin, end = float(evidence.stamps_s[first]), float(evidence.stamps_s[last])
    asked = "is the laser mirrored? Or do the wheels report turns with the wrong sign?"
    told = f"the wheels turn against the scans from {begin:.0f} to {end:.0f} s; {asked}"
    yield Cause("mirrored", told, begin, end, _NOWHERE)


def _clocks(evidence: Evidence) -> Iterator[Cause]:
    late = evidence.lag
    if late is not None and abs(late.seconds) >= _LAG_S and late.gain >= _LAG_GAIN:
        word = "later" if late.seconds < 0.0 else "earlier"
        told = f"the wheels' stamps are {abs(late.seconds):.1f} s {word} than the scans'; are their clocks the same?"
        yield _whole("clocks", told, evidence)


def remarks_of(evidence: Evidence, found: Witnesses) -> tuple[Cause, ...]:
    """What is odd beside a map that is right: wheels that report other distances than the scans."""
    return tuple(each for each in _beside_wheels(evidence, found) if each.name != "mount")


def _beside_wheels(evidence: Evidence, found: Witnesses) -> list[Cause]:
    """What motions by scans and by wheels say of both, where they turn alike: a mount changes no turn."""
    mount, turns = evidence.mount, evidence.turns
    if mount is None or turns is None or turns.correlation < 0.7 or _is_off(turns, _SPREAD):
        return []
    scan = next((one for one in found.scans if one is not None), None)
    findings = beside_wheels(mount, Pose() if scan is None else scan.T_robot_laser)
    return [_whole(finding.kind, str(finding), evidence) for finding in findings]


def _whole(name: str, told: str, evidence: Evidence) -> Cause:
    return Cause(name, told, float(evidence.stamps_s[0]), float(evidence.stamps_s[-1]), _NOWHERE)


def _events(is_one: NDArray[np.bool_], stamps_s: Array, badness: Array) -> list[int]:
    """The worst keyframe of each group of them that are close in time, the worst group first."""
    rows = np.flatnonzero(is_one)
    if not len(rows):
        return []
    groups = np.split(rows, np.flatnonzero(np.diff(stamps_s[rows]) > _APART_S) + 1)
    worst = [int(group[np.argmax(badness[group])]) for group in groups]
    return sorted(worst, key=lambda k: -badness[k])


def _place(found: Witnesses, k: int) -> str:
    x, y = found.trajectory[k, :2]
    return f"({x:.1f}, {y:.1f})"


def _at(name: str, told: str, evidence: Evidence, found: Witnesses, k: int) -> Cause:
    """A cause at a keyframe."""
    at_s = float(evidence.stamps_s[k])
    return Cause(name, told, at_s, at_s, found.trajectory[k : k + 1, :2])


def _carried(evidence: Evidence, found: Witnesses) -> Iterator[Cause]:
    """Scans that contradict the one before: the robot is elsewhere than its wheels say."""
    new = np.nan_to_num(evidence.cut)
    for k in _events(new > _NEW_SHARE, evidence.stamps_s, new)[:3]:
        at = float(evidence.stamps_s[k])
        told = (
            f"the scan at {at:.0f} s, at {_place(found, k)}, does not fit those before "
            f"({100 * new[k]:.0f} % more of what both saw contradicts than usual there); was the robot carried?"
        )
        yield _at("carried", told, evidence, found, k)


def _slips(evidence: Evidence, found: Witnesses) -> Iterator[Cause]:
    off = np.nan_to_num(evidence.wheels.off)
    way, turn = np.hypot(off[:, 0], off[:, 1]), np.abs(off[:, 2])
    sigmas = np.nan_to_num(evidence.wheels.sigmas, nan=1.0)
    beyond = np.maximum(way / np.maximum(_SLIP_M, 5.0 * sigmas[:, 0]), turn / np.maximum(_SLIP_RAD, 5.0 * sigmas[:, 2]))
    for k in _events(beyond > 1.0, evidence.stamps_s, beyond)[:3]:
        at = float(evidence.stamps_s[k])
        told = (
            f"wheels and scans differ by {way[k]:.1f} m and {math.degrees(turn[k]):.0f}° "
            f"at {at:.0f} s, at {_place(found, k)}; did the wheels slip?"
        )
        yield _at("slip", told, evidence, found, k)


def _blind(evidence: Evidence, found: Witnesses) -> Iterator[Cause]:
    """Ways without a return, and gaps in the record."""
    if not found.scans:
        return
    is_blind = evidence.returns < FEWEST
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_blind, [False]]).astype(int)))
    way_m, nothing = evidence.travel, "nothing was seen for"
    spans = [(max(first - 1, 0), min(past, len(is_blind) - 1)) for first, past in edges.reshape(-1, 2).tolist()]
    unseen = [(nothing, *span) for span in spans if way_m[span[1]] - way_m[span[0]] > _BLIND_M]
    is_new = np.nan_to_num(evidence.overlap, nan=1.0) < _LEAST_OVERLAP
    gaps = np.flatnonzero((np.diff(evidence.stamps_s, prepend=evidence.stamps_s[:1]) > _APART_S) & is_new)
    unseen += [("no scan overlaps with those before for", k - 1, k) for k in gaps[:3].tolist()]
    for words, begin, end in unseen:
        at, until = float(evidence.stamps_s[begin]), float(evidence.stamps_s[end])
        size = f"{until - at:.0f} s and {way_m[end] - way_m[begin]:.1f} m"
        told = f"{words} {size} from {at:.0f} s on, at {_place(found, begin)}"
        yield Cause("blind", told, at, until, found.trajectory[begin : end + 1, :2])


def _walls(evidence: Evidence, found: Witnesses) -> Iterator[Cause]:
    """Two passes of one place that contradict each other."""
    wrong = np.nan_to_num(share(evidence.old_found.astype(np.float64)))
    if not (wrong > _OLD_SHARE).any():
        return
    one, other = evidence.old_pairs[int(np.argmax(wrong))].tolist()
    times = f"{evidence.stamps_s[one]:.0f} s and {evidence.stamps_s[other]:.0f} s"
    places = found.trajectory[np.unique(evidence.old_pairs[wrong > _OLD_SHARE, 1]), :2]
    where, at = _place(found, other), float(evidence.stamps_s[other])
    name, told = "doubled", f"the walls seen at {times} at {where} do not fit"
    if evidence.closures is not None and evidence.closures.found and _is_linked(found, one, other):
        name, told = "alike", f"what was seen at {times} at {where} contradicts; were two places alike taken for one?"
    yield Cause(name, told, float(evidence.stamps_s[one]), at, places)


def _is_linked(found: Witnesses, one: int, other: int) -> bool:
    """Whether a link joins keyframes near two others."""
    if found.links is None:
        return False
    return bool((np.abs(np.sort(found.links, axis=1) - (one, other)).max(axis=1) <= 10).any())


def _untied(evidence: Evidence, found: Witnesses) -> Iterator[Cause]:
    overlap = np.nan_to_num(evidence.overlap, nan=1.0)
    is_loose = (overlap < _LEAST_OVERLAP) & ~(evidence.links > 0)
    for k in _events(is_loose, evidence.stamps_s, -overlap)[:1]:
        at = float(evidence.stamps_s[k])
        told = f"from {at:.0f} s on, at {_place(found, k)}, the map is tied to the rest by odometry alone"
        yield _at("untied", told, evidence, found, k)


def _wheels(evidence: Evidence) -> Iterator[Cause]:
    mount, turns = evidence.mount, evidence.turns
    parts = []
    if mount is not None and abs(mount.scale - 1.0) > _FACTOR:
        parts.append(f"distances are {mount.scale:.2f}")
    if turns is not None and _is_off(turns, _FACTOR):
        parts.append(f"turns are {turns.slope:.2f}")
    if parts:
        told = f"by the scans {' and '.join(parts)} times what the wheels report; are beams, ranges and wheels right?"
        yield _whole("wheels", told, evidence)


def _is_off(turns: Turns, by: float) -> bool:
    """Whether all turns of the trajectory differ by a share from those of the wheels; at a slip some do."""
    return turns.correlation > _ALIKE and abs(turns.slope - 1.0) > max(by, _SIGMAS * turns.sigma)
