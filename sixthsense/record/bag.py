"""A run's record as a ROS 2 bag with MCAP storage."""

from __future__ import annotations

import heapq
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any

from sixthsense.core.geometry import Pose
from sixthsense.core.source import Tick
from sixthsense.logs.runfolder import RunLog, read_run
from sixthsense.record.messages import LASER, ROBOT, Messages
from sixthsense.record.trace import Trace

TOPICS = {
    "/tf_static": "tf2_msgs/msg/TFMessage",
    "/odom": "nav_msgs/msg/Odometry",
    "/truth": "geometry_msgs/msg/PoseStamped",
    "/scan": "sensor_msgs/msg/LaserScan",
    "/estimate": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "/plan": "nav_msgs/msg/Path",
    "/tour": "nav_msgs/msg/Path",
}
"""topics and their types, in the order of one tick"""

Stamped = tuple[int, str, Any]
"""record time, ns, topic and message"""


def write_bag(out: Path, run: Path, trace: Trace) -> None:
    """Write the record in the folder `run` as a bag, a new folder `out`; `trace` is that of the record.

    The record time of a message is the stamp of its tick. A scan's header has the stamp of the log, or without one the
    stamp of its first beam, as in ROS.
    """
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
    from rosbags.rosbag2 import StoragePlugin, Writer

    make, log = Messages(), read_run(run, trace.config.laser)
    forever = QosTime(9_223_372_036, 854_775_807)
    # Transient local: subscribers that come later receive the mount, too.
    latched = Qos(
        QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
        forever, forever, QosLiveliness.AUTOMATIC, forever, False,
    )  # fmt: skip
    with Writer(out, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        channels = {
            topic: bag.add_connection(
                topic, kind, typestore=make.store, offered_qos_profiles=[latched] if topic == "/tf_static" else []
            )
            for topic, kind in TOPICS.items()
        }
        for stamp_ns, topic, message in _messages(make, trace, log):
            bag.write(channels[topic], stamp_ns, make.serialized(message, TOPICS[topic]))


def _messages(make: Messages, trace: Trace, log: RunLog) -> Iterator[Stamped]:
    """All messages, in the order of their record times."""
    begin_ns = log.ticks[0].stamp_ns
    yield begin_ns, "/tf_static", make.transform(begin_ns, ROBOT, LASER, Pose(*trace.config.laser.mount))
    estimates = (
        (stamp_ns, "/estimate", make.estimate(stamp_ns, estimate.pose, estimate.pose_cov))
        for stamp_ns, estimate in zip(trace.key_stamps_ns, trace.key_estimates, strict=True)
    )
    plans = ((stamp_ns, "/plan", make.path(stamp_ns, path)) for stamp_ns, path in log.paths("plan"))
    tours = ((stamp_ns, "/tour", make.path(stamp_ns, path)) for stamp_ns, path in log.paths("tour"))
    ticks = (message for tick in log.ticks for message in _of_tick(make, tick))
    yield from heapq.merge(ticks, estimates, plans, tours, key=lambda message: message[0])


def _of_tick(make: Messages, tick: Tick) -> Iterator[Stamped]:
    stamp_ns, scan = tick.stamp_ns, tick.scan
    yield stamp_ns, "/odom", make.odometry(stamp_ns, tick.odometry)
    if tick.truth is not None:
        yield stamp_ns, "/truth", make.pose_stamped(stamp_ns, tick.truth)
    if scan is not None:
        header_ns = stamp_ns if tick.log_stamp_s is None else round(Fraction(tick.log_stamp_s) * 1_000_000_000)
        yield stamp_ns, "/scan", make.scan(header_ns, scan)
