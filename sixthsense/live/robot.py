"""A robot on the network as a `Source`: messages become ticks, and the robot is steered between them."""

from __future__ import annotations

import dataclasses
import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.laser import sweep_ns
from sixthsense.core.se2 import move_covariance
from sixthsense.core.source import Command, Tick
from sixthsense.live.ahead_pilot import AheadPilot
from sixthsense.live.joining import LONG_SILENT_NS, SILENT_NS, OdometryReset, Publishers, ScanJoiner, SilenceDetector
from sixthsense.live.network import Message
from sixthsense.live.offset import ClockOffset
from sixthsense.live.reading import LaserReader, MessageReader, Notices
from sixthsense.live.requests import Request, Reset, SetPose
from sixthsense.loop.interrupt import is_command_ended
from sixthsense.record.trace import Trace
from sixthsense.slam.relocalization import MOST_DRIVEN_M, Relocalizer

ANOTHER_ROBOT, LOST, RESET = "another robot", "lost", "reset"
"""outcomes of a run that the robot itself ends"""

_NEAR_M = 0.25
"""A robot that can have driven no farther while it sent nothing is taken to stand where it was."""

_CARRIED_COV = np.diag([0.3, 0.3, 0.1]) ** 2  # of a place, at least: so large that the robot counts as carried there
_WAIT_S = 0.02
_ANNOUNCED_NS = 12_000_000_000  # after which a killed program is not announced any more: 10 s, and some to notice it

Received = tuple[bool, Message]
"""whether a message is a scan, else odometry; and the message"""


class Steering(NamedTuple):
    """How a robot is driven."""

    pilot: AheadPilot
    send: Callable[[Command], object]
    subscribers: Callable[[], int]
    """how many take the commands"""


class Search:
    """Takes the ticks of a lost robot until its place is certain; what it sees meanwhile is not mapped.

    Two places need one look alone, since something else says them: where the robot was, and where its odometry would be
    if it had not begun anew.
    """

    def __init__(self, trace: Trace, T_odom_map: Pose, anew: OdometryReset) -> None:
        """Begin with the map so far, and the map in the frame of the odometry before it began anew."""
        grid = trace.draw_map()
        assert grid is not None
        self.anew = anew
        self._T_odom_map = T_odom_map
        T_map_stood = T_odom_map.inverse()
        expected = (T_map_stood, T_map_stood @ anew.T_stood_went)
        self._relocalizer = Relocalizer(grid.submap(), trace.config, expected)

    @property
    def is_over(self) -> bool:
        """Whether the robot has driven so far that its place is not in the map."""
        return self._relocalizer.driven_m > MOST_DRIVEN_M

    def take(self, tick: Tick) -> Pose | None:
        """Look at a tick; how its odometry is to be moved to where the robot is, None before that is known."""
        found = None if tick.scan is None else self._relocalizer.take(tick.scan, tick.odometry)
        return None if found is None else self._T_odom_map @ found


def placed(tick: Tick, T: Pose, cov: Array = _CARRIED_COV) -> Tick:
    """The tick with its odometry moved by `T` to another place; no wheel has measured the way there.

    `cov` (3, 3) is of the place, axes of the robot there. The scan is left out: the next one is not
    distorted by the step.
    """
    raised = cov + np.diag(np.maximum(np.diag(_CARRIED_COV) - np.diag(cov), 0.0))
    return dataclasses.replace(tick, odometry=T @ tick.odometry, scan=None, increment_cov=raised)


