"""What is odd in a log: the one place that decides whether clocks, lasers, mounts, units and odometry are right.

One fit over the turns that scans and odometry both see has the angle between beams, its sign, and the delay of clocks.
The turn between two scans is the shift that lays the one's view, ranges by bearing, on the other's. The earlier scan is
first drawn from where the odometry has the laser later, so that what is left between both views is a turn.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import Config, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import MOST_RANGE_M, Scan
from sixthsense.core.se2 import between, compose
from sixthsense.core.source import seconds
from sixthsense.logs.finding import Finding
from sixthsense.logs.laser_geometry import Beams, beams_over, with_beams
from sixthsense.logs.log import EXACT_S, Log, Odometry, Sighting, passed_s

_MOVED_M = 0.3  # by which a range has changed
_FASTEST, _SLOWEST = 20.0, 0.003  # m/s of what drives; a robot in centimetres is faster, one by ms is slower
_FEWEST, _LEAST_WAY_M = 10, 1.0  # motions or turns, and way, that say something
_ALONG, _TURNED_RAD = 0.85, 0.5  # share of the way along a heading; and by which headings differ that say something
_SIGMAS, _LEAST_S, _SCALE_OFF = 4.0, 0.08, 0.15
"""of a value that is not chance; a delay and a scale that are worth a word"""
_OFF = (0.1, 0.1, math.radians(4.0))
"""the same of a mount: x, y, m, and heading"""
_PAIRS, _APART_S = 400, 0.3  # scans, or pairs of them, evenly over the log, and the time between the two
_BINS, _SHIFTS, _FEWEST_BINS = 180, 35, 20  # of bearings around a full turn; to either side; that both views have
_FAR_M, _MOST_M, _CAP_RAD = 30.0, 0.5, 0.2  # ranges beyond are not compared; caps of errors
_TURN_RAD, _NOISE_RAD = 0.05, 0.005  # a pair turns by more; and what is seen of it
_STEP_S, _FINE_S, _MOST_S = 0.02, 0.6, 120.0  # of delays; and how far they are searched, around that of other clocks
_EXPLAINED, _LIKELIER = 0.7, 20.0  # share of the squared turns of a fit; log likelihood ratio to another one


def settled(log: Log, config: Config, name: str = "log") -> tuple[Log, Config, list[Finding]]:
    """A log and a configuration with what is found out about it applied; and what is to be said.

    Each kind of finding is said, refused or applied, as `KINDS` has it. What the configuration states is not looked
    for. Raises InputError, which begins with `name`, for a log that cannot be right.
    """
    log = log.later(config.time_offset or 0.0)
    stated = {"clocks": config.time_offset is not None, "frozen_odometry": config.no_odometry}
    found = [*log.found, *findings_of(log.sightings, log.odometry, log.candidates)]
    found = [finding for finding in found if not stated.get(finding.kind)]
    for finding in found:
        if finding.action == "refused":
            raise InputError(name, f"found {finding.text}", "metres, radians, and odometry along its headings")
        if finding.kind == "clocks":
            offset_s = round(finding.value, 3)
            log, config = log.later(offset_s), merge(config, {"time_offset": offset_s})
        elif finding.kind == "field_of_view":
            beams = beams_over(finding.value, len(log.scans[0].ranges))
            log = log.anew([each._replace(scan=with_beams(each.scan, beams)) for each in log.sightings], log.odometry)
        elif finding.kind == "frozen_odometry":
            log, config = log.anew(log.sightings, None), merge(config, {"no_odometry": True})
    return log, config, [*found, *_gaps(log)]


def findings_of(
    sightings: Sequence[Sighting], odometry: Odometry | None, candidates: Sequence[Beams] = ()
) -> Iterator[Finding]:
    """What scans and odometry say, or poses alone; `candidates` as those of a `Log`."""
    stands = odometry is not None and not (odometry.poses != odometry.poses[0]).any()
    if odometry is not None and not stands:
        yield from _of_odometry(odometry)
    if not sightings:
        return
    scans = [each.scan for each in sightings]
    some = [scans[k] for k in _evenly(np.arange(len(scans))).tolist()]
    returns = np.concatenate([scan.ranges[scan.is_return] for scan in some])
    if len(returns) and (median := float(np.median(returns))) > MOST_RANGE_M:
        yield Finding("ranges_unit", median)
    if not any(scan.is_return.any() for scan in scans):
        yield Finding("no_return", len(scans))
    steps = np.diff([each.own_s for each in sightings])
    repeated, decreased = (int(np.count_nonzero(is_one)) for is_one in (steps == 0.0, steps < 0.0))
    if out_of_order := decreased + repeated * (2 * repeated > len(steps)):
        yield Finding("stamps", out_of_order)
    if stands and _scans_move(some):
        yield Finding("frozen_odometry")
    turns = [] if odometry is None or stands else [*_of_turns(sightings, odometry, candidates)]
    yield from turns
    if candidates and not any(finding.kind in ("field_of_view", "assumed_beams") for finding in turns):
        yield _assumed(candidates[0], len(scans[0].ranges))


def _scans_move(scans: Sequence[Scan]) -> bool:
    """Whether scans differ in most of their beams: people who walk by change fewer."""
    changed = 0.0
    for scan in scans:
        count = min(len(scans[0].ranges), len(scan.ranges))
        here, there = (np.minimum(each.ranges[:count], MOST_RANGE_M) for each in (scans[0], scan))
        changed = max(changed, float(np.mean(np.abs(here - there) > _MOVED_M)))
    return changed > 0.5


def _of_odometry(odometry: Odometry) -> Iterator[Finding]:
    """Units, axes and jumps of odometry, which a robot on wheels follows along its heading."""
    jumps, passed = odometry.jumps(), passed_s(odometry.stamps_ns)
    moved = np.hypot(*np.diff(odometry.poses[:, :2], axis=0).T)
    moves = (moved > 0.0) & np.isfinite(passed)
    way = np.where(moves & (moved <= np.quantile(moved[moves], 0.9)), moved, 0.0) if moves.any() else 0.0 * moved
    wrong = None
    if np.count_nonzero(way) >= _FEWEST and way.sum() > _LEAST_WAY_M:
        speed = float(way.sum() / max(passed[moves].sum(), 1e-9))
        wrong = Finding("odometry_unit", speed) if speed > _FASTEST else _of_headings(odometry.poses, way)
        if speed < _SLOWEST and np.median(np.diff(odometry.stamps_ns)) > 1e8:  # not of stamps that are rounded
            yield Finding("stamps_unit", speed)
    if wrong is not None:
        yield wrong
    elif len(jumps):
        worst = jumps[np.argmax(moved[jumps - 1])]
        after_s = seconds(int(odometry.stamps_ns[worst] - odometry.stamps_ns[0]))
        times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
        yield Finding("jump", float(moved[worst - 1]), place=f"{times}, after {after_s:.1f} s")


def _of_headings(poses: Array, way: Array) -> Finding | None:
    """What is wrong with the headings of (N, 3) poses, by the share of the way that goes along them or against them.

    `way` (N - 1,), m, is that from each pose to the next; 0 where it does not count.
    """
    heading, (dx, dy) = poses[:-1, 2], np.diff(poses[:, :2], axis=0).T
    course, share = np.arctan2(dy, dx), way / way.sum()
    turns = np.radians(np.abs(np.diff(poses[:, 2])))
    if (np.abs(turns - 2.0 * math.pi) < _TURNED_RAD).any() and np.abs(heading).max() <= 364:
        return Finding("headings_unit")  # which wrap by 360
    is_straight = np.ptp(np.unwrap(heading)) < _TURNED_RAD or np.abs(share @ np.exp(2j * course)) > _ALONG
    if is_straight or share @ np.cos(2.0 * (course - heading)) > 0.5:
        return None  # along a straight way goes any heading that hardly changes
    degrees = np.unwrap(heading, period=360.0 if np.ptp(heading) > 2.0 * math.pi else 2.0 * math.pi)
    along = {  # 1 for one direction and its opposite, 0 for all of them
        "headings_unit": np.abs(share @ np.exp(2j * (course - np.radians(degrees)))),  # from any number of turns on
        "axes_exchanged": -share @ np.cos(2.0 * (course + heading)),  # of pi / 2 - course
    }
    best = max(along, key=lambda kind: float(along[kind]))
    return Finding(best) if along[best] > _ALONG else None


def _assumed(beams: Beams, count: int, by: str = "") -> Finding:
    """Of scans whose format leaves their beams open: these are as they usually are."""
    first, step = map(math.degrees, beams)
    return Finding("assumed_beams", place=f"from {first:g} to {first + step * (count - 1):g}°{by}")


def _gaps(log: Log) -> Iterator[Finding]:
    """Scans that have no odometry, but for those of a moment."""
    alone = np.array([tick.is_unmeasured and tick.scan is not None for tick in log.ticks])
    edges = np.flatnonzero(np.diff(np.concatenate([[0], alone, [0]])))
    at_s = [seconds(tick.stamp_ns - log.ticks[0].stamp_ns) for tick in log.ticks]
    spans = [(at_s[begin], at_s[end - 1]) for begin, end in edges.reshape(-1, 2).tolist() if end - begin > 1]
    if spans and log.odometry is not None:
        yield Finding("gap", float(alone.sum()), place=", ".join(f"from {a:.1f} to {b:.1f} s" for a, b in spans))


def _of_turns(sightings: Sequence[Sighting], odometry: Odometry, candidates: Sequence[Beams]) -> Iterator[Finding]:
    """The delay, the sign and the beams with which scans and odometry turn alike; nothing where the robot hardly turns.

    `candidates` are the beams that the scans may have; by default their own. Clocks may differ by two minutes where the
    robot turns in a way of its own, and by half a second in any case.
    """
    pairs, times_s = _pairs(sightings)
    known_s = seconds((odometry.stamps_ns - sightings[0].stamp_ns).astype(np.float64))
    if not len(pairs) or known_s[-1] <= known_s[0]:
        return
    poses = np.column_stack([odometry.poses[:, :2], np.unwrap(odometry.poses[:, 2])])

    def turned(some: NDArray[np.int64], lags_s: Array) -> Array:
        """(L, P) turns between the times of pairs by odometry that is so much later; NaN where it is not known."""
        at = np.interp(times_s[some] - lags_s[:, None, None], known_s, poses[:, 2], left=np.nan, right=np.nan)
        return np.asarray(at[..., 1] - at[..., 0])

    some, far_s = _evenly(np.arange(len(pairs))), 0.0
    coarse = np.arange(-_MOST_S, _MOST_S, 5.0 * _STEP_S)
    scans, sides = [each.scan for each in sightings], list[Beams | None](candidates) or [None]
    seen = _turns(scans, pairs[some], np.zeros((len(some), 3)), sides[0], 1)
    errors = _unexplained(seen, turned(some, coarse))
    best = int(np.argmin(errors))
    others = errors[np.abs(coarse - coarse[best]) > 2.0 * _FINE_S]
    is_explained = errors[best] < (1.0 - _EXPLAINED) * _squares(seen)
    if is_explained and abs(coarse[best]) > _FINE_S and _likelier(errors[best], others.min(), len(some)):
        far_s = float(coarse[best])
    lags = far_s + np.arange(-_FINE_S, _FINE_S + 0.5 * _STEP_S, _STEP_S)
    around = turned(np.arange(len(pairs)), lags[:: len(lags) // 6])
    turning = np.flatnonzero(np.isfinite(around).all(axis=0) & (np.abs(around).max(axis=0) > _TURN_RAD))
    if len(turning) < _FEWEST:
        return
    some = _evenly(turning)
    turns = turned(some, lags)
    columns = [np.interp(times_s[some] - far_s, known_s, column) for column in poses.T]
    moves = between(*(np.stack([column[:, k] for column in columns], axis=1) for k in (0, 1)))
    found = []
    for (k, beams), (sign, ahead) in itertools.product(enumerate(sides), ((1, 1.0), (-1, 1.0), (1, -1.0))):
        # behind: of a laser that looks back
        seen = _turns(scans, pairs[some], moves * (ahead, ahead, 1.0), beams, sign)
        found.append((k, sign, seen, _unexplained(seen, turns)))
    yield from _judged(found, turns, lags, candidates, len(scans[0].ranges))


def _judged(
    found: Sequence[tuple[int, int, Array, Array]], turns: Array, lags: Array, candidates: Sequence[Beams], beams: int
) -> Iterator[Finding]:
    """What is sure of the likeliest of candidates, signs and delays."""
    candidate, sign, seen, errors = min(found, key=lambda each: float(each[3].min()))
    best = int(np.clip(np.argmin(errors), 1, len(lags) - 2))
    turning, seen = np.column_stack([turns[best], seen])[np.isfinite(seen) & (np.abs(turns[best]) > _TURN_RAD)].T
    if (count := len(turning)) < _FEWEST:
        return
    least, lag_s = max(float(errors[best]), count * _NOISE_RAD**2), float(lags[best])
    sigma_s, is_sure = _sigma(errors, best, least / count), least < (1.0 - _EXPLAINED) * _squares(turning)
    is_late = lags[0] * lags[-1] > 0.0 or _likelier(least, errors[len(lags) // 2], count)
    if is_late and abs(lag_s) >= max(_LEAST_S, _SIGMAS * sigma_s) and (is_sure or abs(lag_s) < 1.0):
        yield Finding("clocks", lag_s, sigma_s)
    if is_sure and sign < 0:
        yield Finding("turned_around")
    ratio = float(seen @ turning) / float(turning @ turning)
    if not is_sure and _squares(seen - ratio * turning) < (1.0 - _EXPLAINED) * _squares(seen):
        yield Finding("turns_scaled", ratio)
    others = [each[3].min() for each in found if each[0] != candidate]
    if candidates and is_sure and all(_likelier(least, other, count) for other in others):
        by = ", by the turns that odometry and scans see"
        value = min(-2.0 * candidates[candidate].first, 2.0 * math.pi)  # centred, as `beams_over` has them
        yield Finding("field_of_view", value) if candidate else _assumed(candidates[0], beams, by)


def _pairs(sightings: Sequence[Sighting]) -> tuple[NDArray[np.int64], Array]:
    """(P, 2) rows of scans that are compared, and (P, 2) times of the middle of their sweeps, s since the first."""
    times_s = seconds(np.array([each.stamp_ns - sightings[0].stamp_ns for each in sightings], dtype=np.float64))
    times_s -= 0.5 * np.array([abs(float(scan.time_increment)) * (len(scan.ranges) - 1) for _, scan, _ in sightings])
    later = np.searchsorted(times_s, times_s + _APART_S - EXACT_S)
    first = np.flatnonzero(later < len(times_s))
    apart = times_s[later[first]] - times_s[first]
    first = first[(apart > 0.0) & (apart < 2.0)]
    pairs = np.stack([first, later[first]], axis=1)
    return pairs, times_s[pairs]


def _evenly(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """At most `_PAIRS` of these rows."""
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(_PAIRS, len(rows))).astype(np.int64))]


def _squares(off: Array) -> Array:
    """Sums of squares along the last axis, each capped; what is not known adds nothing."""
    return np.asarray(np.nansum(np.minimum(np.abs(off), _CAP_RAD) ** 2, axis=-1))


def _unexplained(seen: Array, turns: Array) -> Array:
    """(L,) squared errors of turns by odometry (L, P) beside those seen (P,); of no turn where these are not known."""
    return _squares(np.where(np.isnan(turns), seen, wrap_angle(seen - turns)))


def _likelier(least: float, other: float, count: int) -> bool:
    """Whether so many errors with the least sum of squares are likelier than those with another one."""
    return 0.5 * count * math.log(max(other / least, 1.0)) > _LIKELIER


def _sigma(errors: Array, best: int, variance: float) -> float:
    """Of the delay with the least of errors (L,), by how fast these rise around it; infinite at an end."""
    wide = min(best, len(errors) - 1 - best, 5)
    bend = (errors[best - wide] + errors[best + wide] - 2.0 * errors[best]) / (wide * _STEP_S) ** 2
    return math.sqrt(2.0 * variance / bend) if bend > 0.0 and errors[best] == errors.min() else math.inf


def _turns(scans: Sequence[Scan], pairs: NDArray[np.int64], motions: Array, beams: Beams | None, sign: int) -> Array:
    """(P,) turns between pairs of scans, rad; NaN where they are not seen.

    The earlier one is drawn from where motions (P, 3) of the robot have the laser later; both with these beams, or with
    their own, and with a sign of -1 mirrored.
    """
    mount = scans[0].T_robot_laser.array()
    moves = between(mount, compose(motions, mount))  # of the laser, in its frame before; its turn is looked for
    before = _views([scans[k] for k in pairs[:, 0].tolist()], moves @ (1.0, 1j, 0.0), beams, sign)
    after = _views([scans[k] for k in pairs[:, 1].tolist()], np.zeros(len(pairs)), beams, sign)
    shifts = np.arange(-_SHIFTS, _SHIFTS + 1)
    errors, around = np.full((len(shifts), len(before)), np.inf), np.hstack([before, before])
    for row, shift in enumerate((shifts % _BINS).tolist()):
        off = around[:, shift : shift + _BINS] - after
        count = _BINS - np.count_nonzero(np.isnan(off), axis=1)
        capped_m = np.fmin(np.abs(off), np.float32(_MOST_M)).sum(axis=1)  # with the cap where nothing is seen
        mean_m = (capped_m - _MOST_M * (_BINS - count)) / np.maximum(count, 1)
        errors[row] = np.where(count >= _FEWEST_BINS, mean_m, np.inf)
    best = np.clip(np.argmin(errors, axis=0), 1, len(shifts) - 2)
    low, here, high = (errors[best + side, np.arange(len(before))] for side in (-1, 0, 1))
    with np.errstate(invalid="ignore", divide="ignore"):
        bend = low - 2.0 * here + high
        part = np.where(bend > 1e-9, 0.5 * (low - high) / bend, 0.0)
    is_seen = np.isfinite(low + high) & (here <= np.minimum(low, high))
    return np.where(is_seen, (shifts[best] + part) * (2.0 * np.pi / _BINS), np.nan)


def _views(scans: Sequence[Scan], places: NDArray[Any], beams: Beams | None, sign: int) -> NDArray[np.float32]:
    """(P, _BINS) range by bearing, m, of scans as seen from places x + iy of their frames; NaN where none is near."""
    rows = np.repeat(np.arange(len(scans)), [len(scan.ranges) for scan in scans])
    ranges = np.concatenate([scan.ranges for scan in scans])
    bearings = [beams.first + beams.step * np.arange(len(s.ranges)) if beams else s.bearings for s in scans]
    is_near = np.concatenate([scan.is_return for scan in scans]) & (ranges < _FAR_M)
    turned = np.exp((1j * sign * np.concatenate(bearings)[is_near]).astype(np.complex64))
    rows, points = rows[is_near], ranges[is_near] * turned - places.astype(np.complex64)[rows[is_near]]
    bins = np.floor(np.angle(points) * (_BINS / (2.0 * np.pi))).astype(np.int64) % _BINS
    out = np.full(len(scans) * _BINS, np.inf, dtype=np.float32)
    np.minimum.at(out, rows * _BINS + bins, np.abs(points))
    return np.where(np.isfinite(out), out, np.float32(np.nan)).reshape(-1, _BINS)


class Mount(NamedTuple):
    """Where the laser sits by the motions of wheels and scans, beyond where it is stated to be."""

    offset: Array
    """(3,) x, y (m, robot's axes) and heading, rad"""
    sigmas: Array
    """(3,)"""
    scale: float
    """of the wheels' distances: true ones are this times as long"""
    scale_sigma: float
    is_reversed: bool
    """whether the wheels report the wrong sign of distances"""


def hand_eye(wheels: Array, path: Array, sigmas_m: Array) -> Mount | None:
    """The mount and the scale of wheels that explain motions best; None where these leave them open.

    `wheels` and `path` (N, 3) are motions of the robot by its wheels, and by scans that are put together as if the
    laser were where it is stated to be; `sigmas_m` (N,) of their positions. With the laser off by X the path moves by
    T, where the robot moves by W, as W X = X T. For small X: (R_W - I) x = R_X t_T - s t_W, linear in x, the heading
    and the scale of the wheels. A drive on one circle leaves these open. A laser that looks back and wheels that count
    backward look alike, but robots drive forward. Weights are those of Huber, so that slips do not count.
    """
    if len(wheels) < 8:
        return None
    turn, by_wheels, by_path = np.exp(1j * wheels[:, 2]) - 1.0, *(each[:, :2] @ (1.0, 1j) for each in (wheels, path))
    columns = np.stack([turn, 1j * turn, -1j * by_path, by_wheels], axis=1)
    rows, right = np.concatenate([columns.real, columns.imag]), np.concatenate([by_path.real, by_path.imag])
    spread = np.concatenate([sigmas_m] * 2)
    weights = 1.0 / spread
    for _ in range(10):
        values, *_ = np.linalg.lstsq(rows * weights[:, None], right * weights, rcond=None)
        off = np.abs(right - rows @ values) / spread
        usual = max(1.4826 * float(np.median(off)), 0.05)
        weights = np.sqrt(np.minimum(1.0, 1.5 * usual / np.maximum(off, 1e-9))) / spread
    weighted = rows * weights[:, None]
    if np.linalg.svd(weighted, compute_uv=False)[-1] < _SIGMAS * usual * math.sqrt(len(wheels)):
        return None  # what the noise of the motions alone makes of it
    sigmas = usual * np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    offset, scale = np.asarray(values[:3], dtype=np.float64), float(values[3])
    is_reversed = scale < 0.0 and bool(-wheels[:, 0].sum() > _ALONG * np.abs(wheels[:, 0]).sum())
    if scale < 0.0 and not is_reversed:  # R_X turned by pi changes the sign of x and of the scale
        offset = np.array([-offset[0], -offset[1], wrap_angle(offset[2] + math.pi)])
    return Mount(offset, sigmas[:3], abs(scale), float(sigmas[3]), is_reversed)


def beside_wheels(found: Mount, stated: Pose) -> list[Finding]:
    """What a mount and a scale of wheels, beside the mount that is stated, say of both."""
    findings = [Finding("wheels_reversed")] * found.is_reversed
    if abs(found.scale - 1.0) > max(_SCALE_OFF, _SIGMAS * found.scale_sigma):
        findings.append(Finding("odometry_scale", found.scale, found.scale_sigma))
    off = np.abs(found.offset) > np.maximum(_OFF, _SIGMAS * found.sigmas)
    if off.any():
        offset = Pose(*np.where(off, found.offset, 0.0).tolist())
        fits, (x, y, turn) = offset @ stated, offset.array()
        place = f"{x:+.2f} m ahead, {y:+.2f} m to the left and {math.degrees(turn):+.0f}° turned from its stated mount"
        findings.append(Finding("mount", place=place, vector=(fits.x, fits.y, fits.theta)))
    return findings
