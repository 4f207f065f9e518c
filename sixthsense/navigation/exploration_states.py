"""The states of an exploration and its transitions, in one table.

An exploration selects a view, drives to its viewpoint, turns around there, and selects the next view. When no view is
left it returns home. Two detours are possible: a loop closure at a place where the pose was certain, and an approach of
the gap that closes the path home.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

State = Literal[
    "selecting", "to viewpoint", "at viewpoint", "waiting", "closing a loop", "approaching gap", "returning"
]
"""selecting: a view is chosen when the next map arrives; to viewpoint, at viewpoint: driving there, turning around
there; waiting: turning around until people may have gone; closing a loop: driving to a place where the pose was
certain; approaching gap: driving to a gap that cuts the robot off from home, to see it from nearer; returning: driving
home."""

Event = Literal[
    "target seen", "path blocked", "pose uncertain", "pose certain", "arrived", "turned around", "stuck", "stuck again"
]
"""target seen: little of the target is unknown now, or there is no target; path blocked: the path crosses an obstacle,
or there is no path; turned around: one turn on the spot is complete; stuck: no progress for a while; stuck again:
without an arrival since the last time. The first four come with a map, the others with a control tick."""

Action = Literal[
    "choose view",
    "replan",
    "replan or choose view",
    "turn around",
    "count failed view",
    "look again",
    "mark unreachable",
    "close loop",
    "drop target",
    "approach gap or retrace",
    "finish",
    "give up",
]


@dataclass(frozen=True, slots=True)
class Transition:
    """What a state does on an event."""

    action: Action
    to: tuple[State, ...]
    """the states it may lead to; the action decides"""


_AFTER_CHOICE: tuple[State, ...] = ("to viewpoint", "waiting", "returning")

_CHOOSE = Transition("choose view", _AFTER_CHOICE)
_COUNT_FAILED_VIEW = Transition("count failed view", _AFTER_CHOICE)  # then choose a view
_OTHER_WAY_HOME = Transition("approach gap or retrace", ("approaching gap", "returning"))
_MARK_UNREACHABLE = Transition("mark unreachable", _AFTER_CHOICE)  # then choose a view


def _give_up(state: State) -> Transition:
    return Transition("give up", (state,))


def _replan(state: State) -> Transition:
    return Transition("replan", (state,))


TRANSITIONS: Mapping[State, Mapping[Event, Transition]] = MappingProxyType(
    {
        "selecting": {
            "target seen": _CHOOSE,
            "pose uncertain": Transition("close loop", ("selecting", "closing a loop")),
        },
        "to viewpoint": {
            "target seen": _CHOOSE,
            "path blocked": Transition("replan or choose view", _AFTER_CHOICE),
            "pose uncertain": Transition("close loop", ("to viewpoint", "closing a loop")),
            "arrived": Transition("turn around", ("at viewpoint",)),
            "turned around": _MARK_UNREACHABLE,  # no path was found meanwhile
            "stuck": _MARK_UNREACHABLE,
            "stuck again": _give_up("to viewpoint"),
        },
        "at viewpoint": {
            "target seen": _CHOOSE,
            "pose uncertain": Transition("close loop", ("at viewpoint", "closing a loop")),
            "turned around": _COUNT_FAILED_VIEW,
            "stuck": _COUNT_FAILED_VIEW,
            "stuck again": _give_up("at viewpoint"),
        },
        "waiting": {"turned around": Transition("look again", _AFTER_CHOICE)},  # then choose a view
        "closing a loop": {
            "pose certain": Transition("drop target", ("selecting",)),
            "path blocked": _replan("closing a loop"),
            "arrived": _CHOOSE,
            "turned around": _CHOOSE,
            "stuck": _CHOOSE,
            "stuck again": _give_up("closing a loop"),
        },
        "approaching gap": {
            "path blocked": _replan("approaching gap"),
            "arrived": _CHOOSE,
            "turned around": _CHOOSE,
            "stuck": _CHOOSE,
            "stuck again": _give_up("approaching gap"),
        },
        "returning": {
            "path blocked": _replan("returning"),
            "arrived": Transition("finish", ("returning",)),
            "turned around": _OTHER_WAY_HOME,
            "stuck": _OTHER_WAY_HOME,
            "stuck again": _give_up("returning"),
        },
    }
)
"""What happens on each event in each state; an event that is not listed changes nothing."""
