"""Robots that get nowhere."""

from sixthsense.navigation.stagnation import Stagnation


def blocked_ways_until_given_up(stagnation: Stagnation, seen_m2: float, growth_m2: float = 0.0, most: int = 50) -> int:
    for count in range(1, most + 1):
        if stagnation.blocks_for_good(seen_m2 + count * growth_m2):
            return count
    return most


def test_ways_that_are_blocked_in_turn_are_given_up_when_nothing_new_is_seen() -> None:
    stagnation = Stagnation()
    assert blocked_ways_until_given_up(stagnation, 20.0) == 7
    assert blocked_ways_until_given_up(stagnation, 20.0) == 7  # the next target has as many


def test_ways_may_be_blocked_while_something_new_is_seen() -> None:
    assert blocked_ways_until_given_up(Stagnation(), 20.0, growth_m2=0.1) == 50


def test_noise_at_the_edges_of_obstacles_is_nothing_new() -> None:
    assert blocked_ways_until_given_up(Stagnation(), 20.0, growth_m2=0.0025) < 20


def test_an_arrival_or_a_target_that_is_seen_begins_the_count_anew() -> None:
    for event in ("arrived", "target seen"):
        stagnation = Stagnation()
        for _ in range(6):
            assert not stagnation.blocks_for_good(20.0)
        assert stagnation.event(event) == event
        assert blocked_ways_until_given_up(stagnation, 20.0) == 7


def test_a_robot_that_was_stuck_is_stuck_again_until_it_arrives() -> None:
    stagnation = Stagnation()
    assert stagnation.event("stuck") == "stuck"
    assert stagnation.event("path blocked") == "path blocked"
    assert stagnation.event("stuck") == "stuck again"
    assert stagnation.event("arrived") == "arrived"
    assert stagnation.event("stuck") == "stuck"
