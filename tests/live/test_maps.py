"""Maps on the network: what a subscriber puts together of them is the map, whoever comes when."""

import pickle
from types import SimpleNamespace
from typing import Any

import numpy as np

from sixthsense.config import preset
from sixthsense.core.geometry import Pose
from sixthsense.core.laser import Scan
from sixthsense.live.maps import MAP, UPDATES, Beginning, MapWriter, News, map_drawer, part_since
from sixthsense.record.messages import Messages
from sixthsense.slam.mapping.grid import Grid
from sixthsense.slam.mapping.mapper import Mapper

MAKE, STAMP = Messages(), 1_700_000_000_123_456_789
NO_WALLS = np.zeros((0, 2, 2))


class Network:
    """A node, and a subscriber that puts the map together."""

    def __init__(self) -> None:
        self.readers, self.sent = {MAP.name: 0, UPDATES.name: 0}, []
        self.is_lost = False
        self.cells, self.info = np.zeros((0, 0), np.int8), None

    def writer(self, topic: Any) -> Any:
        node = self

        class Writer:
            @property
            def readers(self) -> int:
                return node.readers[topic.name]

            def send(self, data: bytes) -> bool:
                if node.is_lost:
                    return False
                node.hear(topic.name, MAKE.store.deserialize_cdr(data, topic.type))
                return True

        return Writer()

    def hear(self, name: str, message: Any) -> None:
        self.sent.append(name)
        if name == MAP.name:
            self.info = message.info
            self.cells = np.array(message.data).reshape(message.info.height, message.info.width)
        else:
            rows, cols = (
                slice(at, at + size) for at, size in ((message.y, message.height), (message.x, message.width))
            )
            self.cells[rows, cols] = np.array(message.data).reshape(message.height, message.width)


def a_trace() -> Any:
    config = preset(grid={"cell_m": 0.15})
    return SimpleNamespace(grid=Grid(config.grid, 0.2), config=config)


def look(trace: Any, at: Pose, range_m: float) -> None:
    """See around with beams of a length."""
    ranges = np.linspace(0.6, 1.0, 200, dtype=np.float32) * np.float32(range_m)
    trace.grid.add(at, Scan(ranges, np.float32(-2.9), np.float32(0.029), 9.0), NO_WALLS)


def test_what_a_subscriber_puts_together_is_the_map_also_when_it_grows_is_lost_or_someone_comes():
    node, trace, revision = Network(), a_trace(), None
    writer = MapWriter(node)

    def tell(at: Pose, range_m: float) -> list[str]:
        look(trace, at, range_m)
        node.sent.clear()
        nonlocal revision
        part = part_since(revision, STAMP, trace.grid, trace.config.grid.cell_m)
        revision = trace.grid.changes.revision
        assert part is not None and part_since(revision, STAMP, trace.grid, trace.config.grid.cell_m) is None
        writer.take(part)
        return list(node.sent)

    assert tell(Pose(0.4, -0.3, 0.7), 3.0) == []  # to nobody
    node.readers.update({MAP.name: 1, UPDATES.name: 1})
    writer.serve()
    assert node.sent == [MAP.name]
    steps = [
        (Pose(0.5, -0.3, 0.9), 3.1, {}, [UPDATES.name]),
        (Pose(0.5, -0.2, 1.4), 3.2, {MAP.name: 2}, [MAP.name]),
        (Pose(0.4, -0.1, 1.9), 3.1, {}, [MAP.name]),  # one of them takes no updates
        (Pose(0.3, -0.1, 2.2), 3.3, {MAP.name: 1}, [UPDATES.name]),
        (Pose(29.3, -37.1, 2.2), 3.3, {}, [MAP.name]),  # it has grown
        (Pose(29.2, -37.0, 2.9), 3.4, {}, [UPDATES.name]),
    ]
    for at, range_m, readers, expected in steps:
        node.readers.update(readers)
        assert tell(at, range_m) == expected
        np.testing.assert_array_equal(node.cells, trace.grid.occupancy())
        assert set(np.unique(node.cells)) == {-1, 0, 100}
        assert (node.info.origin.position.x, node.info.origin.position.y) == trace.grid.origin
    node.is_lost = True
    tell(Pose(29.1, -37.0, 0.2), 3.5)
    node.is_lost = False
    writer.serve()
    assert node.sent == [MAP.name]
    np.testing.assert_array_equal(node.cells, trace.grid.occupancy())


def test_a_map_that_is_too_large_for_a_message_is_not_sent():
    trace = a_trace()
    look(trace, Pose(0.4, -0.3, 0.7), 3.0)
    assert part_since(None, STAMP, trace.grid, trace.config.grid.cell_m) is not None
    look(trace, Pose(1500.0, 1400.0, 0.7), 3.0)
    assert part_since(None, STAMP, trace.grid, trace.config.grid.cell_m) is None


def test_the_process_of_the_map_draws_what_the_run_would_draw_also_when_poses_move_and_a_map_begins_anew():
    node, config, rng = Network(), preset(grid={"cell_m": 0.15}).grid, np.random.default_rng(4)
    node.readers.update({MAP.name: 1, UPDATES.name: 1})
    writer = MapWriter(node)
    for origin, earlier in ((Pose(0.4, -0.3, 0.7), None), (Pose(-7.3, 4.1, 2.0), Grid(config, 0.2))):
        if earlier is not None:
            see = np.linspace(2.0, 4.0, 200, dtype=np.float32)
            earlier.add(Pose(1.3, 5.2, 0.3), Scan(see, np.float32(-2.9), np.float32(0.029), 9.0), NO_WALLS)
        evidence = None if earlier is None else earlier.submap()
        own, sent, trajectory = Mapper(config, 0.2), 0, np.zeros((0, 3))
        if evidence is not None:
            own.start_from(evidence)
        draw = map_drawer(writer, pickle.loads(pickle.dumps(Beginning(config, 0.2, evidence))))
        for count in (1, 4, 13, 14, 31):
            for k in range(len(trajectory), count):
                ranges = rng.uniform(1.0, 5.0, 200).astype(np.float32)
                here = origin @ Pose(0.21 * k, 0.03 * k, 0.17 * k)
                trajectory = np.vstack([trajectory + 0.004 * rng.standard_normal((k, 3)), here.array()])
                walls = np.array([[[1.1, 2.2], [3.1, 2.4]]])
                own.add(k, trajectory.copy, Scan(ranges, np.float32(-2.9), np.float32(0.029), 9.0), walls)
            news = News(STAMP, None, own.additions(sent))
            sent = count
            grid = draw(pickle.loads(pickle.dumps(news)))
            np.testing.assert_array_equal(grid.occupancy(), own.draw().occupancy())
            np.testing.assert_array_equal(node.cells, grid.occupancy())
            assert (node.info.origin.position.x, node.info.origin.position.y) == grid.origin
