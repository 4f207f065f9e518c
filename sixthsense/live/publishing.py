"""What a live run tells the network: pose, frame of odometry and plan, the verdict on its map, and commands.

Commands have a dead man's switch: without a new one in time the robot is told to stop.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Self

import numpy as np

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.motion import Odometry, propagated
from sixthsense.core.source import Command, Tick
from sixthsense.live.network import LATCHED, RELIABLE, Topic, Writer
from sixthsense.live.reading import TWIST, TWIST_STAMPED
from sixthsense.live.robot import LiveRobot
from sixthsense.logs.diagnose import findings_of
from sixthsense.logs.log import Odometry as Track
from sixthsense.logs.log import Sighting
from sixthsense.loop.run import OnTick
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.messages import DIAGNOSTICS, WORLD, Messages
from sixthsense.record.trace import Trace
from sixthsense.slam.mapping.mapper import Additions, Mapper
from sixthsense.verdict.judge import judge
from sixthsense.verdict.verdict import Level

TIMEOUT_S = 0.3
"""A moving robot is stopped if no command has followed for this long."""
AHEAD_NS = 200_000_000
"""The transform of the map is dated so much later than its scan, as slam_toolbox does."""
LEVELS: dict[Level, int] = {"good": 0, "unjudged": 0, "doubtful": 1, "broken": 2}
"""OK, WARN and ERROR of diagnostic_msgs/DiagnosticStatus"""
PACES: dict[Level, float] = {"good": 1.0, "unjudged": 1.0, "doubtful": 0.5, "broken": 0.0}
"""share of its speed that a robot drives at by itself; at 0 it turns in place, to find its place"""
KEYFRAMES = 200
"""that are judged while a run goes on: the last 50 m, in some 20 ms"""

POSE = Topic("/pose", "geometry_msgs/msg/PoseWithCovarianceStamped", RELIABLE)
TF = Topic("/tf", "tf2_msgs/msg/TFMessage", RELIABLE._replace(depth=100))
PLAN = Topic("/plan", "nav_msgs/msg/Path", LATCHED)
VERDICT = Topic("/diagnostics", DIAGNOSTICS, RELIABLE)
MAP = Topic("/map", "nav_msgs/msg/OccupancyGrid", LATCHED)

_CHECK_S = 0.05
_FAREWELLS, _BETWEEN_S = 3, 0.02
_JUDGED_NS = 1_000_000_000  # from one verdict to the next
_PERIOD_S = 2.0  # from one map to the next


def publisher(advertise: Callable[[Topic], Writer], robot: LiveRobot) -> OnTick:
    """A hook that sends the pose after each scan and the transform of the map, with the stamp of the scan; and plans.

    `advertise` gives what a topic is written with. The transform is dated later than its scan: so long it holds for
    those who look it up.
    """
    make, plans = Messages(), 0
    writers = {topic: advertise(topic) for topic in (POSE, TF, PLAN)}

    def send(topic: Topic, message: object) -> None:
        writers[topic].send(make.serialized(message, topic.type))

    def hook(tick: Tick, trace: Trace) -> None:
        nonlocal plans
        if tick.scan is not None:
            pose = Pose.from_array(trace.estimates[-1])
            send(POSE, make.estimate(tick.stamp_ns, pose, pose_covariance(trace)))
            T_map_odom = robot.odom_in_map(tick, pose)
            send(TF, make.transform(tick.stamp_ns + AHEAD_NS, WORLD, robot.odom_frame, T_map_odom))
        if len(trace.plans) > plans:
            plans = len(trace.plans)
            send(PLAN, make.path(tick.stamp_ns, trace.plans[-1]))

    return hook


def pose_covariance(trace: Trace) -> Array:
    """(3, 3) of the pose at the last scan, world frame: that at the last keyframe, and of the motion since."""
    if not trace.key_estimates:
        return np.zeros((3, 3))
    key, since = trace.key_estimates[-1], Pose.from_array(trace.since_key[-1])
    since_cov = np.zeros((3, 3)) if trace.live is None else trace.live.since_cov
    return propagated(key.pose, key.pose_cov, Odometry(since, since_cov))


def diagnostics(send: Callable[[bytes], object], pilot: Pilot) -> OnTick:
    """A hook that judges the map so far once a second, says so, and slows the pilot down.

    `send` takes serialized messages.
    """
    messages, next_ns, judged = Messages(), -1, 0  # keyframes of the newest verdict

    def hook(tick: Tick, trace: Trace) -> None:
        nonlocal next_ns, judged
        if trace.live is None or tick.stamp_ns < next_ns:
            return
        next_ns, count = tick.stamp_ns + _JUDGED_NS, len(trace.key_stamps_ns)
        if trace.live.verdict is None or count != judged:
            judged, trace.live.verdict = count, judge(trace.witnesses(KEYFRAMES))
        verdict = trace.live.verdict
        pilot.pace = PACES[verdict.level]
        values = {"cause": verdict.cause}
        if verdict.probability is not None:
            values["probability that the map is wrong"] = f"{verdict.probability:.3g}"
        values |= {name: f"{value:.4g}" for name, value in verdict.evidence.items()}
        status = messages.status(LEVELS[verdict.level], "sixthsense: map", f"map {verdict}", "sixthsense", values)
        send(messages.serialized(messages.diagnostics(tick.stamp_ns, [status]), DIAGNOSTICS))

    return hook


class Commands:
    """Sends commands; a thread of its own stops the robot if the loop stalls. A context manager that stops it, too."""

    def __init__(
        self, send: Callable[[bytes], object], now_ns: Callable[[], int] | None = None, frame: str = ""
    ) -> None:
        """`send` takes serialized messages: Twist, or with the robot's clock `now_ns` TwistStamped in its `frame`."""
        self._send, self._now_ns, self._frame, self._messages = send, now_ns, frame, Messages()
        self._lock = threading.Lock()
        self._is_moving, self._sent_s = False, time.monotonic()
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._stop_if_late, name="dead man's switch", daemon=True)

    def __enter__(self) -> Self:
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the robot: the last thing that it hears is a standstill."""
        self._over.set()
        for _again in range(_FAREWELLS):
            self.send(Command())
            time.sleep(_BETWEEN_S)
        self._watch.join()

    def send(self, command: Command) -> None:
        """Send a command now."""
        make, velocities = self._messages, (command.speed, command.turn_rate)
        if self._now_ns is None:
            data = make.serialized(make.twist(*velocities), TWIST)
        else:
            data = make.serialized(make.twist_stamped(self._now_ns(), self._frame, *velocities), TWIST_STAMPED)
        with self._lock:
            self._send(data)
            self._is_moving, self._sent_s = command != Command(), time.monotonic()

    def _stop_if_late(self) -> None:
        while not self._over.wait(_CHECK_S):
            if self._is_moving and time.monotonic() - self._sent_s > TIMEOUT_S:
                self.send(Command())


class MapSender:
    """A hook that sends the map after new keyframes, drawn in a thread.

    The thread has a map of its own, so that the loop never waits for a large one.
    """

    def __init__(self, send: Callable[[bytes], object], submit: Callable[..., Future[None]]) -> None:
        """`send` takes serialized messages; `submit` calls a function with its arguments in a thread."""
        self._send, self._submit, self._messages = send, submit, Messages()
        self._mapper: Mapper | None = None
        self._keyframes = self._scans = 0  # that the thread was given
        self._begun_s = -_PERIOD_S
        self._drawing: Future[None] | None = None

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Give on new keyframes, unless the thread still draws those before or the last map is not yet old."""
        keyframes, now_s = len(trace.key_stamps_ns), time.monotonic()
        if trace.live is None or keyframes == self._keyframes or now_s - self._begun_s < _PERIOD_S:
            return
        if self._drawing is not None:
            if not self._drawing.done():
                return
            self._drawing.result()  # raises what has ended it
        mapper, config = trace.live.mapper, trace.config.grid
        if self._mapper is None:
            self._mapper = Mapper(config, trace.radius_m)
            if mapper.earlier is not None:
                self._mapper.start_from(mapper.earlier)
        additions = mapper.additions(self._scans)
        self._keyframes, self._scans, self._begun_s = keyframes, self._scans + len(additions.scans), now_s
        self._drawing = self._submit(self._draw, self._mapper, additions, tick.stamp_ns, config.cell_m)

    def _draw(self, mapper: Mapper, additions: Additions, stamp_ns: int, cell_m: float) -> None:
        mapper.take(additions)
        grid = mapper.draw()
        cells = grid.occupancy()
        if cells.size:
            message = self._messages.occupancy(stamp_ns, cells, grid.origin, cell_m)
            self._send(self._messages.serialized(message, MAP.type))


LOOK_NS = 20_000_000_000
"""time since the first tick"""


def first_look(say: Callable[[str], object]) -> OnTick:
    """A hook that diagnoses the ticks of the first 20 s, in a thread, and says each finding; `say` prints a line."""
    ticks: list[Tick] = []

    def look() -> None:
        scans = [Sighting(t.stamp_ns, t.scan, t.log_stamp_s or 1e-9 * t.stamp_ns) for t in ticks if t.scan is not None]
        odometry = Track(np.array([t.stamp_ns for t in ticks]), np.array([t.odometry.array() for t in ticks]))
        for finding in findings_of(scans, odometry):
            say(str(finding))

    def hook(tick: Tick, trace: Trace) -> None:
        if not ticks or ticks[-1].stamp_ns - ticks[0].stamp_ns < LOOK_NS:
            ticks.append(tick)
            if tick.stamp_ns - ticks[0].stamp_ns >= LOOK_NS:
                threading.Thread(target=look, daemon=True, name="first look").start()

    return hook
