"""What a live run says of its own map once a second, and how fast the robot may drive by it."""

import dataclasses

import pytest
from driven import config, mirrored, ticks

from sixthsense.core.geometry import Pose
from sixthsense.core.source import Command
from sixthsense.live.diagnostics import LEVELS, diagnostics
from sixthsense.logs.log import Log
from sixthsense.logs.ros_messages import stamp_ns
from sixthsense.loop.run import replay
from sixthsense.navigation.guard import Guard
from sixthsense.navigation.navigator import Navigator
from sixthsense.navigation.pilot import TURN_RATE, Pilot
from sixthsense.record.messages import DIAGNOSTICS, Messages


class Forward(Navigator):
    def step(self, pose: Pose, stamp_ns: int) -> Command:
        return Command(0.4, -0.3)


def told(own):
    """The messages of a replay, its verdict at the end, and the paces after each message."""
    pilot, sent, paces = Pilot(Navigator(), Guard(config(), 0.2)), [], []

    def send(data: bytes) -> None:
        sent.append(Messages().store.deserialize_cdr(data, DIAGNOSTICS))
        paces.append(pilot.pace)

    hook = diagnostics(send, pilot)
    trace = replay(Log(own), config(), on_tick=hook)
    return sent, trace.verdict, paces


def test_a_good_map_is_ok_once_a_second_and_driven_by_at_full_speed():
    own = ticks()
    sent, verdict, paces = told(own)
    duration_s = 1e-9 * (own[-1].stamp_ns - own[0].stamp_ns)
    assert duration_s / 1.3 < len(sent) <= duration_s + 1
    assert {message.status[0].level for message in sent} == {0} and set(paces) == {1.0}
    assert verdict.level == "good" and sent[-1].status[0].message == "map good"
    assert stamp_ns(sent[0]) == own[0].stamp_ns and sent[0].status[0].name == "sixthsense: map"


def test_a_mirrored_laser_is_an_error_that_names_it_and_the_robot_turns_in_place():
    sent, verdict, paces = told(mirrored())
    last = sent[-1].status[0]
    assert verdict.level == "broken" and last.level == LEVELS["broken"] and paces[-1] == 0.0
    assert (
        "is the laser mirrored?" in last.message
        and {pair.key: pair.value for pair in last.values}["cause"] == "mirrored"
    )


@pytest.mark.parametrize(("pace", "command"), [
    (1.0, Command(0.4, -0.3)), (0.5, Command(0.2, -0.15)), (0.0, Command(0.0, TURN_RATE)),
])  # fmt: skip
def test_a_pilot_drives_at_its_pace_within_the_guard(pace, command):
    guard = Guard(config(), 0.2)
    pilot = Pilot(Forward(), guard)
    pilot.pace = pace
    scan = ticks()[0].scan
    guard.see(dataclasses.replace(scan, ranges=scan.ranges * 0.0 + 9.0))
    assert pilot.command(Pose(0.3, -0.2, 0.7), 5) == command
