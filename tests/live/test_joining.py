"""Joining scans with odometry, by stamps and times of arrival alone."""

import itertools
import math
from collections import Counter

import numpy as np
import pytest

from sixthsense.config import RobotConfig
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.core.source import Tick
from sixthsense.live.robot import ScanJoiner, Sensor

MS, S = 1_000_000, 1_000_000_000
BEGAN = 1_700_000_000_000 * MS


def pose_at(ms: float) -> Pose:
    """On an arc, from rest at 0 ms."""
    return Pose(math.sin(0.001 * ms), 1.0 - math.cos(0.001 * ms), 0.001 * ms)


class Driver:
    """Feeds a joiner; times are milliseconds from the beginning, of stamp and of arrival."""

    def __init__(self) -> None:
        self.dropped: Counter[str] = Counter()
        self.joiner = ScanJoiner(RobotConfig(), lambda why: self.dropped.update([why]))
        self.ticks: list[Tick] = []

    def odometry(self, *stamps_ms: int, arrival_ms: int | None = None) -> "Driver":
        for ms in stamps_ms:
            arrival = ms if arrival_ms is None else arrival_ms
            self.joiner.add_odometry(BEGAN + ms * MS, pose_at(ms), arrival * MS)
            self.at(arrival)
        return self

    def scan(self, stamp_ms: int, arrival_ms: int | None = None) -> "Driver":
        arrival = stamp_ms if arrival_ms is None else arrival_ms
        scan = Scan(np.full(5, 2.0, dtype=np.float32), np.float32(-1.0), np.float32(0.5), 10.0)
        self.joiner.add_scan(BEGAN + stamp_ms * MS, scan, arrival * MS)
        return self.at(arrival)

    def at(self, arrival_ms: int) -> "Driver":
        self.ticks += self.joiner.ticks(arrival_ms * MS)
        return self

    @property
    def scans_ms(self) -> list[float]:
        return [(tick.stamp_ns - BEGAN) / MS for tick in self.ticks if tick.scan is not None]


LOST = {"scan without odometry": 1}


@pytest.mark.parametrize(("feed", "scans_ms", "dropped"), [
    (lambda d: d.odometry(0).scan(30).at(230).odometry(40, arrival_ms=230), [30], {}),
    (lambda d: d.odometry(0).scan(30).at(231).odometry(40, arrival_ms=231), [], LOST),
    (lambda d: d.odometry(20).scan(400).odometry(520), [400], {}),
    (lambda d: d.odometry(20).scan(400).odometry(540), [], LOST),  # a longer gap, in which nothing is interpolated
    (lambda d: d.odometry(*range(20, 1520, 20)).scan(510, 1500).scan(470, 1500).scan(510, 1500), [510],
     {"scan twice or late": 2}),
    (lambda d: d.scan(90).odometry(40, 60, 80, 100, 40, 100), [90], {"odometry twice or out of order": 2}),
])  # fmt: skip
def test_a_scan_waits_200_ms_for_the_odometry_after_it_and_each_message_is_used_once(feed, scans_ms, dropped):
    driver = feed(Driver())
    assert (driver.scans_ms, driver.dropped) == (scans_ms, dropped)


