"""What is visible, how tours are shortened and how a path is followed, against plain references and by hand."""

import itertools
import math

import numpy as np
import pytest

from sixthsense.navigation.guard import GuardLimits, Returns, checked, stopping_distance
from sixthsense.navigation.path_driver import (
    STEERED,
    STUCK,
    TURNED,
    DriverLimits,
    Following,
    FollowLimits,
    GoalDrive,
    advanced,
    followed,
    is_there,
)
from sixthsense.navigation.tour import TileWays, shorten, tour_length
from sixthsense.navigation.visibility import expected_gain, line_of_sight, visible_cells


def crossed(row, col, angle, reach):
    """Cells that a ray from a cell's centre crosses, by dense samples, none twice, without the cell itself."""
    steps = np.arange(0.0, reach, 0.001)
    cells = np.floor(np.column_stack([row + 0.5 + steps * math.sin(angle), col + 0.5 + steps * math.cos(angle)]))
    return [tuple(map(int, cell)) for cell in dict.fromkeys(map(tuple, cells))][1:]


@pytest.mark.parametrize("seed", range(4))
def test_a_line_of_sight_crosses_no_obstacle(seed):
    rng = np.random.default_rng(seed)
    obstacles = rng.random((19, 26)) < 0.15
    visible = visible_cells(obstacles, np.ones_like(obstacles), 8, 11, 9.5)
    for r, c in np.ndindex(*obstacles.shape):
        down, across = r - 8, c - 11
        if math.hypot(down, across) > 9.5:
            assert not visible[r, c]
            continue
        scale = math.gcd(down, across) or 1
        assert line_of_sight(obstacles, 8, 11, r, c) == line_of_sight(obstacles, r, c, 8, 11)
        if down // scale % 2 and across // scale % 2:
            continue  # it meets corners
        between = crossed(8, 11, math.atan2(down, across), math.hypot(down, across))
        free = not any(obstacles[cell] for cell in between if cell != (r, c))
        assert line_of_sight(obstacles, 8, 11, r, c) == visible[r, c] == free


@pytest.mark.parametrize("reach, depth", [(6.3, 3), (14.0, 5)])
def test_the_gain_of_a_view_is_what_its_rays_cross(reach, depth):
    rng = np.random.default_rng(4)
    obstacles, unseen = rng.random((17, 23)) < 0.06, rng.random((17, 23)) < 0.5
    for row, col in ((7, 9), (2, 20)):
        found = set()
        for i in range(37):
            left = depth
            for r, c in crossed(row, col, 2.0 * math.pi * i / 37, reach):
                if not (0 <= r < 17 and 0 <= c < 23) or obstacles[r, c] or left == 0:
                    break
                if unseen[r, c]:
                    left -= 1
                    found.add((r, c))
        assert expected_gain(obstacles, unseen, row, col, 37, reach, depth) == len(found)


@pytest.mark.parametrize("seed", range(8))
def test_no_reversed_or_moved_part_makes_a_shortened_tour_shorter(seed):
    points = np.random.default_rng(seed).uniform(0.0, 30.0, (9, 2))
    lengths = np.hypot(*(points[:, None] - points).transpose(2, 0, 1))
    tour = np.array([0, *np.random.default_rng(seed + 50).permutation(7) + 1, 8])
    shorten(lengths, tour)
    assert tour[0] == 0 and tour[-1] == 8 and sorted(tour) == list(range(9))
    length = tour_length(lengths, tour)
    assert length == pytest.approx(sum(math.dist(points[a], points[b]) for a, b in itertools.pairwise(tour)))
    for i in range(1, 8):
        for j in range(i + 1, 9):
            part, rest = tour[i:j], np.concatenate([tour[:i], tour[j:]])
            others = [np.concatenate([tour[:i], part[::-1], tour[j:]])]
            if j - i <= 3:
                places = range(1, len(rest))
                others += [np.concatenate([rest[:k], p, rest[k:]]) for k in places for p in (part, part[::-1])]
            assert min(tour_length(lengths, other) for other in others) > length - 2e-6


def test_ways_over_tiles_are_kept_up_to_date_as_if_drawn_anew():
    rng = np.random.default_rng(3)
    free = rng.random((64, 88)) < 0.75
    ways = TileWays(6)
    ways.update(free)
    for _ in range(12):
        free = free.copy()
        top, left = int(rng.integers(56)), int(rng.integers(80))
        before, part = free.copy(), (slice(top, top + 9), slice(left, left + 9))
        free[part] = rng.random(free[part].shape) < rng.choice([0.1, 0.9])
        ways.update(free, (free != before).reshape(8, 8, 11, 8).any(axis=(1, 3)))
        anew = TileWays(6)
        anew.update(free)
        cells = np.argwhere(free)[rng.integers(np.count_nonzero(free), size=8)]
        assert np.array_equal(ways.matrix(cells), anew.matrix(cells))


LIMITS = FollowLimits(distance_slack_m=0.06, heading_slack_rad=0.05, speed=0.4, turn_rate=0.9, period_s=0.1)
POSE = (1.2, -0.7, 2.4)


