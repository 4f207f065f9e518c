"""The map on the network, drawn and sent by a process of its own: a large one takes longer than a scan may wait.

Who subscribes to /map and /map_updates gets the whole map once, and then what changes; who takes /map alone gets it
whole each time. The whole map goes out also when its size changes, and when a subscriber comes.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import queue
import time
from collections.abc import Callable
from multiprocessing.queues import Queue
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from sixthsense.config import GridConfig
from sixthsense.config.errors import InputError
from sixthsense.live.network import LARGEST_MESSAGE_BYTES, Network, Node
from sixthsense.live.topics import LATCHED, RELIABLE, Topic
from sixthsense.loop.interrupt import terminal_blocked
from sixthsense.record.messages import MAP_UPDATE, Messages
from sixthsense.record.trace import Trace
from sixthsense.slam.mapping.changes import Box, Revision, box_of
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Additions, Mapper
from sixthsense.slam.mapping.submap import Submap

MAP = Topic("/map", "nav_msgs/msg/OccupancyGrid", LATCHED)
UPDATES = Topic("/map_updates", MAP_UPDATE, RELIABLE)

_PERIOD_S = 2.0
_POLL_S = 0.2  # from one look for new subscribers to the next
_LEAVE_S = 3.0  # that the process may take to end
_HEADER_BYTES = 1024  # of a map, at most
_NICE = 5  # of the process beside the loop's


class Part(NamedTuple):
    """What has changed of a map."""

    stamp_ns: int
    whole: Box
    """all of the map"""
    changed: Box
    occupancy: NDArray[np.int8]
    """(H, W) of that box, as a map server has it: 0 seen and free, 100 obstacle, -1 unknown"""
    cell_m: float


def part_since(revision: Revision | None, stamp_ns: int, grid: Grid, cell_m: float) -> Part | None:
    """What of a grid has changed since a state; None if nothing has, and for a map that is too large for a message."""
    whole, changed = grid.box, grid.changes.since(revision)
    size = (whole.bottom - whole.top) * (whole.right - whole.left)
    if size == 0 or size + _HEADER_BYTES > LARGEST_MESSAGE_BYTES or changed == Box(0, 0, 0, 0):
        return None
    changed = changed or whole
    occupancy = grid.part("seen", changed).astype(np.int8) - np.int8(1)
    occupancy[grid.part("obstacles", changed)] = 100
    return Part(stamp_ns, whole, changed, occupancy, cell_m)


class MapWriter:
    """Composes the map of its parts, and writes it."""

    def __init__(self, node: Node) -> None:
        self._messages = Messages()
        self._map, self._updates = node.writer(MAP), node.writer(UPDATES)
        self._whole, self._cells = Box(0, 0, 0, 0), np.zeros((0, 0), np.int8)
        self._last: Part | None = None
        self._served = 0  # subscribers that have the map as it is

    def take(self, part: Part) -> None:
        """Take in what has changed, and tell it."""
        is_resized = part.whole != self._whole
        if is_resized:
            self._resize(part.whole)
        first, self._last = part.whole[:2], part
        rows, cols = part.changed.within(first, self._cells.shape)
        top, left = (max(edge - changed, 0) for edge, changed in zip(first, part.changed[:2], strict=True))
        own = self._cells[rows, cols]
        new = part.occupancy[top : top + own.shape[0], left : left + own.shape[1]]
        differs = np.argwhere(own != new)
        own[:] = new
        if is_resized:
            self._served = 0
        elif len(differs) and self._map.readers and not self._lacks_map():
            box = box_of(differs)
            changed = Box(box.top + rows.start, box.left + cols.start, box.bottom + rows.start, box.right + cols.start)
            if self._updates.readers < self._map.readers or not self._send_update(part.stamp_ns, changed):
                self._served = 0
        self.serve()

    def serve(self) -> None:
        """Send the map to subscribers that have come, or that do not have it as it is."""
        if self._last is not None and self._lacks_map():
            readers, (row, col), cell_m = self._map.readers, self._whole[:2], self._last.cell_m
            origin = col * cell_m, row * cell_m
            message = self._messages.occupancy(self._last.stamp_ns, self._cells, origin, cell_m)
            if self._map.send(self._messages.serialized(message, MAP.type)):
                self._served = readers

    def _lacks_map(self) -> bool:
        """Whether a subscriber has not got the map as it was before the last change."""
        readers = self._map.readers
        self._served = min(self._served, readers)
        return readers > self._served

    def _send_update(self, stamp_ns: int, box: Box) -> bool:
        """Send the cells of a box, rows and columns of the map; whether it is sent."""
        cells = self._cells[box.top : box.bottom, box.left : box.right]
        message = self._messages.occupancy_update(stamp_ns, cells, (box.top, box.left))
        return self._updates.send(self._messages.serialized(message, UPDATES.type))

    def _resize(self, whole: Box) -> None:
        """Make room for a map that has grown; new cells are unknown."""
        cells = np.full((whole.bottom - whole.top, whole.right - whole.left), -1, np.int8)
        inner = cells[self._whole.within(whole[:2], cells.shape)]
        inner[:] = self._cells[whole.within(self._whole[:2], self._cells.shape)]
        self._whole, self._cells = whole, cells


class Beginning(NamedTuple):
    """What a map begins with."""

    config: GridConfig
    radius_m: float
    """of the robot"""
    earlier: Submap | None
    """evidence of an earlier run"""


class News(NamedTuple):
    """The keyframes that a map has gained."""

    stamp_ns: int
    beginning: Beginning | None
    """of another map; None: the map goes on"""
    additions: Additions


class MapSender:
    """Gives the keyframes of the map to a process that draws and sends it. A context manager, which ends it."""

    def __init__(self, network: Network, say: Callable[[str], object]) -> None:
        """Begin; the process joins the network by itself. `say` prints a line if it cannot."""
        self._say = say
        context = multiprocessing.get_context("spawn")
        self._queue: Queue[News | None] = context.Queue()
        self._is_free = context.Semaphore(1)
        self._seen_m2 = context.Value("d", 0.0)
        arguments = (network, self._queue, self._is_free, self._seen_m2)
        self._process = context.Process(target=_send_maps, args=arguments, name="maps", daemon=True)
        with terminal_blocked():  # who has started the process ends it
            self._process.start()
        self._taken_s, self._has_ended = -_PERIOD_S, False
        self._keyframes = self._scans = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._queue.put(None)
        self._process.join(_LEAVE_S)
        self._process.kill()
        self._queue.cancel_join_thread()

    def begin_anew(self) -> None:
        """The next map that is offered is another one."""
        self._keyframes = self._scans = 0

    @property
    def seen_m2(self) -> float:
        """Area of the map as it was sent last."""
        return float(self._seen_m2.value)

    def offer(self, stamp_ns: int, trace: Trace) -> None:
        """Give on new keyframes, at most every two seconds and if the last ones are drawn and sent: none waits."""
        keyframes, now_s = len(trace.key_stamps_ns), time.monotonic()
        if keyframes == self._keyframes or now_s - self._taken_s < _PERIOD_S or self._has_ended:
            return
        if not self._process.is_alive():
            self._has_ended = True
            self._say("the map is not sent: the process that sends it has ended")
        elif self._is_free.acquire(block=False):
            assert trace.live is not None
            mapper, beginning = trace.live.mapper, None
            if not self._keyframes:
                beginning = Beginning(trace.config.grid, trace.radius_m, mapper.earlier)
            additions = mapper.additions(self._scans)
            self._taken_s, self._keyframes, self._scans = now_s, keyframes, self._scans + len(additions.scans)
            self._queue.put(News(stamp_ns, beginning, additions))


def map_drawer(writer: MapWriter, beginning: Beginning) -> Callable[[News], Grid]:
    """What draws a map of its keyframes, and gives what has changed to a writer; it returns the map."""
    config, radius_m, earlier = beginning
    mapper = Mapper(config, radius_m)
    if earlier is not None:
        mapper.start_from(earlier)
    sent: Revision | None = None

    def draw(news: News) -> Grid:
        nonlocal sent
        mapper.take(news.additions)
        grid = mapper.draw()
        if (part := part_since(sent, news.stamp_ns, grid, config.cell_m)) is not None:
            sent = grid.changes.revision
            writer.take(part)
        return grid

    return draw


def _send_maps(network: Network, news: Queue[News | None], is_free: Any, seen_m2: Any) -> None:
    """Draw and send the map, as long as the process lives that gives its keyframes, which goes before."""
    parent = multiprocessing.parent_process()
    if hasattr(os, "nice"):  # not on Windows
        os.nice(_NICE)
    with contextlib.suppress(InputError), Node(network) as node:
        writer = MapWriter(node)
        draw: Callable[[News], Grid] | None = None
        while parent is None or parent.is_alive():
            try:
                some = news.get(timeout=_POLL_S)
            except queue.Empty:
                writer.serve()
                continue
            if some is None:
                return
            if some.beginning is not None:
                draw = map_drawer(writer, some.beginning)
            assert draw is not None
            seen_m2.value = draw(some).seen_area_m2
            is_free.release()
