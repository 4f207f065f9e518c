"""A bag of a robot in a room, as its drivers might have written it: what is odd about it is a keyword."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from bags import Bag

from sixthsense.config import Config, preset
from sixthsense.core.geometry import Pose, point_segment_distance
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Tick
from sixthsense.logs import open_log
from sixthsense.logs.diagnose import settled
from sixthsense.logs.finding import Finding
from sixthsense.logs.log import Log

WALLS = np.array(
    [[[-2.7, -2.1], [4.1, -2.1]], [[4.1, -2.1], [4.1, 3.2]], [[4.1, 3.2], [-2.7, 3.2]], [[-2.7, 3.2], [-2.7, -2.1]],
     [[1.6, -2.1], [1.6, -1.2]], [[2.4, 1.5], [3.1, 1.9]], [[-1.3, 2.0], [-1.9, 1.4]]]
)  # fmt: skip
MOUNT, T0_NS = Pose(0.17, -0.06, 0.35), 1_700_000_000_123_456_789
LINKS = (("static", "base_footprint", "base_link", Pose()), ("static", "base_link", "laser", MOUNT))


def way(seconds: float) -> Pose:
    """The true pose: it drives and turns, to either side in no regular way."""
    turn = 0.9 * math.sin(0.8 * seconds) + 0.3 * math.sin(2.9 * seconds) + 0.2
    return Pose(0.9 * math.sin(0.35 * seconds) - 0.3, 0.7 * math.sin(0.2 * seconds) + 0.1, turn)


def changed(key, value, which=range(10**6)):
    """A change of what the messages of such numbers say, to a value or to a function of the number."""
    return lambda k, says: {**says, key: value(k) if callable(value) else value} if k in which else says


def robot_bag(
    path: Path, kind: str = "mcap", *, seconds: float = 6.0, scan=lambda k, says: says, odom=lambda k, says: says,
    links=LINKS, odom_in_tf: bool = False, late_s: float = 0.0, echo: bool = False,
) -> Path:  # fmt: skip
    """Write the bag: odometry every 20 ms and a scan of 240 beams every 100 ms.

    `scan` and `odom` change what scan or pose number `k` says, a dictionary, or leave the message out by None. `links`
    are constant transforms, static or of /tf. The scans' clock is `late_s` ahead of the others.
    """
    with Bag(path, kind) as bag:
        for _, *link in (link for link in links if link[0] == "static"):
            bag.transform(*link, record_ns=T0_NS)
        for k in range(int(50 * seconds)):
            now = T0_NS + k * 20_000_000
            says = odom(
                k, {"pose": way(0.02 * k), "child": "base_footprint", "stamp_ns": now, "turn": None, "unit": 1.0}
            )
            if says is not None and odom_in_tf:
                bag.transform("odom", "base_footprint", says["pose"], stamp_ns=says["stamp_ns"])
            elif says is not None:
                pose, unit = says["pose"], says.pop("unit")
                says["pose"] = Pose(unit * pose.x, unit * pose.y, pose.theta)
                bag.odometry(**says, record_ns=now)
            if k % 5:
                continue
            for _, *link in (link for link in links if link[0] == "tf"):
                bag.transform(*link, stamp_ns=now)
            says = {"first": -2.0, "step": math.radians(1.2), "count": 240, "low": 0.05, "high": 9.0, "frame": "laser",
                    "stamp_ns": now + round(late_s * 1e9), "topic": "/scan", "ranges": None, "unit": 1.0, "lag": 0.0,
                    "last": None, "is_mirrored": False, "angle_unit": 1.0}  # fmt: skip
            says = scan(k // 5, says)
            if says is not None:
                count, unit, turn, is_mirrored = map(says.pop, ("count", "unit", "angle_unit", "is_mirrored"))
                if says["ranges"] is None:
                    bearings = says["first"] + says["step"] * np.arange(count)
                    says["ranges"] = cast_rays(way(0.02 * k) @ MOUNT, bearings, WALLS, 100.0)
                says["ranges"] = unit * np.asarray(says["ranges"])[:: -1 if is_mirrored else 1]
                says |= {"first": turn * says["first"], "step": turn * says["step"]}
                says |= {"low": unit * says["low"], "high": unit * says["high"]}
                bag.scan(**says, echo=echo, record_ns=now)
    return bag.path


def read(path: Path, config: Config | None = None, **chosen) -> tuple[Log, dict[str, Finding]]:
    """The log with what is found out about it applied, and the findings by kind."""
    config = config or preset("log")
    log, _, found = settled(open_log(path, config.laser, **chosen), config)
    return log, {finding.kind: finding for finding in found}


def off_walls_m(ticks: Iterable[Tick], ahead_s: float = 0.0) -> float:
    """Largest distance of a return from the walls, of scans at the true poses of their stamps, which are ahead."""
    worst = 0.0
    for tick in ticks:
        if tick.scan is not None:
            true = way(1e-9 * (tick.stamp_ns - T0_NS) - ahead_s)
            points = true @ tick.scan.points_robot[np.isfinite(tick.scan.ranges)]
            worst = max([worst, *(float(point_segment_distance(point, WALLS).min()) for point in points[::7])])
    return worst
