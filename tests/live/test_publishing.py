"""What a live run publishes: the covariance of its pose between keyframes, and commands."""

import time

import numpy as np
from processes import wait_until

import sixthsense as ss
from sixthsense.core.source import Command, Tick
from sixthsense.live.publishing import TIMEOUT_S, Commands, pose_covariance
from sixthsense.live.reading import MessageReader
from sixthsense.record.trace import Trace


def test_the_covariance_is_that_of_the_keyframe_and_grows_until_the_next():
    seen: list[tuple[bool, np.ndarray, np.ndarray]] = []

    def look(tick: Tick, trace: Trace) -> None:
        if tick.scan is not None and trace.key_estimates:
            is_key = trace.key_stamps_ns[-1] == tick.stamp_ns
            seen.append((is_key, pose_covariance(trace), trace.key_estimates[-1].pose_cov))

    ss.run("rectangle", task="tour", max_time=10.0, on_tick=look, progress=False)
    assert any(is_key for is_key, _, _ in seen) and not all(is_key for is_key, _, _ in seen)
    for is_key, cov, key_cov in seen:
        if is_key:
            np.testing.assert_allclose(cov, key_cov, atol=1e-6)
        assert np.linalg.eigvalsh(cov).min() > -1e-12
        assert np.trace(cov) >= np.trace(key_cov) - 1e-9


def test_before_the_first_keyframe_nothing_is_known():
    assert not pose_covariance(Trace(ss.preset(), None, 0.2)).any()


class Sent:
    """Keeps what is sent, with the time."""

    def __init__(self) -> None:
        self.commands: list[tuple[float, float]] = []

    def send(self, data: bytes) -> None:
        self.commands.append((time.monotonic(), MessageReader().command(data).speed))


def test_a_loop_that_stalls_stops_the_robot_and_the_end_does():
    sent = Sent()
    with Commands(sent.send) as commands:
        commands.send(Command(0.5, 0.0))
        wait_until(lambda: len(sent.commands) == 2)
        assert sent.commands[1][1] == 0.0 and commands.stalls == 1
        assert sent.commands[1][0] - sent.commands[0][0] > TIMEOUT_S
        commands.send(Command(0.5, 0.0))
    assert [speed for _, speed in sent.commands[3:]] == [0.0, 0.0, 0.0]
