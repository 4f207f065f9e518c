"""Observations of identified landmarks as a ROS PointCloud2, without loss."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from sixthsense.core.landmarks import Kind, LandmarkId, Observation

CLOUD = "sensor_msgs/msg/PointCloud2"

_INT32, _UINT8, _FLOAT64 = 5, 2, 8  # of sensor_msgs/PointField
_POINT = np.dtype(
    [*((name, "<f8") for name in ("x", "y", "z", "cov_xx", "cov_xy", "cov_yy")), ("id", "<i4"), ("kind", "u1")]
)
_TYPES = {"<f8": _FLOAT64, "<i4": _INT32, "|u1": _UINT8}
FIELDS = tuple((name, offset, _TYPES[kind.str]) for name, (kind, offset) in _POINT.fields.items())  # type: ignore[union-attr, misc]
"""Name, offset in bytes and ROS's type number of each field of a point; z is 0, for viewers."""
POINT_BYTES = _POINT.itemsize


def to_bytes(observations: Mapping[LandmarkId, Observation]) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """(len(observations) * POINT_BYTES,) data of a cloud: positions (robot frame, m), covariances, ids, kinds."""
    points = np.zeros(len(observations), dtype=_POINT)
    for point, (i, s) in zip(points, observations.items(), strict=True):
        point["x"], point["y"] = s.z
        point["cov_xx"], point["cov_xy"], point["cov_yy"] = s.cov[0, 0], s.cov[0, 1], s.cov[1, 1]
        point["id"], point["kind"] = i, int(s.kind)
    return points.view(np.uint8).ravel()


def from_cloud(message: Any) -> dict[LandmarkId, Observation]:
    """The observations of a PointCloud2 written by `to_bytes`; ValueError for other clouds and for invalid numbers."""
    found = tuple((f.name, f.offset, f.datatype) for f in message.fields)
    if found != FIELDS or message.point_step != POINT_BYTES or message.is_bigendian:
        raise ValueError(f"found a cloud of {[name for name, *_ in found][:9]}, allowed: {[f[0] for f in FIELDS]}")
    if len(message.data) % POINT_BYTES:
        raise ValueError(f"found a cloud of {len(message.data)} bytes, allowed: {POINT_BYTES} a point")
    out: dict[LandmarkId, Observation] = {}
    for point in np.asarray(message.data, dtype=np.uint8).copy().view(_POINT):
        x, y, xx, xy, yy = (float(point[name]) for name in ("x", "y", "cov_xx", "cov_xy", "cov_yy"))
        if not np.isfinite([x, y, xx, xy, yy]).all() or not (xx > 0.0 and xx * yy - xy * xy > 0.0):
            raise ValueError(
                f"found an observation at {x}, {y} of covariance {xx}, {xy}, {yy}, allowed: finite, positive"
            )
        if int(point["id"]) in out:
            raise ValueError(f"found landmark {point['id']} twice in one cloud, allowed: once")
        out[int(point["id"])] = Observation(Kind(int(point["kind"])), np.array([x, y]), np.array([[xx, xy], [xy, yy]]))
    return out
