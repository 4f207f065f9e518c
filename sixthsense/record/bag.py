"""`BagWriter`: a run's sensor data and results as a ROS 2 bag with MCAP storage, written during the run."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan, sweep_ns
from sixthsense.core.source import Tick
from sixthsense.logs.ros_messages import CLOUD
from sixthsense.record.messages import LASER, ROBOT, MessageForm, Messages, pose_numbers
from sixthsense.record.trace import Trace
from sixthsense.record.writing import naming

TOPICS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/truth": "geometry_msgs/msg/PoseStamped",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/estimate": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/plan": "nav_msgs/msg/Path",
}
"""recorded topics and their types, in the order of one tick"""
TOUR = "/tour"
"""additional topic of an exploration: robot, views and home of each tour by which a view was chosen, as a path"""
OBSERVATIONS = "/observations"
"""additional topic of a log with known landmark identities: observations, robot's frame"""

CLOSURES = "/closures"
"""additional topic of a log with loop closures: motion from an earlier tick, whose number is the frame of the header"""

_TYPES = {**TOPICS, TOUR: TOPICS["/plan"], OBSERVATIONS: CLOUD, CLOSURES: TOPICS["/estimate"]}
_FILE = "bag_0.mcap"
_CHUNK_S = 0.5  # of wall time; the longest part that a killed run loses
_CHUNK_BYTES = 1 << 20
_MARKS = (-2.345e30, -1.234e30)  # between them are numbers that stand nowhere else in a message
# Reliable and transient local: late subscribers receive the mount, too.
_LATCHED_QOS = """\
- history: 1
  depth: 1
  reliability: 1
  durability: 1
  deadline: {sec: 9223372036, nsec: 854775807}
  lifespan: {sec: 9223372036, nsec: 854775807}
  liveliness: 1
  liveliness_lease_duration: {sec: 9223372036, nsec: 854775807}
  avoid_ros_namespace_conventions: false
"""


