"""The map on the network: a thread draws it of the keyframes and sends it whole, at most every two seconds."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Self

from sixthsense.live.network import LARGEST_MESSAGE_BYTES, Writer
from sixthsense.live.topics import LATCHED, Topic
from sixthsense.record.messages import Messages
from sixthsense.record.trace import Trace
from sixthsense.slam.mapping.mapper import Additions, Mapper

MAP = Topic("/map", "nav_msgs/msg/OccupancyGrid", LATCHED)

_PERIOD_S = 2.0
_HEADER_BYTES = 1024  # of a map, at most


class MapSender:
    """Draws the keyframes that it is offered in a thread of its own, and sends the map.

    The thread has a map of its own, so that the loop never waits for a large one. A context manager, which ends it.
    """

    def __init__(self, writer: Writer, say: Callable[[str], object]) -> None:
        """`writer` is of `MAP`; `say` prints a line if the map cannot be sent."""
        self._writer, self._say, self._messages = writer, say, Messages()
        self._mapper: Mapper | None = None
        self._cell_m = 0.0
        self._news: tuple[int, Additions] | None = None  # stamp of the latest keyframe, and what the map has gained
        self._keyframes = self._scans = 0  # that were offered
        self._has_news, self._is_over = threading.Event(), threading.Event()
        self._is_too_large = False
        self._offered_s = -_PERIOD_S
        self._thread = threading.Thread(target=self._run, name="map", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._has_news.set()
        self._thread.join()

    def offer(self, stamp_ns: int, trace: Trace) -> None:
        """Give on new keyframes, unless the thread still draws those before or the last map is not yet old."""
        keyframes, now_s = len(trace.key_stamps_ns), time.monotonic()
        if keyframes == self._keyframes or self._has_news.is_set() or now_s - self._offered_s < _PERIOD_S:
            return
        assert trace.live is not None
        mapper = trace.live.mapper
        if self._mapper is None:
            self._mapper, self._cell_m = Mapper(trace.config.grid, trace.radius_m), trace.config.grid.cell_m
            if mapper.earlier is not None:
                self._mapper.start_from(mapper.earlier)
        additions = mapper.additions(self._scans)
        self._keyframes, self._scans, self._offered_s = keyframes, self._scans + len(additions.scans), now_s
        self._news = stamp_ns, additions
        self._has_news.set()

    def _run(self) -> None:
        """Draw and send what is offered until the end."""
        while self._has_news.wait() and not self._is_over.is_set():
            assert self._news is not None
            self._send(*self._news)
            self._has_news.clear()

    def _send(self, stamp_ns: int, additions: Additions) -> None:
        assert self._mapper is not None
        self._mapper.take(additions)
        grid = self._mapper.draw()
        cells = grid.occupancy()
        if cells.size + _HEADER_BYTES > LARGEST_MESSAGE_BYTES:
            if not self._is_too_large:
                self._say(f"the map is not sent any more: found {cells.size} cells, allowed: {LARGEST_MESSAGE_BYTES}")
            self._is_too_large = True
        elif cells.size:
            message = self._messages.occupancy(stamp_ns, cells, grid.origin, self._cell_m)
            self._writer.send(self._messages.serialized(message, MAP.type))