def ahead(distance, error):
    """A path of one way point at a distance and an angle to the left of where the robot looks."""
    angle = POSE[2] + error
    point = (POSE[0] + distance * math.cos(angle), POSE[1] + distance * math.sin(angle))
    return Following(np.array([POSE[:2], point]), 1, False)


@pytest.mark.parametrize(
    "distance, error, is_driving, expected",
    [
        (2.0, 1.3, False, (0.0, 0.9, 1, False)),  # turns on the spot, as fast as it may
        (2.0, -0.07, False, (0.0, -0.7, 1, False)),  # and no further than it must
        (2.0, 0.04, False, (0.4, 2.0 * 0.04 * 0.4 / 2.0, 1, True)),
        (2.0, 0.2, True, (0.4, 2.0 * 0.2 * 0.4 / 2.0, 1, True)),  # four slacks: it corrects while it drives
        (2.0, 0.3, True, (0.0, 0.9, 1, False)),
        (0.1, 0.04, True, (0.4, 2.0 * 0.04 * 0.4 / 0.25, 1, True)),
        (0.07, -0.04, True, (0.4, -0.128, 1, True)),
        (0.05, 0.04, True, (0.0, 0.0, 2, False)),
    ],
)
def test_a_path_is_followed_by_turns_on_the_spot_and_lines(distance, error, is_driving, expected):
    following = ahead(distance, error)._replace(is_driving=is_driving)
    assert followed(POSE, following, LIMITS) == pytest.approx(expected, abs=1e-9)
    slow = LIMITS._replace(period_s=0.4)  # one tick would lead beyond the way point
    if expected[0] > 0.0:
        assert followed(POSE, following, slow)[0] == pytest.approx(min(0.4, distance / 0.4))


def test_a_drive_is_stuck_after_its_patience_and_a_turn_ends_when_it_is_complete():
    limits = DriverLimits(goal_slack_m=0.2, patience_ns=2e9, turn_rate=0.9, follow=LIMITS)
    path = ahead(2.0, 0.0)
    goal = tuple(path.path[1].tolist())
    drive = GoalDrive(goal, True, path)
    drive, speed, _, event = advanced(drive, POSE, 5, limits)
    assert speed == 0.4 and event == STEERED and drive.anchor == (5, *POSE[:2])
    near = (POSE[0] + 0.07, POSE[1] - 0.06, POSE[2])
    assert advanced(drive, near, 2_000_000_005, limits)[3] == STEERED
    assert advanced(drive, near, 2_000_000_006, limits)[3] == STUCK
    moved = (POSE[0] + 0.08, POSE[1] - 0.07, POSE[2])
    after, _, _, event = advanced(drive, moved, 2_000_000_006, limits)
    assert event == STEERED and after.anchor == (2_000_000_006, *moved[:2])
    assert is_there(drive, (goal[0] + 0.1, goal[1] - 0.15, 0.3), limits)
    assert not is_there(drive, (goal[0] + 0.1, goal[1] - 0.18, 0.3), limits)
    turning = GoalDrive((9.0, 9.0), is_turning=True, heading=3.0, left_rad=0.6)
    turning, speed, turn_rate, event = advanced(turning, (*POSE[:2], -3.0), 5, limits)
    assert (speed, turn_rate, event) == (0.0, 0.9, STEERED)
    assert turning.left_rad == pytest.approx(0.6 - (2.0 * math.pi - 6.0)) and turning.heading == -3.0
    turning, _, turn_rate, event = advanced(turning, (*POSE[:2], -2.6), 6, limits)
    assert turn_rate == 0.0 and event == TURNED and not turning.is_turning


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_guard_slows_to_what_stops_before_the_first_contact_and_stops_below_creep_speed(sign):
    limits = GuardLimits(True, 0.25, 0.4, 0.3, 1.5, 0.08)
    assert stopping_distance(0.5, 0.3, 1.5) == pytest.approx(0.15 + 0.25 / 3.0)
    since, nothing = (0.4, -0.3, 1.9), np.zeros((0, 2))

    def command_at(gap, moving=False):
        """The command 0.7 m/s straight on with a return at a gap before the disc."""
        reach = sign * (gap + (0.4 if moving else 0.25))
        point = np.array([[since[0] + reach * math.cos(1.9), since[1] + reach * math.sin(1.9)]])
        returns = Returns(nothing, point) if moving else Returns(point, nothing)
        return checked((sign * 0.7, 0.0), since, returns, True, limits)

    for gap in (0.12, 0.27):
        for moving in (False, True):
            speed, turn_rate, stopped, waits = command_at(gap, moving)
            assert stopping_distance(abs(speed), 0.3, 1.5) == pytest.approx(gap) and speed * sign > 0.0
            assert turn_rate == 0.0 and not stopped and waits == moving
    assert command_at(0.02)[:3] == (0.0, 0.0, True)
    assert command_at(0.5)[:3] == (sign * 0.7, 0.0, False)
    assert checked((0.0, 0.6), since, Returns(np.array([since[:2]]), nothing), True, limits) == (0.0, 0.6, False, True)