class BagWriter:
    """Writes `FOLDER/bag/`: a hook for the loop's `on_tick`, and a context manager that closes the bag.

    A message's record time is the tick's stamp. A scan's header has the log's own stamp, or without one the stamp of
    its first beam, as in ROS; it is earlier than the tick's if the scan has a sweep time. Chunks end with a tick and
    are flushed twice per second of wall time, so that a killed run loses at most the last one.
    If a log states the covariance of the motion since its last tick, it is written as the odometry's pose.covariance
    (axes of the previous robot frame; z, roll and pitch 1e6). Otherwise that is zero, and its first entry is -1 where
    nothing has measured the motion.
    Raises OSError that names the file if it cannot be written.
    """

    def __init__(self, folder: Path, before_flush: Callable[[Trace], object] = lambda _: None) -> None:
        """Create a bag in the run's `folder`; `before_flush` is called with the trace before each flush."""
        from mcap.writer import Writer

        self._messages = Messages()
        self._bag = folder / "bag"
        self._bag.mkdir()
        self._file = self._bag / _FILE
        self._stream = self._file.open("wb")
        # The chunk size is unlimited so that only `_flush` ends a chunk, never within a tick.
        self._writer = Writer(self._stream, chunk_size=1 << 62)
        self._writer.start("ros2")
        self._channels: dict[str, int] = {}
        for topic in TOPICS:
            self._register(topic)
        make, marked = self._messages, Pose(*_MARKS, 1.0)
        messages = {"/odom": make.odometry(0, marked, None), "/truth": make.pose_stamped(0, marked)}
        marks = np.array(pose_numbers((*_MARKS, 1.0)))
        self._forms = {name: MessageForm(make.serialized(one, TOPICS[name]), marks) for name, one in messages.items()}
        self._scan_form: tuple[tuple[Any, ...], MessageForm] | None = None  # with the laser that it is of
        self._counts: Counter[str] = Counter()
        self._first_ns = self._last_ns = 0
        self._pending = 0  # bytes
        self._flushed = -math.inf  # the first tick is flushed at once
        self._failed = False
        self._before_flush = before_flush

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Close the bag with its summary and metadata; after a write error only the stream, with the flushed chunks."""
        try:
            if not self._failed:
                with self._failing():
                    self._writer.finish()  # type: ignore[no-untyped-call]
                    self._stream.close()
                    self._write_metadata()
        finally:
            with contextlib.suppress(OSError):
                self._stream.close()

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Record one tick and the trace's new estimates and plans."""
        with self._failing():
            self._record(tick, trace)
            self._record_new(tick.stamp_ns, trace)

    @contextlib.contextmanager
    def _failing(self) -> Iterator[None]:
        try:
            with naming(self._file):
                yield
        except OSError:
            self._failed = True
            raise

    def _flush(self, trace: Trace) -> None:
        self._before_flush(trace)
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._pending = 0
        self._flushed = time.monotonic()

    def _record(self, tick: Tick, trace: Trace) -> None:
        stamp, make = tick.stamp_ns, self._messages
        self._begin(stamp, trace.config.laser.mount)
        if tick.increment_cov is None and not tick.is_unmeasured:
            self._write_pose("/odom", stamp, (tick.odometry.x, tick.odometry.y, tick.odometry.theta))
        else:
            self._write("/odom", stamp, make.odometry(stamp, tick.odometry, tick.increment_cov, tick.is_unmeasured))
        if tick.truth is not None:
            self._write_pose("/truth", stamp, (tick.truth.x, tick.truth.y, tick.truth.theta))
        if tick.scan is not None:
            self._add("/scan", stamp, self._scan(stamp, tick.scan, tick.log_stamp_s))
        if tick.observations is not None:
            self._write(OBSERVATIONS, stamp, make.cloud(stamp, tick.observations))
        for closure in tick.closures or ():
            self._write(CLOSURES, stamp, make.estimate(stamp, closure.motion, closure.cov, str(closure.before)))

    def _begin(self, stamp_ns: int, mount: tuple[float, float, float]) -> None:
        """The first message of all, where the laser is."""
        if not self._counts:
            self._first_ns = stamp_ns
            self._write("/tf_static", stamp_ns, self._messages.transform(stamp_ns, ROBOT, LASER, Pose(*mount)))

    def _record_new(self, stamp: int, trace: Trace) -> None:
        """Record what the trace has gained with a tick, and end the chunk if it is time."""
        make, self._last_ns = self._messages, stamp
        for estimate in trace.key_estimates[self._counts["/estimate"] :]:
            self._write("/estimate", stamp, make.estimate(stamp, estimate.pose, estimate.pose_cov))
        for topic, paths in (("/plan", trace.plans), (TOUR, trace.tours)):
            for path in paths[self._counts[topic] :]:
                self._write(topic, stamp, make.path(stamp, path))
        if self._pending >= _CHUNK_BYTES or time.monotonic() - self._flushed >= _CHUNK_S:
            self._flush(trace)

    def _register(self, topic: str) -> None:
        definition = self._messages.store.generate_msgdef(_TYPES[topic], ros_version=2)[0]
        schema: int = self._writer.register_schema(_TYPES[topic], "ros2msg", definition.encode())
        qos = {"offered_qos_profiles": _qos(topic)}
        self._channels[topic] = int(self._writer.register_channel(topic, "cdr", schema, qos))

    def _write(self, topic: str, stamp_ns: int, message: Any) -> None:
        if topic not in self._channels:  # one that not every bag has
            self._register(topic)
        self._add(topic, stamp_ns, self._messages.serialized(message, _TYPES[topic]))

    def _add(self, topic: str, stamp_ns: int, data: bytes) -> None:
        self._writer.add_message(self._channels[topic], stamp_ns, data, stamp_ns, self._counts[topic])
        self._counts[topic] += 1
        self._pending += len(data)

    def _write_pose(self, topic: str, stamp_ns: int, pose: Sequence[float]) -> None:
        """Write a tick's pose, x, y and heading."""
        self._add(topic, stamp_ns, self._forms[topic].fill(stamp_ns, pose_numbers(pose)))

    def _scan(self, stamp_ns: int, scan: Scan, log_stamp_s: float | None) -> bytes:
        """A scan's message: of those from one laser only stamps and ranges differ."""
        make = self._messages
        begin = max(stamp_ns + sweep_ns(len(scan.ranges), scan.time_increment), 0)
        header_ns = begin if log_stamp_s is None else round(Fraction(log_stamp_s) * 1_000_000_000)
        laser = (scan.angle_min, scan.angle_increment, scan.time_increment, scan.max_range, len(scan.ranges))
        if self._scan_form is None or laser != self._scan_form[0]:
            marks = np.linspace(*_MARKS, len(scan.ranges), dtype=np.float32)
            message = make.scan(0, dataclasses.replace(scan, ranges=marks))
            self._scan_form = laser, MessageForm(make.serialized(message, TOPICS["/scan"]), marks)
        return self._scan_form[1].fill(header_ns, scan.ranges)

    def _write_metadata(self) -> None:
        import yaml

        count = sum(self._counts.values())
        start = {"nanoseconds_since_epoch": self._first_ns}
        duration = {"nanoseconds": self._last_ns - self._first_ns}
        topics = [
            {
                "topic_metadata": {
                    "name": topic,
                    "type": _TYPES[topic],
                    "serialization_format": "cdr",
                    "offered_qos_profiles": _qos(topic),
                },
                "message_count": self._counts[topic],
            }
            for topic in self._channels
        ]
        table = {
            "version": 5,
            "storage_identifier": "mcap",
            "relative_file_paths": [_FILE],
            "duration": duration,
            "starting_time": start,
            "message_count": count,
            "topics_with_message_count": topics,
            "compression_format": "",
            "compression_mode": "",
            "files": [{"path": _FILE, "starting_time": start, "duration": duration, "message_count": count}],
        }
        text = yaml.safe_dump({"rosbag2_bagfile_information": table}, sort_keys=False)
        (self._bag / "metadata.yaml").write_text(text, encoding="utf-8")


def _qos(topic: str) -> str:
    return _LATCHED_QOS if topic == "/tf_static" else ""
