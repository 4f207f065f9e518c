"""The robot's clock, by stamps and times of arrival alone."""

import pytest

from sixthsense.live.robot_clock import CONFIRMED, RobotClock

S = 1_000_000_000
BEGAN = 1_700_000_000 * S


def running(seconds: float = 1.0, period_s: float = 0.02) -> tuple[RobotClock, int, int]:
    """A clock with messages at a steady rate; the last stamp and its arrival."""
    clock, stamp, arrival = RobotClock(), BEGAN, 5 * S
    for _ in range(round(seconds / period_s)):
        stamp, arrival = stamp + round(period_s * S), arrival + round(period_s * S)
        assert clock.accepts(stamp, arrival)
    return clock, stamp, arrival


@pytest.mark.parametrize("by_s", [-3600.0, -2.0, 2.0, 3600.0, 1e8])
def test_time_goes_on_when_the_clock_jumps(by_s):
    clock, stamp, arrival = running()
    before = clock.time(stamp)
    accepted = []
    for k in range(1, 6):
        accepted.append(clock.accepts(stamp + round((by_s + 0.02 * k) * S), arrival + round(0.02 * k * S)))
    assert accepted == [False] * (CONFIRMED - 1) + [True] * (6 - CONFIRMED)
    assert clock.jumps == 1
    assert clock.time(stamp + round((by_s + 0.1) * S)) == before + round(0.1 * S)
    assert clock.stamp(before + round(0.1 * S)) == stamp + round((by_s + 0.1) * S)


def test_single_stamps_of_another_time_are_no_jump():
    clock, stamp, arrival = running()
    for k in range(1, 20):
        now = round(0.02 * k * S)
        assert clock.accepts(stamp + now, arrival + now)
        assert not clock.accepts(stamp + now + (-1) ** k * k * 10 * S, arrival + now)
    assert clock.jumps == 0


def test_a_robot_that_is_silent_for_a_minute_has_no_jump():
    clock, stamp, arrival = running()
    assert clock.accepts(stamp + 60 * S, arrival + 60 * S)
    assert clock.jumps == 0


def test_messages_that_arrive_at_once_after_a_pause_are_no_jump():
    clock, stamp, arrival = running()
    for k in range(1, 51):
        assert clock.accepts(stamp + round(0.02 * k * S), arrival + 5 * S + k)
    assert clock.jumps == 0
