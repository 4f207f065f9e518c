"""The map on the network is the map that the run would draw, also when poses move."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.live import maps
from sixthsense.live.maps import MAP, MapSender
from sixthsense.record.messages import Messages
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper

MAKE = Messages()
CONFIG = preset(grid={"cell_m": 0.15})


class Writer:
    """A subscriber of the map."""

    def __init__(self) -> None:
        self.sent: list[Any] = []

    def send(self, data: bytes) -> bool:
        self.sent.append(MAKE.store.deserialize_cdr(data, MAP.type))
        return True

    @property
    def cells(self) -> np.ndarray:
        info = self.sent[-1].info
        return np.array(self.sent[-1].data).reshape(info.height, info.width)


def idle(sender: MapSender) -> None:
    """Wait until the thread has sent what it was offered."""
    while sender._has_news.is_set():
        pass


def a_scan(rng: np.random.Generator) -> Scan:
    return Scan(rng.uniform(1.0, 5.0, 200).astype(np.float32), np.float32(-2.9), np.float32(0.029), 9.0)


@pytest.mark.parametrize("is_prior", [False, True])
def test_the_thread_sends_what_the_run_would_draw(is_prior, monkeypatch):
    monkeypatch.setattr(maps, "_PERIOD_S", 0.0)
    rng, writer, own = np.random.default_rng(4), Writer(), Mapper(CONFIG.grid, 0.2)
    if is_prior:
        earlier = Grid(CONFIG.grid, 0.2)
        earlier.add(Pose(1.3, 5.2, 0.3), a_scan(rng), np.zeros((0, 2, 2)))
        own.start_from(earlier.submap())
    trace: Any = SimpleNamespace(config=CONFIG, radius_m=0.2, key_stamps_ns=[], live=SimpleNamespace(mapper=own))
    trajectory = np.zeros((0, 3))
    with MapSender(writer, print) as sender:
        for count in (1, 4, 13, 14, 31):
            for k in range(len(trajectory), count):
                here = Pose(0.4, -0.3, 0.7) @ Pose(0.21 * k, 0.03 * k, 0.17 * k)
                trajectory = np.vstack([trajectory + 0.004 * rng.standard_normal((k, 3)), here.array()])
                own.add(k, trajectory.copy, a_scan(rng), np.array([[[1.1, 2.2], [3.1, 2.4]]]))
                trace.key_stamps_ns.append(k)
            sender.offer(1_700_000_000_123_456_789 + count, trace)
            idle(sender)
            grid = own.draw()
            np.testing.assert_array_equal(writer.cells, grid.occupancy())
            origin = writer.sent[-1].info.origin.position
            assert (origin.x, origin.y) == grid.origin
        sender.offer(2, trace)  # nothing is new
        idle(sender)
    assert len(writer.sent) == 5


def test_a_map_that_is_too_large_for_a_message_is_told_once_and_not_sent(monkeypatch):
    monkeypatch.setattr(maps, "_PERIOD_S", 0.0)
    monkeypatch.setattr(maps, "LARGEST_MESSAGE_BYTES", 2000)
    lines, writer, own = [], Writer(), Mapper(CONFIG.grid, 0.2)
    trace: Any = SimpleNamespace(config=CONFIG, radius_m=0.2, key_stamps_ns=[], live=SimpleNamespace(mapper=own))
    with MapSender(writer, lines.append) as sender:
        for k in range(2):
            own.add(
                k,
                lambda k=k: np.array([[0.4 * j, 0.0, 0.0] for j in range(k + 1)]),
                a_scan(np.random.default_rng(k)),
                np.zeros((0, 2, 2)),
            )
            trace.key_stamps_ns.append(k)
            sender.offer(k, trace)
            idle(sender)
    assert not writer.sent and len(lines) == 1 and "the map is not sent any more" in lines[0]
