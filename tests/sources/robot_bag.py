"""A bag of a robot in a room, as its drivers might have written it: what is odd about it is a keyword."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from sixthsense.core.geometry import Array, Pose
from sixthsense.core.ray_casting import cast_rays
from sixthsense.core.source import Tick

WALLS = np.array(
    [[[-2.7, -2.1], [4.1, -2.1]], [[4.1, -2.1], [4.1, 3.2]], [[4.1, 3.2], [-2.7, 3.2]], [[-2.7, 3.2], [-2.7, -2.1]],
     [[1.6, -2.1], [1.6, -1.2]], [[2.4, 1.5], [3.1, 1.9]], [[-1.3, 2.0], [-1.9, 1.4]]]
)  # fmt: skip
MOUNT, T0_NS = Pose(0.17, -0.06, 0.35), 1_700_000_000_123_456_789
LINKS = (("static", "base_footprint", "base_link", Pose()), ("static", "base_link", "laser", MOUNT))
_SCAN, _ECHO, _ODOM = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/MultiEchoLaserScan", "nav_msgs/msg/Odometry"
_TF, _CLOUD = "tf2_msgs/msg/TFMessage", "sensor_msgs/msg/PointCloud2"


def way(seconds: float) -> Pose:
    """The true pose: it drives and turns, to either side in no regular way."""
    turn = 0.9 * math.sin(0.8 * seconds) + 0.3 * math.sin(2.9 * seconds) + 0.2
    return Pose(0.9 * math.sin(0.35 * seconds) - 0.3, 0.7 * math.sin(0.2 * seconds) + 0.1, turn)


def robot_bag(
    path: Path,
    kind: str = "mcap",
    *,
    seconds: float = 6.0,
    scan=lambda k, says: says,
    odom=lambda k, says: says,
    links=LINKS,
    odom_in_tf: bool = False,
    inverted: bool = False,
    late_s: float = 0.0,
    echo: bool = False,
    namespace: str = "",
) -> Path:
    """Write the bag: odometry every 20 ms and a scan of 240 beams every 100 ms.

    `scan` and `odom` change what scan or pose number `k` says, a dictionary, or leave the message out by None. `links`
    are constant transforms, static or of /tf. The scans' clock is `late_s` ahead of the others.
    """
    one = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    if one:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", _TF))
    path = path.with_suffix(".bag") if one else path
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    writer = Writer1(path) if one else Writer2(path, version=9, storage_plugin=plugin)
    topics: dict = {}

    def make(name, *values):
        return store.types[name](*values)

    def header(stamp_ns, frame):
        time = make("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
        return make("std_msgs/msg/Header", *((0,) if one else ()), time, frame)

    def turned(theta):
        return make("geometry_msgs/msg/Quaternion", 0.0, 0.0, math.sin(0.5 * theta), math.cos(0.5 * theta))

    def transform(stamp_ns, parent, child, pose):
        shift = make("geometry_msgs/msg/Vector3", pose.x, pose.y, 0.0)
        shift = make("geometry_msgs/msg/Transform", shift, turned(pose.theta))
        return make("geometry_msgs/msg/TransformStamped", header(stamp_ns, parent), child, shift)

    def put(topic, name, message, record_ns):
        topic = topic if topic.startswith("/tf") else namespace + topic
        if topic not in topics:
            topics[topic] = writer.add_connection(topic, name, typestore=store)
        data = (store.serialize_ros1 if one else store.serialize_cdr)(message, name)
        writer.write(topics[topic], record_ns, data)

    def put_scan(k, record_ns):
        t, count, step = 0.1 * k, 240, math.radians(1.2)
        says = {"first": -2.0, "step": step, "count": count, "low": 0.05, "high": 9.0, "frame": "laser",
                "stamp_ns": record_ns + round(late_s * 1e9), "topic": "/scan", "ranges": None, "unit": 1.0}  # fmt: skip
        says = scan(k, says)
        if says is None:
            return
        bearings = says["first"] + says["step"] * np.arange(says["count"])
        ranges = cast_rays(way(t) @ MOUNT, bearings, WALLS, 100.0) if says["ranges"] is None else says["ranges"]
        row = np.asarray(ranges, np.float32)[:: -1 if says.get("is_mirrored") else 1]
        angles = says["first"], bearings[-1] if len(bearings) else 0.0, says["step"]
        angles = tuple(float(a) * says.get("angle_unit", 1.0) for a in angles)
        unit = says["unit"]
        row = row * np.float32(unit)
        rest = (0.0, 0.1, says["low"] * unit, says["high"] * unit)
        name = _ECHO if echo else _SCAN
        beams = [make("sensor_msgs/msg/LaserEcho", row[i : i + 1]) for i in range(len(row))] if echo else row
        message = make(name, header(says["stamp_ns"], says["frame"]), *angles, *rest, beams, [] if echo else row[:0])
        put(says["topic"], name, message, record_ns)

    def put_odom(k, record_ns):
        says = {"pose": way(0.02 * k), "child": "base_footprint", "stamp_ns": record_ns, "turn": None, "unit": 1.0}
        says = odom(k, says)
        if says is None:
            return
        pose = says["pose"]
        if odom_in_tf:
            pair = ("base_footprint", "odom", pose.inverse()) if inverted else ("odom", "base_footprint", pose)
            put("/tf", _TF, make(_TF, [transform(says["stamp_ns"], *pair)]), record_ns)
            return
        zero, cov = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0), np.zeros(36)
        point = make("geometry_msgs/msg/Point", says["unit"] * pose.x, says["unit"] * pose.y, 0.0)
        turn = turned(pose.theta) if says["turn"] is None else make("geometry_msgs/msg/Quaternion", *says["turn"])
        spread = make("geometry_msgs/msg/PoseWithCovariance", make("geometry_msgs/msg/Pose", point, turn), cov)
        twist = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", zero, zero), cov)
        put("/odom", _ODOM, make(_ODOM, header(says["stamp_ns"], "odom"), says["child"], spread, twist), record_ns)

    with writer:
        statics = [transform(T0_NS, *link) for where, *link in links if where == "static"]
        if statics:
            put("/tf_static", _TF, make(_TF, statics), T0_NS)
        for k in range(int(50 * seconds)):
            record_ns = T0_NS + 20_000_000 * k
            put_odom(k, record_ns)
            moving = [transform(record_ns, *link) for where, *link in links if where == "tf"]
            if moving and k % 5 == 0:
                put("/tf", _TF, make(_TF, moving), record_ns)
            if k % 5 == 0:
                put_scan(k // 5, record_ns)
    return path


def off_walls_m(ticks: Iterable[Tick]) -> float:
    """Largest distance of a return from the walls, of scans at the true poses of their stamps."""
    worst = 0.0
    for tick in ticks:
        if tick.scan is not None:
            points = way(1e-9 * (tick.stamp_ns - T0_NS)) @ tick.scan.points_robot[np.isfinite(tick.scan.ranges)]
            worst = max(worst, float(_distances(points).max(initial=0.0)))
    return worst


def _distances(points: Array) -> Array:
    a, along = WALLS[:, 0], WALLS[:, 1] - WALLS[:, 0]
    share = np.einsum("nwi,wi->nw", points[:, None] - a, along) / np.sum(along**2, axis=1)
    feet = a + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.linalg.norm(points[:, None] - feet, axis=2).min(axis=1)