class LiveRobot:
    """A robot that sends scans and odometry, and takes commands if it is to be driven."""

    def __init__(
        self,
        receive: Callable[[float], Iterable[Received]],
        reader: MessageReader,
        laser: LaserReader,
        notices: Notices,
        trace: Trace,
        steering: Steering | None = None,
        now_ns: Callable[[], int] = time.monotonic_ns,
        requests: Callable[[], Iterable[Request]] = tuple,
    ) -> None:
        """`receive(timeout_s)` waits for messages at most so long; `now_ns` is the time of their arrival.

        `trace` is the record of the run, in whose map a lost robot is searched. `requests` are those of the user since
        the last call.
        """
        self.joiner = ScanJoiner(trace.config.robot)
        self._offset = ClockOffset()
        self.odom_frame = "odom"
        self.outcome: str | None = None
        """why the run ends, None as long as the robot can be used"""
        self.is_paused = False
        """whether scans are left out"""
        self.takes_start = steering is None
        """whether a pose that is set before the first scan is where the map begins"""
        self._receive, self._requests, self._now_ns = receive, requests, now_ns
        self._reader, self._laser, self._notices, self._steering = reader, laser, notices, steering
        self._trace = trace
        self._has_no_odometry = trace.config.no_odometry
        self._search: Search | None = None
        self._asked: SetPose | None = None  # which no odometry has been moved to
        self._place_cov: Array | None = None  # of a pose that was set, until a tick is there
        self._publishers = {is_scan: Publishers() for is_scan in (False, True)}
        self._is_restarted = False  # the driver, since the odometry that was used last
        self._shared_ns: int | None = None  # since when the commands have a second subscriber
        silent_ns = LONG_SILENT_NS if steering is None else SILENT_NS
        self._scans, self._odometry = (SilenceDetector(name, now_ns(), silent_ns) for name in ("laser", "odometry"))
        self._due: deque[Tick] = deque()
        self._last: Tick | None = None
        self._T_odom_map: Pose | None = None  # by the last keyframe, which SLAM goes on from with the odometry since
        self._newest: tuple[int, Pose] | None = None  # odometry that the robot has not been steered by

    def step(self, command: Command) -> Tick | None:
        """Wait for the next tick; None when the run is to end. The robot is steered meanwhile."""
        key_stamps_ns = self._trace.key_stamps_ns
        if self._last is not None and key_stamps_ns and self._last.stamp_ns == key_stamps_ns[-1]:
            self._T_odom_map = self._last.odometry @ self._trace.key_estimates[-1].pose.inverse()
        if not self._wait():
            return None
        self._last = self._due.popleft()
        return self._last

    def begin(self) -> Pose | None:
        """Wait for the first tick; the odometry of it, None when the run is to end."""
        return self._due[0].odometry if self._wait() else None

    def odom_in_map(self, tick: Tick, T_map_robot: Pose) -> Pose:
        """The frame of odometry in that of the map, by the robot's pose at a tick."""
        T_odom_robot = self.joiner.T_old_odom.inverse() @ tick.odometry
        return T_map_robot @ T_odom_robot.inverse()

    def _wait(self) -> bool:
        """Wait for a tick; false when the run is to end."""
        while not self._due:
            if is_command_ended() or self.outcome is not None:
                return False
            self._turn()
        return True

    def _turn(self) -> None:
        """Take what has arrived, and steer by it."""
        self._take_messages()
        for request in self._requests():
            self._heed(request)
        self._set_pose()
        self._take_ticks(self.joiner.ticks(self._now_ns()))
        self._tell()
        self._steer()

    def _take_messages(self) -> None:
        for is_scan, message in self._receive(_WAIT_S):
            arrival_ns = self._now_ns()
            sensor = self._scans if is_scan else self._odometry
            publisher = self._publishers[is_scan].heard(message.publisher, arrival_ns)
            if publisher == "second":
                self._end(ANOTHER_ROBOT, f"{sensor.name}: a second publisher sends beside the first")
                return
            if publisher == "unknown":
                continue
            self._is_restarted |= publisher == "new" and not is_scan
            try:
                if is_scan:
                    stamp_ns, scan = self._laser.scan(message.data)
                    if self._has_no_odometry:  # it is said to stand, and moves as its scans tell
                        ends_ns = stamp_ns - sweep_ns(len(scan.ranges), scan.time_increment)
                        self.joiner.add_odometry(ends_ns, Pose(), arrival_ns)
                    elif self._offset.add_scan(stamp_ns, scan):
                        self._tell_offset()
                    self.joiner.add_scan(stamp_ns - self._offset.lead_ns, scan, arrival_ns)
                else:
                    self._take_odometry(message.data, arrival_ns)
            except ValueError as error:
                self._notices.unusable("scan" if is_scan else "odometry", error)
                continue
            if (silent_s := sensor.heard(arrival_ns)) is not None:
                self._say(f"{sensor.name} again", f"{sensor.name} sends again, after {silent_s:.1f} s")

    def _take_odometry(self, data: bytes, arrival_ns: int) -> None:
        message, joiner = self._reader.odometry(data), self.joiner
        jumps, anew = joiner.clock.jumps, joiner.anew
        if joiner.add_odometry(message.stamp_ns, message.T_odom_robot, arrival_ns, self._is_restarted):
            self.odom_frame = message.frame or "odom"
            self._newest = joiner.newest
            if joiner.anew is not None and joiner.anew is not anew:
                self._begin_anew(joiner.anew)
            self._is_restarted = False
            self._offset.add_odometry(message.stamp_ns, message.T_odom_robot.theta)
        if joiner.clock.jumps > jumps:
            self._offset = ClockOffset(self._offset.lead_ns)
            self._say("clock jumped", "the robot's clock has jumped; the map goes on")

    def _tell_offset(self) -> None:
        lead_s = 1e-9 * self._offset.lead_ns
        lead = "lead" if lead_s > 0.0 else "lag behind"
        text = f"scans {lead} odometry by {abs(lead_s):.2f} s, by the turns that both see (other clocks?)"
        self._say("clocks differ", f"{text}: their stamps are set right")

    def _begin_anew(self, anew: OdometryReset) -> None:
        """The robot stands where it was, if it cannot be far from there; else it is searched in the map."""
        why = (
            "its driver was started again" if self._is_restarted else "faster than `robot.speed` and `robot.turn_rate`"
        )
        text = f"odometry has jumped by {anew.jump_m:.1f} m after {anew.pause_s:.1f} s, {why}"
        if anew.reach_m <= _NEAR_M or self._T_odom_map is None:
            self._say("odometry jumped", f"{text}; the robot is taken to stand where it was")
            return
        if self._search is not None:
            anew = anew._replace(time_ns=self._search.anew.time_ns)
        self._search = Search(self._trace, self._T_odom_map, anew)
        self._say("odometry jumped", f"{text}; the pose is unknown and searched in the map")

    def _heed(self, request: Request) -> None:
        """Do what the user asks; a pose is set when there is odometry."""
        if isinstance(request, SetPose):
            self._asked = request
        elif isinstance(request, Reset):
            if self._T_odom_map is not None:
                self._end(RESET, "a new map is asked for")
        elif request.is_paused != self.is_paused:
            self.is_paused = request.is_paused
            text = "paused: scans are left out" if self.is_paused else "the pause is over; the map goes on"
            self._say("paused" if self.is_paused else "pause over", text)

    def _set_pose(self) -> None:
        """Move the odometry, from its newest message on, to the pose that was asked for.

        Before the first tick the map begins there.
        """
        asked, newest = self._asked, self.joiner.newest
        begins = self._last is None and self.takes_start
        if asked is None or newest is None or not (begins or self._T_odom_map):
            return
        self._asked, (newest_ns, pose) = None, newest
        T_odom_map = self._T_odom_map or Pose()
        if self._last is not None:
            if self._has_no_odometry:
                self._say("pose refused", "a pose is left out: without odometry the first scan alone can have one")
                return
            self._place_cov = np.asarray(move_covariance((0.0, 0.0, -asked.T_map_robot.theta), asked.cov))
        self.joiner.place(T_odom_map @ asked.T_map_robot @ pose.inverse(), newest_ns)
        self._search, self._newest = None, None
        x, y, theta = asked.T_map_robot.array()
        self._say("pose set", f"the pose is set to {x:.2f} m, {y:.2f} m, {np.degrees(theta):.0f}°")

    def _take_ticks(self, ticks: Sequence[Tick]) -> None:
        """Pass on ticks; those of a lost robot are searched for its place. While paused they have no scan."""
        for tick in ticks:
            if self.is_paused and tick.scan is not None:
                self._notices.dropped["scan while paused"] += 1
                tick = dataclasses.replace(tick, scan=None)
            if self._place_cov is not None:
                tick, self._place_cov = placed(tick, Pose(), self._place_cov), None
            if self._search is None or tick.stamp_ns < self._search.anew.time_ns:
                self._due.append(tick)
            elif (T := self._search.take(tick)) is not None:
                assert self.joiner.anew is not None
                self.joiner.place(T, self.joiner.anew.time_ns)
                self._due.append(placed(tick, T))
                self._search, self._newest = None, None
                self._say("place found", "the robot's place in the map is found; the map goes on")
                return  # the other ticks are where it was searched from
            elif self._search.is_over or (tick.scan is not None and self._steering is not None):
                self._end(LOST, "the robot's place in the map is not found")
                return

    def _tell(self) -> None:
        self._notices.take(self.joiner.dropped)
        now_ns = self._now_ns()
        for sensor in (self._scans,) if self._has_no_odometry else (self._scans, self._odometry):
            if sensor.falls_silent(now_ns):
                stopped = "" if self._steering is None else "; the robot is stopped"
                self._say(f"{sensor.name} silent", f"{sensor.name} is silent{stopped}")
                self._stop()

    def _steer(self) -> None:
        """Command by the newest odometry; a robot whose laser or odometry is silent stands."""
        if self._steering is None or self._newest is None or self._last is None or self._due:
            return
        is_unable = self._has_second_subscriber() or self.outcome is not None or self._search is not None
        is_unable |= self.is_paused or self._place_cov is not None
        if is_unable or self._scans.is_silent or self._odometry.is_silent:
            self._stop()
            return
        (time_ns, pose), self._newest = self._newest, None
        motion = self._last.odometry.inverse() @ pose
        self._steering.send(self._steering.pilot.ahead(motion, time_ns))

    def _has_second_subscriber(self) -> bool:
        """Whether another robot may take the commands; if that stays so, the run ends."""
        assert self._steering is not None
        now_ns = self._now_ns()
        if self._steering.subscribers() <= 1:
            self._shared_ns = None
            return False
        what = "commands: a second subscriber, which may be another robot"
        if self._shared_ns is None:
            self._shared_ns = now_ns
            self._say("second subscriber", f"{what}; the robot is stopped")
        elif now_ns - self._shared_ns > _ANNOUNCED_NS:
            self._end(ANOTHER_ROBOT, what)
        return True

    def _end(self, outcome: str, text: str) -> None:
        """End the run; a driven robot is stopped first."""
        if self.outcome is None:
            self._stop()
            self.outcome = outcome
            self._say(outcome, f"{text}; {'the run ends' if self._steering is None else 'the robot is stopped'}")

    def _stop(self) -> None:
        if self._steering is not None:
            self._steering.send(Command())

    def _say(self, kind: str, text: str) -> None:
        self._notices.event(kind, text, self._now_ns())
