"""Buildings that repeat themselves, and drives through them with wheels that lie.

Each scene is drawn anew for each seed: the building's measures, the path, the wheels' noise and the laser's. A drive is
a log, with the truth at every tick.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from generated_worlds import box, closed

from sixthsense.config import LaserConfig, preset
from sixthsense.core.geometry import Array, Pose, wrap_angle
from sixthsense.core.laser import Scan, beam_bearings
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Tick
from sixthsense.logs.log import Log

Point = tuple[float, float]

_STEP_M, _STEP_RAD = 0.12, 0.12  # between two scans
_PERIOD_NS = 200_000_000
_WEAVE_M, _WEAVE_APART_M = 0.12, 4.0  # a robot does not drive along the same line twice
_SLIP_M, _SLIP_OVER_M = 1.0, 0.5  # distance that wheels spin, and the distance that the robot drives meanwhile
_SLIP_PER_SQRT_M = 0.01  # of the position


Building = tuple[Array, list[Point]]
"""walls (N, 2, 2), m, and the corners of a drive through them"""


class Scene(NamedTuple):
    """A kind of building and the laser that sees it."""

    draw: Callable[[np.random.Generator], Building]
    laser: LaserConfig
    slips: int = 0
    """how often the wheels spin by a metre"""
    beam_sigma_m: float = 0.01


def corridor_of_doors(rng: np.random.Generator) -> Building:
    """A corridor with equal doors on both sides, driven up, down, and up again."""
    length, width, pitch = rng.uniform(45, 60), rng.uniform(1.9, 2.6), rng.uniform(2.8, 4.0)
    outline = [*_side(0.0, length, 0.0, -0.15, pitch), *_side(length, 0.0, width, width + 0.15, pitch)]
    middle = width / 2
    return closed(outline), [(1.5, middle), (length - 1.5, middle), (1.5, middle), (length - 1.5, middle)]


def row_of_rooms(rng: np.random.Generator) -> Building:
    """Six equal rooms on either side of a corridor, half of them visited twice."""
    pitch, depth, width, door = 4.4, rng.uniform(3.6, 4.4), rng.uniform(1.9, 2.5), 1.0
    length, table = 6 * pitch, box(rng.uniform((1.0, 2.2), (3.2, depth - 1.0)), np.array([0.8, 0.5]))
    room = np.array([[[0, 0], [(pitch - door) / 2, 0]], [[(pitch + door) / 2, 0], [pitch, 0]], [[0, 0], [0, depth]],
                     [[pitch, 0], [pitch, depth]], [[0, depth], [pitch, depth]]])  # fmt: skip
    walls = [np.array([[[0, 0], [0, width]], [[length, 0], [length, width]]])]
    doors = []
    own = np.concatenate([room, table])
    for k in range(12):
        x, is_upper = pitch * (k % 6), k >= 6
        # The room of the other side is the same, turned by half a circle.
        walls.append(own + np.array([x, width]) if is_upper else np.array([x + pitch, 0.0]) - own)
        doors.append((x + pitch / 2, is_upper))
    middle, way = width / 2, [(0.8, width / 2)]
    order = [0, 7, 2, 9, 4, 11, 10, 3, 8, 1, 6, 0, 2, 9, 4, 11, 3]
    for k in order:
        x, is_upper = doors[k]
        inside = width + 1.5 if is_upper else -1.5
        way += [(x, middle), (x, inside), (x, middle)]
    return np.concatenate(walls), way


def square_of_niches(rng: np.random.Generator) -> Building:
    """Two laps around a square of corridors, of more than 100 m, with equal niches on both sides."""
    side, width, pitch = rng.uniform(27, 32), rng.uniform(2.0, 2.8), rng.uniform(2.4, 3.6)
    walls = [closed(_square(0.0, side, -0.3, pitch)), closed(_square(width, side - width, 0.3, pitch))]
    near, far = width / 2, side - width / 2
    lap = [(near, near), (far, near), (far, far), (near, far)]
    return np.concatenate(walls), [*lap, *lap, (near, near), (far, near)]


def parallel_corridors(rng: np.random.Generator) -> Building:
    """Two long, bare, parallel corridors joined at their ends, of more than 150 m, driven around twice."""
    length, gap, width = rng.uniform(68, 80), rng.uniform(9, 14), rng.uniform(2.0, 3.0)
    outer = [(0.0, 0.0), (length, 0.0), (length, 2 * width + gap), (0.0, 2 * width + gap)]
    inner = [(width, width), (length - width, width), (length - width, width + gap), (width, width + gap)]
    near, low, far, high = width / 2, width / 2, length - width / 2, 1.5 * width + gap
    lap = [(near, low), (far, low), (far, high), (near, high)]
    places = zip(rng.uniform(5, length - 5, 4), (0.1, width - 0.1) * 2, strict=True)
    few = [box(np.array(place), np.array([0.4, 0.15])) for place in places]
    return np.concatenate([closed(outer), closed(inner), *few]), [*lap, *lap, (near, low), (length / 2, low)]


def out_and_back(rng: np.random.Generator) -> Building:
    """A long corridor with a few doors, driven out, back and out again; the wheels spin twice."""
    length, width = rng.uniform(60, 75), rng.uniform(1.8, 2.6)
    doors = np.sort(rng.uniform(3, length - 4, 8))
    low = [(0.0, 0.0), *itertools.chain.from_iterable(_recess(x, 0.0, -0.12) for x in doors[::2]), (length, 0.0)]
    high = [(length, width)]
    high += itertools.chain.from_iterable(_recess(x, width, width + 0.12)[::-1] for x in doors[1::2][::-1])
    ends = [(1.5, width / 2), (length - 1.5, width / 2)]
    return closed([*low, *high, (0.0, width)]), [*ends, *ends, ends[0]][:4]


_HALF, _ROUND = 181, 360
SCENES = {
    "doors": Scene(corridor_of_doors, LaserConfig(beams=_HALF, fov=math.pi, max_range=12.0)),
    "rooms": Scene(row_of_rooms, LaserConfig(beams=_ROUND, max_range=10.0)),
    "niches": Scene(square_of_niches, LaserConfig(beams=_HALF, fov=math.pi, max_range=20.0), beam_sigma_m=0.02),
    "parallel": Scene(parallel_corridors, LaserConfig(beams=_HALF, fov=math.pi, max_range=30.0)),
    "out and back": Scene(out_and_back, LaserConfig(beams=_ROUND, max_range=8.0), slips=2, beam_sigma_m=0.015),
}  # fmt: skip


def log_of(scene: Scene, seed: int) -> Log:
    """A drive through a scene, with the wheels of the preset `worn`, wrong to either side."""
    rng = np.random.default_rng(seed)
    walls, way = scene.draw(rng)
    truths = _driven(_woven(way, rng))
    odometry = _by_wheels(truths, scene.slips, rng)
    bearings, ticks = beam_bearings(scene.laser), []
    for k, (truth, wheels) in enumerate(zip(truths, odometry, strict=True)):
        ranges = cast_rays(truth, bearings, walls, scene.laser.max_range)
        scan = Scan.from_config(ranges + scene.beam_sigma_m * rng.standard_normal(len(ranges)), scene.laser)
        ticks.append(Tick(k * _PERIOD_NS, wheels, scan, truth=truth, log_stamp_s=1e-9 * _PERIOD_NS * k))
    return Log(ticks, scene.laser)


def _woven(way: Sequence[Point], rng: np.random.Generator) -> list[Point]:
    """The way with points between its corners that are a little beside it."""
    points = [way[0]]
    for a, b in itertools.pairwise(way):
        if not (length := math.dist(a, b)):
            continue
        along = np.subtract(b, a) / length
        for share in np.arange(_WEAVE_APART_M, length - 2.0, _WEAVE_APART_M):
            beside = float(np.clip(_WEAVE_M * rng.standard_normal(), -2 * _WEAVE_M, 2 * _WEAVE_M))
            x, y = np.asarray(a) + share * along + beside * np.array([-along[1], along[0]])
            points.append((float(x), float(y)))
        points.append(b)
    return points


def _driven(way: Sequence[Point]) -> list[Pose]:
    """Poses along straight lines between points, turning on the spot."""
    first = np.subtract(way[1], way[0])
    poses = [Pose(*way[0], math.atan2(first[1], first[0]))]
    for corner in way[1:]:
        to = np.subtract(corner, poses[-1].position)
        off, length = wrap_angle(math.atan2(to[1], to[0]) - poses[-1].theta), float(np.hypot(*to))
        turns, steps = math.ceil(abs(off) / _STEP_RAD), math.ceil(length / _STEP_M)
        for _ in range(turns):
            poses.append(poses[-1] @ Pose(theta=off / turns))
        for _ in range(steps):
            poses.append(poses[-1] @ Pose(x=length / steps))
    return poses


def _by_wheels(truths: Sequence[Pose], slips: int, rng: np.random.Generator) -> list[Pose]:
    """Odometry of wheels with scale, drift and noise as in the preset `worn`, which spin a few times."""
    world = preset("worn").world
    scale, drift = world.wheel_scale_error * rng.choice((-1, 1)), world.drift_rad_per_m * rng.choice((-1, 1))
    spinning = _SLIP_M / _SLIP_OVER_M
    lasting = math.ceil(_SLIP_OVER_M / _STEP_M)
    spins = {int(s) + k for s in rng.uniform(0.1, 0.8, slips) * len(truths) for k in range(lasting)}
    poses = [truths[0]]
    for k, (before, after) in enumerate(itertools.pairwise(truths)):
        step = before.inverse() @ after
        noise = rng.standard_normal(3)
        position = _SLIP_PER_SQRT_M * math.sqrt(abs(step.x))
        heading = world.motion.slip_heading_per_sqrt_m * math.sqrt(abs(step.x))
        heading += world.motion.slip_heading_per_sqrt_rad * math.sqrt(abs(step.theta))
        said = step.x * (1.0 - scale) * (1.0 + spinning if k in spins else 1.0)
        turn = step.theta * (1.0 - scale) - drift * step.x
        poses.append(poses[-1] @ Pose(said + position * noise[0], position * noise[1], turn + heading * noise[2]))
    return poses


def _side(x0: float, x1: float, y: float, deep: float, pitch: float) -> list[Point]:
    """Points from (x0, y) to (x1, y) with recesses to `deep`, `pitch` apart, each 1 m wide."""
    sign = 1.0 if x1 > x0 else -1.0
    points = [(x0, y)]
    for at in np.arange(pitch / 2, abs(x1 - x0) - 1.5, pitch):
        a, b = x0 + sign * at, x0 + sign * (at + 1.0)
        points += [(a, y), (a, deep), (b, deep), (b, y)]
    return [*points, (x1, y)]


def _square(low: float, high: float, deep: float, pitch: float) -> list[Point]:
    """Outline of a square, counter-clockwise, with recesses of `deep` in each side, inwards if positive."""
    side = _side(0.0, high - low, 0.0, deep, pitch)
    half, points = (low + high) / 2, []
    for quarter in range(4):
        c, s = round(math.cos(quarter * math.pi / 2)), round(math.sin(quarter * math.pi / 2))
        for x, y in side[:-1]:
            dx, dy = x - (high - low) / 2, y - (high - low) / 2
            points.append((half + c * dx - s * dy, half + s * dx + c * dy))
    return points


def _recess(x: float, y: float, deep: float) -> list[Point]:
    return [(x, y), (x, deep), (x + 1.0, deep), (x + 1.0, y)]
