"""Logs that make a map wrong: what a person does to a robot, a laser or a file, beyond `damaged_logs`.

The true poses (n, 3) of the ticks, of the robot, go along: where ticks are cut, so are they.
"""

from __future__ import annotations

import dataclasses
import math
import zlib
from collections.abc import Callable, Sequence

import numpy as np
from damaged_logs import DAMAGES, steps_of, with_steps

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick

Ticks = Sequence[Tick]
Wrong = tuple[list[Tick], Array]


def changed(name: str, ticks: Ticks, truth: Array, seed: int) -> Wrong:
    """The damage `name` of `WRONG` or of `damaged_logs.DAMAGES` done to ticks with scans."""
    rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
    if name in WRONG:
        return WRONG[name](ticks, truth, rng)
    row = {tick.stamp_ns: k for k, tick in enumerate(ticks)}
    found = list(DAMAGES[name](ticks, rng))
    ends_ns = ticks[0].stamp_ns + ticks[-1].stamp_ns
    own = [row[ends_ns - tick.stamp_ns if name == "backwards" else tick.stamp_ns] for tick in found]
    poses = truth[own]
    return found, poses * (1.0, -1.0, -1.0) if name == "mirrored" else poses


def laser_mirrored(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """Ranges from right to left, the wheels as they are."""
    return _with_scans(ticks, lambda scan: dataclasses.replace(scan, ranges=scan.ranges[::-1].copy())), truth


def mount_off(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """A laser stated 0.3 to 0.6 m beside where it is."""
    at, far = rng.uniform(0.0, 2.0 * math.pi), rng.uniform(0.3, 0.6)
    off = Pose(far * math.cos(at), far * math.sin(at), 0.0)
    return _with_scans(ticks, lambda scan: dataclasses.replace(scan, T_robot_laser=off @ scan.T_robot_laser)), truth


def mount_turned(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """A laser stated 8 to 20 degrees beside where it looks."""
    off = Pose(0.0, 0.0, rng.choice((-1.0, 1.0)) * rng.uniform(0.14, 0.35))
    return _with_scans(ticks, lambda scan: dataclasses.replace(scan, T_robot_laser=scan.T_robot_laser @ off)), truth


def increment(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """Beams 5 to 25 % closer or farther apart than they are."""
    factor = np.float32(1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(0.05, 0.25))

    def of(scan):  # type: ignore[no-untyped-def]
        wider = {"angle_min": scan.angle_min * factor, "angle_increment": scan.angle_increment * factor}
        return dataclasses.replace(scan, **wider)

    return _with_scans(ticks, of), truth


def kidnapped(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """The robot is carried for 4 to 20 m of its way, while its wheels stand."""
    return _cut(ticks, truth, rng, (4.0, 20.0), Pose())


def joined(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """The second half first, and then the first half, as if the robot had not moved between."""
    middle = len(ticks) // 2 + int(rng.integers(-len(ticks) // 8, len(ticks) // 8))
    order = [*range(middle, len(ticks)), *range(middle)]
    return _resumed([ticks[k] for k in order], ticks, len(ticks) - middle, Pose()), truth[order]


def gap_lost(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """No scans for 4 to 12 m, over which the wheels are wrong by a meter or more, and a large turn."""
    off = Pose(rng.uniform(-3.0, 3.0), rng.choice((-1.0, 1.0)) * rng.uniform(1.0, 3.0), rng.uniform(-1.2, 1.2))
    return _cut(ticks, truth, rng, (4.0, 12.0), off, keeps=True)


def blinded(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """No return on 8 to 20 m, where the wheels are wrong by 10 to 25 % and drift."""
    first, past = _stretch(truth, rng, (8.0, 20.0))
    found, scale = list(ticks), 1.0 + rng.choice((-1.0, 1.0)) * rng.uniform(0.1, 0.25)
    steps = steps_of(ticks)
    steps[first:past, :2] *= scale
    steps[first:past, 2] += rng.choice((-1.0, 1.0)) * rng.uniform(0.03, 0.08) * np.hypot(*steps[first:past, :2].T)
    for k in range(first, past):
        scan = found[k].scan
        assert scan is not None
        found[k] = dataclasses.replace(
            found[k], scan=dataclasses.replace(scan, ranges=np.full_like(scan.ranges, np.inf))
        )
    return with_steps(found, steps), truth


def clocks(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """Odometry that is 0.5 to 2.5 s old."""
    late_s, poses = rng.uniform(0.5, 2.5), _odometry(ticks)
    poses[:, 2] = np.unwrap(poses[:, 2])
    stamps_s = 1e-9 * np.array([tick.stamp_ns for tick in ticks])
    old = np.stack([np.interp(stamps_s - late_s, stamps_s, column) for column in poses.T], axis=1)
    return [dataclasses.replace(t, odometry=Pose.from_array(p)) for t, p in zip(ticks, old, strict=True)], truth


def bad_wheels(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """Wheels that are wrong by 30 % forward and 20 % in turns."""
    steps, side = steps_of(ticks), rng.choice((-1.0, 1.0), 2)
    steps[:, :2] *= 1.0 + 0.3 * side[0]
    steps[:, 2] *= 1.0 + 0.2 * side[1]
    return with_steps(ticks, steps), truth


def slipped(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """Twice the wheels spin for 2 to 5 m, or turn by 0.7 to 2 rad, over two seconds."""
    steps = steps_of(ticks)
    for at in (0.35, 0.7):
        first = int(at * len(steps)) + int(rng.integers(-20, 20))
        past = first + 10
        if rng.random() < 0.5:
            steps[first:past, 0] += rng.uniform(2.0, 5.0) / 10
        else:
            steps[first:past, 2] += rng.choice((-1.0, 1.0)) * rng.uniform(0.7, 2.0) / 10
    return with_steps(ticks, steps), truth


def unrolled(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """A fan of 240 degrees stated as one of 180, or the other way round."""
    factor = np.float32(rng.choice((0.75, 1.0 / 0.75)))

    def of(scan):  # type: ignore[no-untyped-def]
        stated = {"angle_min": scan.angle_min * factor, "angle_increment": scan.angle_increment * factor}
        return dataclasses.replace(scan, **stated)

    return _with_scans(ticks, of), truth


def spun(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """Twice the robot is turned by hand, 0.4 to 0.7 rad between scans, with odometry that is one scan ahead."""
    period_ns = int(np.median(np.diff([tick.stamp_ns for tick in ticks])))
    kept, fast = [0], set[int]()
    windows = _turning(ticks, 2)
    for k in range(1, len(ticks)):
        is_fast = any(first <= k < past for first, past in windows)
        if is_fast and abs(_turned(ticks, kept[-1], k)) < rng.uniform(0.4, 0.7):
            continue
        if is_fast:
            fast.add(k)
        kept.append(k)
    found, stamp_ns = [ticks[0]], ticks[0].stamp_ns
    for n, k in enumerate(kept[1:], start=1):
        stamp_ns += period_ns if k in fast else ticks[k].stamp_ns - ticks[k - 1].stamp_ns
        ahead = ticks[kept[min(n + 1, len(kept) - 1)] if k in fast else k].odometry
        found.append(dataclasses.replace(ticks[k], stamp_ns=stamp_ns, odometry=ahead))
    return found, truth[kept]


def turned_in_place(ticks: Ticks, truth: Array, rng: np.random.Generator) -> Wrong:
    """The robot is turned by hand while its wheels stand and its laser is covered."""
    first, past = _turning(ticks, 1)[0]
    kept = [*range(first + 1), *range(past, len(ticks))]
    return _resumed([ticks[k] for k in kept], ticks, first + 1, Pose()), truth[kept]


WRONG: dict[str, Callable[[Ticks, Array, np.random.Generator], Wrong]] = {
    each.__name__: each
    for each in (
        laser_mirrored, mount_off, mount_turned, increment, kidnapped, joined, gap_lost, blinded, clocks, bad_wheels,
        slipped, unrolled, spun, turned_in_place,
    )
}  # fmt: skip


def _with_scans(ticks: Ticks, of: Callable) -> list[Tick]:  # type: ignore[type-arg]
    return [dataclasses.replace(tick, scan=of(tick.scan)) for tick in ticks]


def _odometry(ticks: Ticks) -> Array:
    return np.array([tick.odometry.array() for tick in ticks])


def _stretch(truth: Array, rng: np.random.Generator, length_m: tuple[float, float]) -> tuple[int, int]:
    """First tick and the one past the last of a stretch of the way, in the middle half."""
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(truth[:, :2], axis=0).T))])
    own = min(rng.uniform(*length_m), 0.4 * way[-1])
    begin = rng.uniform(0.25, 0.7) * way[-1] - 0.5 * own
    first, past = np.searchsorted(way, [max(begin, 0.05 * way[-1]), begin + own])
    return int(first), int(min(past, len(truth) - 20))


def _turning(ticks: Ticks, count: int, over: int = 30) -> list[tuple[int, int]]:
    """First and past the last tick of the `count` stretches of as many ticks `over` which the robot turns most."""
    turns = np.convolve(np.abs(steps_of(ticks)[:, 2]), np.ones(over), "valid")
    found: list[tuple[int, int]] = []
    for _ in range(count):
        first = int(np.argmax(turns))
        turns[max(first - 2 * over, 0) : first + 2 * over] = -1.0
        found.append((first, first + over))
    return found


def _turned(ticks: Ticks, first: int, last: int) -> float:
    return (ticks[first].odometry.inverse() @ ticks[last].odometry).theta


def _cut(
    ticks: Ticks, truth: Array, rng: np.random.Generator, length_m: tuple[float, float], off: Pose, keeps: bool = False
) -> Wrong:
    """Without the ticks of a stretch; the wheels stand meanwhile, or report the way with an error `off`."""
    first, past = _stretch(truth, rng, length_m)
    motion = (ticks[first].odometry.inverse() @ ticks[past].odometry @ off) if keeps else off
    kept = [*range(first + 1), *range(past, len(ticks))]
    return _resumed([ticks[k] for k in kept], ticks, first + 1, motion, keeps), truth[kept]


def _resumed(chosen: Ticks, ticks: Ticks, at: int, motion: Pose, keeps_time: bool = False) -> list[Tick]:
    """Chosen ticks whose odometry moves by `motion` before the one `at`, with ascending stamps."""
    back = chosen[at - 1].odometry @ motion @ chosen[at].odometry.inverse()
    period_ns = (ticks[-1].stamp_ns - ticks[0].stamp_ns) // max(len(ticks) - 1, 1)
    late_ns = 0 if keeps_time else chosen[at - 1].stamp_ns + max(period_ns, 1) - chosen[at].stamp_ns
    later = [
        dataclasses.replace(tick, odometry=back @ tick.odometry, stamp_ns=tick.stamp_ns + late_ns)
        for tick in chosen[at:]
    ]
    return [*chosen[:at], *later]
