"""What is odd in the first scans and odometry of a robot is said after 10 and 30 s, once, and nothing is changed."""

import threading

from driven import mirrored, ticks

from sixthsense.live.first_look import LOOKS_NS, first_look


def said_by(own, seconds):
    """The lines after the first seconds."""
    lines = []
    hook = first_look(lines.append)
    for tick in own:
        if tick.stamp_ns - own[0].stamp_ns <= 1e9 * seconds:
            hook(tick, None)
    for thread in threading.enumerate():
        if thread.name == "first look":
            thread.join()
    return lines


def test_a_laser_from_right_to_left_is_said_once_and_one_that_is_right_never():
    last_s = 1e-9 * LOOKS_NS[1] + 1.0
    assert said_by(mirrored(), 9.0) == [] == said_by(ticks(), last_s)
    early, late = (said_by(mirrored(), seconds) for seconds in (11.0, last_s))
    assert len(late) == 1 and "scans turn the other way round" in late[0] and early in ([], late)