def test_a_tick_has_the_pose_of_its_stamp_after_the_odometry_before_it():
    driver = Driver().odometry(20, 40).scan(50).odometry(60, 80).scan(80)
    assert [(tick.stamp_ns - BEGAN) // MS for tick in driver.ticks] == [20, 40, 50, 60, 80]
    for tick in driver.ticks:
        expected = pose_at((tick.stamp_ns - BEGAN) / MS)
        assert tick.odometry.array() == pytest.approx(expected.array(), abs=1e-4)
    assert driver.joiner.now(95 * MS) == BEGAN + 95 * MS


def test_odometry_that_begins_anew_twice_goes_on_from_where_it_was_and_tells_its_jump():
    start, way = Pose(-3.0, 5.0, 2.2), [Pose(2, 3, 0.4), Pose(2.1, 3.2, 0.5), Pose(9, -4, 2), Pose(5, 6, -2.5)]
    joiner, stamps_ms = ScanJoiner(RobotConfig(speed=0.7), print, start), (20, 140, 160, 2160)
    jumps = []
    for ms, pose in zip(stamps_ms, way, strict=True):
        jumps.append(joiner.add_odometry(BEGAN + ms * MS, pose, ms * MS))
        at = start if ms == 20 else start @ way[0].inverse() @ way[1]  # the first odometry is where the map begins
        assert joiner.newest is not None and joiner.newest[1].array() == pytest.approx(at.array())
    jump_m = math.dist((way[1] @ way[2].inverse() @ way[3]).position, way[1].position)
    assert jumps[:2] == ["", ""] and jumps[2] and jumps[3] == f"odometry has jumped by {jump_m:.1f} m after 2.0 s"
    assert (joiner.T_joined_odom @ way[3]).array() == pytest.approx(at.array())


@pytest.mark.parametrize(("pause_s", "off", "is_anew"), [
    (7.0, Pose(0.0, 4.6), False), (7.0, Pose(0.0, 4.8), True), (7.0, Pose(-4.8), True), (0.02, Pose(0.3, -0.3), False),
    (0.02, Pose(0.4, -0.4), True), (0.02, Pose(theta=-0.5), False), (0.02, Pose(theta=0.55), True),
])  # fmt: skip
def test_odometry_that_moves_or_turns_faster_than_the_robot_can_has_begun_anew(pause_s, off, is_anew):
    joiner, before = ScanJoiner(RobotConfig(speed=0.5, turn_rate=0.8), print), Pose(2.0, 3.0, -3.1)
    after = Pose(before.x + off.x, before.y + off.y, before.theta + off.theta)
    assert joiner.add_odometry(BEGAN, before, BEGAN) == ""
    stamp_ns = BEGAN + round(pause_s * 1e9)
    assert bool(joiner.add_odometry(stamp_ns, after, stamp_ns)) == is_anew


@pytest.mark.parametrize("seed", range(5))
def test_whatever_the_network_does_each_scan_is_used_once_or_dropped_and_ticks_ascend(seed):
    rng, driver, sent = np.random.default_rng(seed), Driver(), 0
    arrivals: list[tuple[int, bool, int]] = []
    for ms in range(0, 20_000, 20):
        arrivals.append((ms + int(rng.integers(0, 10)), False, ms))
        if ms % 100 == 0:
            delay = int(rng.integers(0, 500)) if rng.random() < 0.2 else int(rng.integers(0, 10))
            copies = 0 if rng.random() < 0.05 else 1 + (rng.random() < 0.05)
            sent += copies
            arrivals += [(ms + delay + k, True, ms) for k in range(copies)]
    for arrival, is_scan, ms in sorted(arrivals):
        (driver.scan if is_scan else driver.odometry)(ms, arrival_ms=arrival)
    driver.at(30_000)
    assert all(a.stamp_ns < b.stamp_ns for a, b in itertools.pairwise(driver.ticks))
    of_scans = sum(count for kind, count in driver.dropped.items() if kind.startswith("scan"))
    assert len(driver.scans_ms) + of_scans == sent and len(driver.scans_ms) > 0.7 * sent


@pytest.mark.parametrize(("messages", "is_of_one"), [
    ([("a", 0), ("a", 900), ("a", 2000)], [True, True, True]), ([("a", 7), ("b", 300)], [True, False]),
    ([("a", 7), ("b", 500), ("b", 520)], [True, True, True]), ([("a", 7), ("b", 500), ("a", 520)], [True, True, False]),
])  # fmt: skip
def test_a_publisher_beside_another_is_told_from_one_that_takes_its_place(messages, is_of_one):
    sensor, found = Sensor("laser", 0, 400 * MS), []
    for name, ms in messages:
        found.append(sensor.is_of_one(name, ms * MS))
        sensor.heard_ns = ms * MS
    assert found == is_of_one
    last_ms = messages[-1][1]
    silences = [sensor.falls_silent((last_ms + ms) * MS) for ms in (390, 400, 401, 900)]
    assert silences == [False, False, True, False]
