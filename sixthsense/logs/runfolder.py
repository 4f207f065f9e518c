"""A run folder as a log: odometry, scans, observations, truth and plans of its bag, without loss."""

from __future__ import annotations

import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick
from sixthsense.logs.bag_file import decompressed
from sixthsense.logs.log import Log
from sixthsense.logs.ros_messages import (
    CLOUD,
    LASER_SCAN,
    ODOMETRY,
    checked_stamp,
    closure_of,
    from_cloud,
    is_unmeasured,
    planar,
    read_increment_covariance,
    scan,
    stamp_ns,
)
from sixthsense.logs.text_lines import check_regular

TRUTH, PLAN = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path"
_TYPES = {
    "/odom": ODOMETRY,
    "/truth": TRUTH,
    "/scan": LASER_SCAN,
    "/plan": PLAN,
    "/tour": PLAN,
    "/observations": CLOUD,
    "/closures": "geometry_msgs/msg/PoseWithCovarianceStamped",
}
_LARGEST_CHUNK = 1 << 26  # bytes; the bag writer's chunks have one million


class RunLog(Log):
    """The bag of a run."""

    plans: Sequence[tuple[int, Array]] = ()
    """Record time and planned path (N, 2)."""
    tours: Sequence[tuple[int, Array]] = ()
    """The same of the tours of an exploration."""


def read_run(folder: str | Path, laser: LaserConfig) -> RunLog:
    """Read the bag of a run folder, or of its `.partial`: evidence, truth, plans and tours.

    `laser` is that of the folder's configuration; beams and ranges come from the bag. An incomplete bag is read up to
    its last whole chunk. Raises InputError for a folder without a bag, or a bag without a scan or an observation.
    """
    file = Path(folder) / "bag" / "bag_0.mcap"
    ticks: list[Tick] = []
    paths: dict[str, list[tuple[int, Array]]] = {"/plan": [], "/tour": []}
    is_cut_short, place = False, Pose(*laser.mount)
    try:
        for topic, record_ns, message in _messages(file):
            if topic == "/odom":
                pose = planar(message.pose.pose.position, message.pose.pose.orientation)
                last_ns = ticks[-1].stamp_ns if ticks else -1
                if checked_stamp(str(file), record_ns) <= last_ns:
                    raise InputError(file, f"found a tick at {record_ns} ns after {last_ns} ns", "ascending")
                cov = read_increment_covariance(message)
                ticks.append(Tick(record_ns, pose, increment_cov=cov, is_unmeasured=is_unmeasured(message)))
            elif topic in paths:
                points = [(p.pose.position.x, p.pose.position.y) for p in message.poses]
                paths[topic].append((record_ns, np.array(points, dtype=np.float64).reshape(-1, 2)))
            elif ticks and topic == "/truth":
                ticks[-1] = replace(ticks[-1], truth=planar(message.pose.position, message.pose.orientation))
            elif ticks and topic == "/observations":
                ticks[-1] = replace(ticks[-1], observations=from_cloud(message))
            elif ticks and topic == "/closures":
                closure = closure_of(message, len(ticks) - 1)
                ticks[-1] = replace(ticks[-1], closures=(*(ticks[-1].closures or ()), closure))
            elif ticks:
                # The message has the maximum range as a float32 only.
                known = laser.max_range if np.float32(laser.max_range) == np.float32(message.range_max) else None
                seen = scan(message, place, max_range=known)
                # Negative where the last beam was taken first, of which a message of another writer says nothing.
                seen = replace(seen, time_increment=np.float32(message.time_increment))
                ticks[-1] = replace(ticks[-1], scan=seen, log_stamp_s=stamp_ns(message) / 1_000_000_000)
    except InputError:
        raise
    except _CutShortError:
        is_cut_short = True
    except Exception as error:  # a message with valid checksums may still be invalid
        raise InputError(file, f"found a message that cannot be read ({error})", "a bag of a run") from None
    if not any(tick.scan is not None or tick.observations is not None for tick in ticks):
        cut = " before it ends" * is_cut_short
        raise InputError(file, f"found no scan and no observation{cut}", "a bag of a run")
    if any(tick.closures for tick in ticks):
        ticks = [replace(tick, closures=tick.closures or ()) for tick in ticks]
    used_s = 1e-9 * (ticks[-1].stamp_ns - ticks[0].stamp_ns)
    remarks = [f"the recording is incomplete; its first {used_s:.1f} s are used"] * is_cut_short
    log = RunLog(ticks, laser, remarks)
    log.plans, log.tours = paths["/plan"], paths["/tour"]
    return log


class _CutShortError(Exception):
    """A recording has been read up to where it ends early."""


def _messages(file: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, record time in ns, and message, for the topics of a log, chunk by chunk of an MCAP file."""
    from mcap.exceptions import McapError
    from mcap.records import Channel, Message
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    topics: dict[int, str] = {}
    try:
        check_regular(file)
        with file.open("rb") as stream:
            for record in _records(stream):
                if isinstance(record, Channel):
                    topics[record.id] = record.topic
                elif isinstance(record, Message) and (topic := topics.get(record.channel_id, "")) in _TYPES:
                    yield topic, record.log_time, store.deserialize_cdr(record.data, _TYPES[topic])
    except FileNotFoundError:
        raise InputError(file, "no such file", "a run folder with a bag") from None
    except OSError as error:
        raise InputError(file, f"cannot be read ({error.strerror})") from None
    except (McapError, struct.error):
        raise InputError(file, "is not an MCAP file", "a bag of a run") from None


def _records(stream: IO[bytes]) -> Iterator[Any]:
    """The records of whole chunks; raises _CutShortError after them if the file ends early, or is damaged there."""
    from mcap.data_stream import ReadDataStream
    from mcap.records import Chunk, DataEnd
    from mcap.stream_reader import StreamReader, breakup_chunk, read_magic

    read_magic(ReadDataStream(stream))
    records = iter(StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=_LARGEST_CHUNK).records)
    while True:
        try:
            record = next(records)
            if isinstance(record, DataEnd):
                return
            if not isinstance(record, Chunk):
                continue
            plain = replace(record, data=decompressed(record.data, record.compression), compression="")
            content = breakup_chunk(plain, validate_crc=True)
        except Exception:
            # The writer was stopped here; an incomplete record can raise any exception. Each chunk has a checksum,
            # so the records read before are valid.
            raise _CutShortError from None
        yield from content
