"""Commands to the robot, and what stops it if they stay away; the rest is in test_round_trips.py."""

import time

import pytest
from processes import wait_until

import sixthsense as ss
from sixthsense.core.source import Command
from sixthsense.live.publishing import Commands, Stamped, pose_covariance
from sixthsense.live.reading import TWIST_STAMPED, MessageReader
from sixthsense.logs.ros_messages import stamp_ns
from sixthsense.record.trace import Trace


def test_before_the_first_keyframe_nothing_is_known():
    assert not pose_covariance(Trace(ss.preset(), None, 0.2)).any()


class Clock:
    """Stands in for the module `time`."""

    now = 7.0

    def monotonic(self) -> float:
        return self.now

    def sleep(self, _: float) -> None:
        pass


@pytest.mark.parametrize("command", [Command(0.37, 0.0), Command(0.0, -0.62), Command(-0.37, 0.62)])
def test_a_loop_that_stalls_stops_a_moving_robot_once_and_the_end_does(command, monkeypatch):
    clock, sent = Clock(), []
    monkeypatch.setattr("sixthsense.live.publishing.time", clock)
    with Commands(lambda data: sent.append(MessageReader().command(data))) as commands:
        commands.send(command)
        clock.now += 0.29
        time.sleep(0.15)  # the thread has looked meanwhile
        assert sent == [command] and commands.stalls == 0
        clock.now += 0.02
        wait_until(lambda: len(sent) == 2)
        clock.now += 9.0
        time.sleep(0.15)
        assert sent == [command, Command()] and commands.stalls == 1
        commands.send(command)
    assert sent[2:] == [command, Command(), Command(), Command()]


def test_a_stamped_command_has_the_time_of_the_robots_clock_and_its_frame():
    sent = []
    Commands(sent.append, Stamped(lambda: 1_700_000_000_123_456_789, "chassis")).send(Command(0.37, -0.62))
    message = MessageReader().read(sent[0], TWIST_STAMPED)
    assert (stamp_ns(message), message.header.frame_id) == (1_700_000_000_123_456_789, "chassis")
    assert MessageReader().command(sent[0], TWIST_STAMPED) == Command(0.37, -0.62)
