"""The interface of path planners: the contract that all of them satisfy, and the plan they return."""

from __future__ import annotations

import itertools
import math
import time
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import numpy as np
from numpy.typing import ArrayLike

from sixthsense.core.geometry import Array
from sixthsense.slam.mapping.freespace import FreeSpace

Status = Literal["found", "start blocked", "goal blocked", "no path", "gave up"]


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """The outcome of one search, with or without a path."""

    status: Status
    """"found", or why there is no path"""
    path_world: Array
    """(N, 2) metres, read-only: start, way points, goal, N at least 2; (0, 2) unless found"""
    cost: float
    """integral of the space's cost along the path, metres; inf unless found"""
    expanded: int
    """nodes expanded by this search (A*), or iterations (sampling planners)"""
    seconds: float
    """wall-clock time it took"""

    @property
    def found(self) -> bool:
        """Whether there is a path."""
        return self.status == "found"

    @property
    def length_m(self) -> float:
        """Length of the path, metres; inf unless found."""
        return float(np.linalg.norm(np.diff(self.path_world, axis=0), axis=1).sum()) if self.found else math.inf

    @classmethod
    def along(cls, space: FreeSpace, path_world: ArrayLike, expanded: int, seconds: float) -> Plan:
        """The plan of a path through a space: (N, 2) way points in metres."""
        path = np.array(path_world, dtype=np.float64)
        path.flags.writeable = False
        return cls("found", path, space.path_cost(path), expanded, seconds)

    @classmethod
    def without_path(cls, status: Status, expanded: int, seconds: float) -> Plan:
        """The plan without a path, and why there is none."""
        path = np.empty((0, 2))
        path.flags.writeable = False
        return cls(status, path, math.inf, expanded, seconds)


def joined_path(start: Array, between: Array, goal: Array) -> Array:
    """(N, 2) start, the way points (K, 2) between, and goal, without consecutive duplicates."""
    path = np.concatenate([start[None], between, goal[None]])
    if len(path) == 2:
        return path
    repeated = (np.diff(path, axis=0) == 0.0).all(axis=1)
    return np.asarray(path[np.concatenate([[True], ~repeated])])


def plan_with_blocked_end(space: FreeSpace, start: Array, goal: Array, began: float) -> Plan | None:
    """The plan without a path if start or goal (2,) is blocked, else None; `began` is of `time.perf_counter`."""
    for name, point in (("start", start), ("goal", goal)):
        if space.is_blocked(point):
            status: Status = "start blocked" if name == "start" else "goal blocked"
            return Plan.without_path(status, 0, time.perf_counter() - began)
    return None


class Planner(Protocol):
    """Finds a path of the robot's centre from start to goal that touches no blocked cell.

    Contract, tested for every planner:

    1. `path_world` begins exactly at `start` and ends exactly at `goal`; it is read-only and has at least two rows.
    2. No segment of it touches a blocked cell, not even at a corner.
    3. `cost` is the integral of the space's cost along `path_world`: its length in metres where all cells cost 1.
    4. Unknown cells are free and cost 1: start and goal may lie outside `space`, which is then extended to cover them.
       The path stays within it.
    5. Without a path, `status` says why, the path is (0, 2) and the cost inf: "start blocked" takes
       precedence over "goal blocked"; "no path": there is none; "gave up": none was found within the planner's budget.
    6. The same questions in the same order, with the same seed, give the same paths. The same question asked again
       gives the same path.
    7. A start or goal that does not have shape (2,), or is not finite, raises ValueError.
    """

    def plan(self, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> Plan:
        """Plan from `start` to `goal`, (2,) points in the world, metres."""
        ...


def plan_fault(plan: object, space: FreeSpace, start: ArrayLike, goal: ArrayLike) -> str:
    """What is wrong with the plan of a planner from `start` to `goal`, (2,) each; "" if nothing."""
    if not isinstance(plan, Plan):
        return f"found a {type(plan).__name__}, allowed: a Plan"
    if plan.status not in get_args(Status):
        return f"found status {plan.status!r}, allowed: {', '.join(get_args(Status))}"
    path = np.asarray(plan.path_world)
    if not plan.found:
        return "" if path.shape == (0, 2) else f"found a path {path.shape} with status {plan.status!r}, allowed: (0, 2)"
    if path.ndim != 2 or path.shape[1] != 2 or len(path) < 2 or not np.isfinite(path).all():
        return f"found a path {path.shape}, allowed: finite numbers, (N, 2), N at least 2"
    for name, found, end in (("begins", path[0], start), ("ends", path[-1], goal)):
        if not np.array_equal(found, end):
            allowed = np.asarray(end, dtype=np.float64).tolist()
            return f"found a path that {name} at {found.tolist()}, allowed: {allowed}"
    for a, b in itertools.pairwise(path):
        if not space.line_is_free(a, b):
            ends = " and ".join(str(np.round(end, 3).tolist()) for end in (a, b))
            return f"found a path that touches a blocked cell between {ends}"
    return ""
