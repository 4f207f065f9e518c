"""The folder of a run as a log: the evidence its bag recorded, to the bit, as far as the bag goes."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from sixthsense.config import LaserConfig
from sixthsense.config.errors import InputError
from sixthsense.core.geometry import Array, Pose
from sixthsense.core.source import Tick
from sixthsense.sources.logs import LogError
from sixthsense.sources.logs.cloud import CLOUD, from_cloud, stated_covariance
from sixthsense.sources.logs.inflate import check_regular, inflated
from sixthsense.sources.logs.messages import LASER_SCAN, ODOMETRY, planar, scan, stamp_ns
from sixthsense.sources.logs.rosbag import LARGEST_STAMP_NS, BagLog

TRUTH, PLAN = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Path"
_TYPES = {"/odom": ODOMETRY, "/truth": TRUTH, "/scan": LASER_SCAN, "/plan": PLAN, "/sightings": CLOUD}
_LARGEST_CHUNK = 1 << 26  # bytes; ours have one million


def read_run(folder: str | Path, laser: LaserConfig) -> BagLog:
    """Read what a run's folder, or its `.partial`, has recorded: odometry, scans, sightings, truth and plans.

    `laser` is that of the folder's configuration; beams and ranges are the bag's. A bag without its end is read up to
    its last whole chunk. Raises LogError for a folder without a bag, or one without a scan or a sighting.
    """
    file = Path(folder) / "bag" / "bag_0.mcap"
    ticks: list[Tick] = []
    plans: list[tuple[int, Array]] = []
    reader = _Chunks(file)
    place = Pose(*laser.mount)
    try:
        for topic, record_ns, message in reader.messages():
            if topic == "/odom":
                pose = planar(message.pose.pose.position, message.pose.pose.orientation)
                last_ns = ticks[-1].stamp_ns if ticks else -1
                if not last_ns < record_ns <= LARGEST_STAMP_NS:
                    raise LogError(f"{file}: found a tick at {record_ns} ns after {last_ns} ns, allowed: ascending")
                ticks.append(Tick(record_ns, pose, increment_cov=stated_covariance(message)))
            elif topic == "/plan":
                points = [(p.pose.position.x, p.pose.position.y) for p in message.poses]
                plans.append((record_ns, np.array(points, dtype=np.float64).reshape(-1, 2)))
            elif ticks and topic == "/truth":
                ticks[-1] = replace(ticks[-1], truth=planar(message.pose.position, message.pose.orientation))
            elif ticks and topic == "/sightings":
                ticks[-1] = replace(ticks[-1], sightings=from_cloud(message))
            elif ticks:
                # The message has the range's digits of a float32 only.
                known = laser.max_range if np.float32(laser.max_range) == np.float32(message.range_max) else None
                ticks[-1] = replace(ticks[-1], scan=scan(message, place, max_range=known))
                own = stamp_ns(message) / 1e9
                ticks[-1] = replace(ticks[-1], log_stamp_s=own)
    except InputError:
        raise
    except Exception as error:  # the checksums were right, and yet it is no message
        raise LogError(f"{file}: found a message that cannot be read ({error}), allowed: a bag of a run") from None
    if not any(tick.scan is not None or tick.sightings is not None for tick in ticks):
        cut = " before it ends" * reader.cut_short
        raise LogError(f"{file}: found no scan and no sighting{cut}, allowed: a bag of a run")
    log = BagLog(ticks, laser)
    log.plan_stamps_ns, log.plans = tuple(stamp for stamp, _ in plans), tuple(plan for _, plan in plans)
    log.cut_short = reader.cut_short
    return log


class _Chunks:
    """The messages of an MCAP file, chunk by chunk, up to where it ends or is damaged."""

    def __init__(self, file: Path) -> None:
        self._file = file
        self.cut_short = True

    def messages(self) -> Iterator[tuple[str, int, Any]]:
        """Topic, record time in ns, and message; only topics that a log is made of."""
        from mcap.exceptions import McapError
        from mcap.records import Channel, Message
        from rosbags.typesys import Stores, get_typestore

        store = get_typestore(Stores.ROS2_HUMBLE)
        topics: dict[int, str] = {}
        try:
            check_regular(self._file)
            with self._file.open("rb") as stream:
                for record in self._records(stream):
                    if isinstance(record, Channel):
                        topics[record.id] = record.topic
                    elif isinstance(record, Message) and (topic := topics.get(record.channel_id, "")) in _TYPES:
                        yield topic, record.log_time, store.deserialize_cdr(record.data, _TYPES[topic])
        except FileNotFoundError:
            raise LogError(
                f"{self._file}: no such file, allowed: the folder of a run that has recorded a bag"
            ) from None
        except OSError as error:
            raise LogError(f"{self._file}: cannot be read ({error.strerror})") from None
        except (McapError, struct.error):
            raise LogError(f"{self._file}: is no MCAP file, allowed: a bag of a run") from None

    def _records(self, stream: IO[bytes]) -> Iterator[Any]:
        """The records within whole chunks."""
        from mcap.data_stream import ReadDataStream
        from mcap.records import Chunk, DataEnd
        from mcap.stream_reader import StreamReader, breakup_chunk, read_magic

        read_magic(ReadDataStream(stream))
        records = iter(
            StreamReader(stream, skip_magic=True, emit_chunks=True, record_size_limit=_LARGEST_CHUNK).records
        )
        while True:
            try:
                record = next(records)
                if isinstance(record, DataEnd):
                    self.cut_short = False
                    return
                if not isinstance(record, Chunk):
                    continue
                plain = replace(record, data=inflated(record.data, record.compression), compression="")
                content = breakup_chunk(plain, validate_crc=True)
            except Exception:
                # The writer was stopped here; half a record fails in as many ways as there are fields. A checksum
                # guards each chunk, so that what was read before is right.
                return
            yield from content
