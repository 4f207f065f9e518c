"""A live robot with two lasers that take turns on one topic under one frame."""

import math
import os
import threading
from importlib.util import find_spec

import numpy as np
import pytest

from sixthsense.config import preset
from sixthsense.config.errors import InputError
from sixthsense.core.laser import Scan
from sixthsense.live.network import Network
from sixthsense.live.session import Session, Topics
from sixthsense.live.simulated import SCAN
from sixthsense.live.topics import NetworkError
from sixthsense.record.messages import Messages
from sixthsense.sources.logs.ros_messages import LASER_SCAN

BEAMS = 180


def scan_of(seen_m: float) -> Scan:
    ranges = np.full(BEAMS, seen_m, np.float32)
    return Scan(ranges, np.float32(-math.pi), np.float32(2.0 * math.pi / BEAMS), 10.0)


@pytest.mark.skipif(find_spec("cyclonedds") is None, reason="needs Cyclone DDS: pip install 'sixthsense[ros2]'")
def test_two_lasers_in_turn_are_told_in_one_line():
    make, is_over = Messages(), threading.Event()
    with Session(
        Network(140 + os.getpid() % 40), Topics().checked(), preset("log", no_odometry=True), print
    ) as session:
        writer = session._node.writer(SCAN)

        def publish() -> None:
            k = 0
            while not is_over.wait(0.02):
                k += 1
                message = make.scan(10**18 + k * 20_000_000, scan_of(4.0 if k % 2 else 2.0))
                writer.send(make.serialized(message, LASER_SCAN))

        robot = threading.Thread(target=publish)
        robot.start()
        try:
            with pytest.raises(NetworkError, match=r"^/scan: found scans of two lasers in turn, all of frame .*$"):
                session.configure((), False)
        finally:
            is_over.set()
            robot.join()
    assert issubclass(NetworkError, InputError)  # exit code 2
