"""What is odd in a log: the one place that decides whether clocks, lasers, mounts, units and odometry are right."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from sixthsense.config import Config, merge
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import MOST_RANGE_M, Scan
from sixthsense.core.source import seconds
from sixthsense.logs.finding import Finding
from sixthsense.logs.joining import Odometry, Sighting
from sixthsense.logs.laser_geometry import beams_over
from sixthsense.logs.log import Log
from sixthsense.logs.stamps import passed_s
from sixthsense.logs.turns import Fit, fit_turns

DEGREES = math.pi / 180.0
_COMPARED = 100  # scans, evenly over the log
_MOVED_M, _MOST = 0.3, 0.5  # by which a range has changed, and the share of beams
_FASTEST = 20.0  # m/s of a vehicle; a slow robot in centimetres is faster
_FEWEST, _LEAST_WAY_M, _ALONG, _ACROSS = 10, 1.0, 0.85, 0.5
"""motions and way, m, that say something; shares of a way along a heading that is its own, and across another one"""
_BACKWARD, _TURNED_RAD = 0.95, 0.5  # share of the way; and by which headings differ that say something
_SIGMAS, _LEAST_S, _SCALE_OFF = 4.0, 0.08, 0.15
"""of a value that is not chance; a delay and a scale that are worth a word"""
_OFF = (0.1, 0.1, 4.0 * DEGREES)
"""the same of a mount: x, y, m, and heading"""


def diagnose(log: Log) -> list[Finding]:
    """What its reader and its numbers say of a log, of scans so far where it goes on.

    Each kind of finding is said, refused or applied by `settled`, as `KINDS` has it.
    """
    return [*log.found, *findings_of(log.sightings, log.odometry, log.candidates), *_gaps(log)]


def settled(log: Log, config: Config) -> tuple[Log, Config, list[Finding]]:
    """A log and a configuration with what is found out about it applied; and what is to be said.

    What the configuration states is not looked for. Raises InputError for a log that cannot be right.
    """
    log = log.later(config.time_offset or 0.0)
    said = []
    for finding in [*log.found, *findings_of(log.sightings, log.odometry, log.candidates)]:
        if finding.action == "refused":
            raise InputError("log", f"found {finding.text}", "metres, radians, and one clock")
        if finding.kind == "clocks":
            if config.time_offset is not None:
                continue
            offset_s = round(finding.value, 3)
            log, config = log.later(offset_s), merge(config, {"time_offset": offset_s})
        elif finding.kind == "field_of_view":
            log = log.with_beams(*beams_over(finding.value, len(log.scans[0].ranges)))
        elif finding.kind == "frozen_odometry":
            if config.no_odometry:
                continue
            log, config = log.without_odometry(), merge(config, {"no_odometry": True})
        said.append(finding)
    return log, config, [*said, *_gaps(log)]


def findings_of(
    sightings: Sequence[Sighting], odometry: Odometry | None, candidates: Sequence[tuple[float, float]] = ()
) -> Iterator[Finding]:
    """What scans and odometry say, or poses alone; `candidates` as those of a `Log`."""
    stands = odometry is not None and not (odometry.poses != odometry.poses[0]).any()
    if odometry is not None and not stands:
        yield from _of_odometry(odometry)
    if not sightings:
        return
    scans = [each.scan for each in sightings]
    yield from _of_ranges(scans)
    steps = np.diff([each.own_s for each in sightings])
    repeated = int(np.count_nonzero(steps == 0.0))
    out_of_order = int(np.count_nonzero(steps < 0.0)) + repeated * (2 * repeated > len(steps))
    if out_of_order:
        yield Finding("stamps", out_of_order)
    fit = None
    if odometry is not None and not stands:
        fit = fit_turns(sightings, odometry, candidates)
    elif odometry is not None and len(scans) > 1:
        yield Finding("frozen_odometry" if _scans_move(scans) else "still")
    if fit is not None:
        yield from _of_turns(fit, open_beams=bool(candidates))
    if candidates:
        yield _beams(len(scans[0].ranges), candidates, fit)
    if odometry is not None and (fit is None or not fit.is_lag):
        first, last = (seconds(int(odometry.stamps_ns[k])) for k in (0, -1))
        spans = seconds(sightings[0].stamp_ns), seconds(sightings[-1].stamp_ns)
        if spans[0] > last or spans[1] < first:
            place = f"scans from {spans[0]:.3f} to {spans[1]:.3f} s, odometry from {first:.3f} to {last:.3f} s"
            yield Finding("one_clock", place=place)


def _some(scans: Sequence[Scan]) -> Sequence[Scan]:
    return scans[:: max(1, len(scans) // _COMPARED)]


def _of_ranges(scans: Sequence[Scan]) -> Iterator[Finding]:
    """Ranges that cannot be metres, and scans without a return."""
    returns = np.concatenate([scan.ranges[scan.is_return] for scan in _some(scans)])
    if len(returns) and (median := float(np.median(returns))) > MOST_RANGE_M:
        yield Finding("ranges_unit", median)
    if not len(returns) and not any(scan.is_return.any() for scan in scans):
        yield Finding("no_return", len(scans))


def _scans_move(scans: Sequence[Scan]) -> bool:
    """Whether scans differ in most of their beams: people who walk by change fewer."""
    first, changed = scans[0].ranges, []
    for scan in _some(scans):
        count = min(len(first), len(scan.ranges))
        here, there = (np.minimum(ranges[:count], MOST_RANGE_M) for ranges in (first, scan.ranges))
        changed.append(float(np.mean(np.abs(here - there) > _MOVED_M)))
    return max(changed) > _MOST


def _of_odometry(odometry: Odometry) -> Iterator[Finding]:
    """Units, axes and jumps of odometry, which a robot on wheels follows along its heading."""
    jumps = odometry.jumps()
    passed, steps = passed_s(odometry.stamps_ns), np.diff(odometry.poses, axis=0)
    moved = np.hypot(steps[:, 0], steps[:, 1])
    moves = (moved > 0.0) & np.isfinite(passed)
    way = np.where(moves & (moved <= np.quantile(moved[moves], 0.9)), moved, 0.0) if moves.any() else 0.0 * moved
    wrong = None
    if np.count_nonzero(way) >= _FEWEST and way.sum() > _LEAST_WAY_M:
        speed = float(way.sum() / max(passed[moves].sum(), 1e-9))
        wrong = Finding("odometry_unit", speed) if speed > _FASTEST else _of_headings(odometry.poses, way)
    if wrong is not None:
        yield wrong
    elif len(jumps):
        sizes = moved[jumps - 1]
        at_s = seconds(int(odometry.stamps_ns[jumps[np.argmax(sizes)]] - odometry.stamps_ns[0]))
        times = "once" if len(jumps) == 1 else f"{len(jumps)} times"
        yield Finding("jump", float(sizes.max()), place=f"{times}, after {at_s:.1f} s")


def _of_headings(poses: Array, way: Array) -> Finding | None:
    """What is wrong with the headings of (N, 3) poses, by the share of the way that goes along them or against them.

    `way` (N - 1,), m, is that from each pose to the next; 0 where it does not count.
    """
    steps, heading, total = np.diff(poses[:, :2], axis=0), poses[:-1, 2], way.sum()
    course = np.arctan2(steps[:, 1], steps[:, 0])
    turns = DEGREES * np.abs(np.diff(poses[:, 2]))
    if (np.abs(turns - 2.0 * math.pi) < _TURNED_RAD).any() and np.abs(heading).max() <= 364:
        return Finding("headings_unit")  # which wrap by 360
    if way @ np.abs(np.sin(course - heading)) < _ACROSS * total:
        back = float(way @ (np.cos(course - heading) < 0.0) / total)
        return Finding("driven_backward", back) if back > _BACKWARD else None
    if np.ptp(np.unwrap(heading)) < _TURNED_RAD or np.abs(way @ np.exp(2j * course)) > _ALONG * total:
        return None  # along a straight way goes any heading that hardly changes
    read_as = {
        "headings_unit": course
        - DEGREES * np.unwrap(heading, period=360.0 if np.ptp(heading) > 7.0 else 2.0 * math.pi),
        "headings_inverted": course + heading,
        "axes_exchanged": math.pi / 2.0 - course - heading,
    }
    # 1 for one direction and its opposite, 0 for all of them
    shares = {kind: way @ np.exp(2j * off) / total for kind, off in read_as.items()}
    shares["headings_unit"] = np.abs(shares["headings_unit"])  # its first one is any number of turns off
    best = max(shares, key=lambda kind: shares[kind].real)
    return Finding(best) if shares[best].real > _ALONG else None


def _of_turns(fit: Fit, open_beams: bool) -> Iterator[Finding]:
    """What turns say of clocks, of a mirror, and of the angles of beams or the turns of wheels."""
    if (
        fit.is_lag
        and abs(fit.lag_s) >= max(_LEAST_S, _SIGMAS * fit.lag_sigma_s)
        and (fit.is_sure or abs(fit.lag_s) < 1.0)
    ):
        yield Finding("clocks", fit.lag_s, fit.lag_sigma_s)
    if fit.is_sure and fit.sign < 0:
        yield Finding("turned_around")
    off = abs(math.log(max(fit.scale, 1e-3)))
    if fit.is_sure and not open_beams and off > max(_SCALE_OFF, _SIGMAS * fit.scale_sigma):
        yield Finding("turn_scale", fit.scale, fit.scale_sigma)


def _beams(count: int, candidates: Sequence[tuple[float, float]], fit: Fit | None) -> Finding:
    """The beams of scans whose format leaves them open: by the turns, or as they usually are."""
    is_found = fit is not None and fit.is_candidate and fit.is_sure
    if fit is not None and is_found and fit.candidate > 0:
        value = min(-2.0 * candidates[fit.candidate][0], 2.0 * math.pi)  # centred, as `beams_over` has them
        return Finding("field_of_view", value, value * fit.scale_sigma)
    first, step = (math.degrees(angle) for angle in candidates[0])
    by = ", by the turns that odometry and scans see" * is_found
    return Finding("assumed_beams", place=f"from {first:g} to {first + step * (count - 1):g}°{by}")


def _gaps(log: Log) -> Iterator[Finding]:
    """Scans that have no odometry, but for those of a moment."""
    if not log.sightings or log.odometry is None:
        return
    alone = np.array([tick.is_unmeasured and tick.scan is not None for tick in log.ticks])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], alone, [False]]).astype(int)))
    spans = [(begin, end) for begin, end in edges.reshape(-1, 2).tolist() if end - begin > 1]
    if spans:
        stamps_s = [seconds(tick.stamp_ns - log.ticks[0].stamp_ns) for tick in log.ticks]
        shown = ", ".join(f"from {stamps_s[begin]:.1f} to {stamps_s[end - 1]:.1f} s" for begin, end in spans[:4])
        more = f" and {len(spans) - 4} more times" * (len(spans) > 4)
        yield Finding("gap", float(alone.sum()), place=shown + more)


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
    c, s, n = np.cos(wheels[:, 2]) - 1.0, np.sin(wheels[:, 2]), len(wheels)
    rows, right = np.zeros((2 * n, 4)), np.concatenate([path[:, 0], path[:, 1]])
    rows[:n] = np.stack([c, -s, path[:, 1], wheels[:, 0]], axis=1)
    rows[n:] = np.stack([s, c, -path[:, 0], wheels[:, 1]], axis=1)
    spread = np.concatenate([sigmas_m] * 2)
    weights = 1.0 / spread
    for _ in range(10):
        values, *_ = np.linalg.lstsq(rows * weights[:, None], right * weights, rcond=None)
        off = np.abs(right - rows @ values) / spread
        usual = max(1.4826 * float(np.median(off)), 0.05)
        weights = np.sqrt(np.minimum(1.0, 1.5 * usual / np.maximum(off, 1e-9))) / spread
    weighted = rows * weights[:, None]
    if np.linalg.svd(weighted, compute_uv=False)[-1] < _SIGMAS * usual * math.sqrt(n):
        return None  # what the noise of the motions alone makes of it
    sigmas = usual * np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    offset, scale, is_reversed = np.asarray(values[:3], dtype=np.float64), float(values[3]), False
    if scale < 0.0:
        ahead = np.minimum(wheels[:, 0], 0.0).sum() / -np.abs(wheels[:, 0]).sum()
        is_reversed = bool(ahead > _BACKWARD)
        if not is_reversed:  # R_X turned by pi changes the sign of x and of the scale
            offset = np.array([-offset[0], -offset[1], wrap_angle(offset[2] + math.pi)])
    return Mount(offset, sigmas[:3], abs(scale), float(sigmas[3]), is_reversed)


def beside_wheels(found: Mount, stated: Pose) -> list[Finding]:
    """What a mount and a scale of wheels, beside the mount that is stated, say of both."""
    findings, offset = [Finding("wheels_reversed")] * found.is_reversed, found.offset
    if abs(found.scale - 1.0) > max(_SCALE_OFF, _SIGMAS * found.scale_sigma):
        findings.append(Finding("odometry_scale", found.scale, found.scale_sigma))
    off = np.abs(offset) > np.maximum(_OFF, _SIGMAS * found.sigmas)
    if off.any():
        fits = Pose(*np.where(off, offset, 0.0).tolist()) @ stated
        x, y, turn = np.abs(offset)
        parts = np.array([
            f"{x:.2f} m farther {'back' if offset[0] < 0.0 else 'forward'}",
            f"{y:.2f} m farther {'right' if offset[1] < 0.0 else 'left'}",
            f"{math.degrees(turn):.0f}° turned {'right' if offset[2] < 0.0 else 'left'}",
        ])  # fmt: skip
        place = f"{' and '.join(parts[off])} than its mount is stated"
        findings.append(Finding("mount", place=place, vector=(fits.x, fits.y, fits.theta)))
    return findings
