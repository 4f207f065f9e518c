"""All control ticks from one scan to the next in one call: the loop without what a scan brings.

Rooms hand in their kernels, and none knows of another: the world moves the robot, the odometry is summed up, the
navigator steers, the guard checks. The same kernels serve a single tick in Python, the reference, to the bit. A tick in
which something is decided ends the call: there the loop asks the navigator, as at each scan.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, Protocol, runtime_checkable

import numba
import numpy as np
from numpy.typing import NDArray

from sixthsense.core.geometry import Array
from sixthsense.core.odometry_kernels import Folded, OdometryNoise, folded
from sixthsense.core.se2 import composed
from sixthsense.core.source import Command, ControlTicks, Tick
from sixthsense.navigation.pilot import Pilot, PilotLimits, Steering, commanded
from sixthsense.record.trace import Stopwatch, Trace
from sixthsense.slam.slam import Slam, Step
from sixthsense.sources.world import Drive, Driving, World, driven_tick


class State(NamedTuple):
    """What control ticks change, a field per room."""

    driving: Driving
    odometry: Folded
    steering: Steering


class Fixed(NamedTuple):
    """What they do not change."""

    drive: Drive
    noise: OdometryNoise
    pilot: PilotLimits


class Rows(NamedTuple):
    """What each tick fills, as `ControlTicks` says."""

    odometry: Array
    truths: Array
    motions: Array
    covs: Array
    are_still: NDArray[np.bool_]

    @staticmethod
    def of(count: int) -> Rows:
        """Rows of `count` ticks, not filled."""
        poses = np.empty((3, count, 3))
        return Rows(poses[0], poses[1], poses[2], np.empty((count, 3, 3)), np.empty(count, dtype=np.bool_))

    def ticks(self, stamps_ns: NDArray[np.int64]) -> ControlTicks:
        """The rows that have been filled, with the stamps of their ticks."""
        n = len(stamps_ns)
        return ControlTicks(
            stamps_ns, self.odometry[:n], self.truths[:n], self.motions[:n], self.covs[:n], self.are_still[:n]
        )


@numba.njit(cache=True, error_model="numpy")
def run_ticks(
    state: State, fixed: Fixed, command: tuple[float, float], stamp_ns: int, rows: Rows
) -> tuple[State, tuple[float, float], int, bool, bool]:
    """Run a tick per row after one at a stamp, which has ended with a `command` of speed and turn rate.

    Returns the state, the next command, how many ticks have passed, whether something has to be decided in the last of
    them, which has no command then, and whether the robot touched a wall in it.
    """
    driving, odometry, steering = state
    truth, by_wheels, count = driving.truth, driving.odometry, len(rows.odometry)
    for k in range(count):
        stamp_ns += fixed.drive.period_ns
        truth, by_wheels, has_touched = driven_tick(
            truth, by_wheels, command, driving.draws[k], fixed.drive, driving.solid
        )
        rows.are_still[k] = by_wheels == odometry.odometry
        odometry, motion, cov = folded(odometry, by_wheels, fixed.noise)
        for i in range(3):
            rows.truths[k, i], rows.odometry[k, i], rows.motions[k, i] = truth[i], by_wheels[i], motion[i]
            for j in range(3):
                rows.covs[k, i, j] = cov[i, j]
        since_scan = composed(steering.since_scan, motion)
        steering = Steering(steering.drive, since_scan, steering.returns, steering.waits_for_moving)
        is_all = not has_touched
        if is_all:
            steering, speed, turn_rate, is_all = commanded(steering, odometry.pose, stamp_ns, fixed.pilot)
        if not is_all:
            at_end = State(Driving(truth, by_wheels, driving.draws, driving.solid), odometry, steering)
            return at_end, command, k + 1, True, has_touched
        command = (speed, turn_rate)
    at_end = State(Driving(truth, by_wheels, driving.draws, driving.solid), odometry, steering)
    return at_end, command, count, False, False


@runtime_checkable
class TicksHook(Protocol):
    """A hook of the loop that takes ticks without a scan as arrays."""

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Take in a tick."""
        ...

    def passed(self, ticks: ControlTicks, trace: Trace) -> None:
        """Take in the ticks between two scans, which are all in the trace."""
        ...


class Deadline:
    """A watcher that ends a run when `max_time_s` of source time has passed."""

    def __init__(self, max_time_s: float, outcome: str) -> None:
        self._max_ns, self._outcome = round(max_time_s * 1e9), outcome
        self._first_ns: int | None = None

    def __call__(self, tick: Tick, step: Step, command: Command) -> str | None:
        """The outcome, if the time has passed."""
        if self._first_ns is None:
            self._first_ns = tick.stamp_ns
        return self._outcome if tick.stamp_ns >= self._first_ns + self._max_ns else None

    def ticks_before(self, stamp_ns: int, period_ns: int) -> int:
        """How many ticks after one at a stamp come before the end."""
        assert self._first_ns is not None
        return max((self._first_ns + self._max_ns - 1 - stamp_ns) // period_ns, 0)


class BetweenScans:
    """Runs the control ticks of a simulated robot from one scan to the next."""

    def __init__(
        self, world: World, slam: Slam, pilot: Pilot, see: Callable[[ControlTicks, Array], object], clock: Stopwatch,
        deadline: Deadline | None,
    ) -> None:  # fmt: skip
        """`see` is called with ticks that have passed, and (3, 3) of the motion since the last keyframe then."""
        self._world, self._slam, self._pilot, self._deadline = world, slam, pilot, deadline
        self._noise = OdometryNoise.of(slam.config.assumed)
        self._see, self._timed_run = see, clock.timed("ticks", self._run)

    def __call__(self, stamp_ns: int, command: Command) -> tuple[Command, str | None]:
        """Run the ticks that follow one at a stamp, which has ended with a command.

        The command after them, and the outcome of the run if it is over. Ticks in which something has to be decided
        end a call of the kernel, not this one. Where a room needs ticks one by one, none is run.
        """
        while (found := self._timed_run(stamp_ns, command)) is not None:
            command, ticks, since_cov, has_touched = found
            stamp_ns = int(ticks.stamps_ns[-1])
            self._see(ticks, since_cov)
            outcome = "collided" if has_touched else self._pilot.navigator.outcome
            if outcome is not None:
                return command, outcome
        return command, None

    def _run(self, stamp_ns: int, command: Command) -> tuple[Command, ControlTicks, Array, bool] | None:
        """Run ticks until the next scan or decision, and decide; None if there are none."""
        begun = self._begin(stamp_ns)
        if begun is None:
            return None
        state, fixed, rows = begun
        given = float(command.speed), float(command.turn_rate)
        state, (speed, turn_rate), count, must_decide, has_touched = run_ticks(state, fixed, given, stamp_ns, rows)
        period_ns = fixed.drive.period_ns
        stamps_ns = np.arange(stamp_ns + period_ns, stamp_ns + (count + 1) * period_ns, period_ns)
        ticks = rows.ticks(stamps_ns)
        self._world.moved(ticks, has_touched)
        self._slam.passed(state.odometry, ticks)
        self._pilot.passed(state.steering, count - must_decide)
        command = Command(speed, turn_rate)
        if must_decide:
            command = self._pilot.command(self._slam.pose, int(stamps_ns[-1]))
        return command, ticks, state.odometry.cov, has_touched

    def _begin(self, stamp_ns: int) -> tuple[State, Fixed, Rows] | None:
        driving = self._world.between_scans()
        if driving is None:
            return None
        count, drive = len(driving.draws), self._world.drive
        if self._deadline is not None:
            count = min(count, self._deadline.ticks_before(stamp_ns, drive.period_ns))
        odometry, steering = self._slam.between_scans(), self._pilot.between_scans()
        if not count or odometry is None or steering is None:
            return None
        return State(driving, odometry, steering[0]), Fixed(drive, self._noise, steering[1]), Rows.of(count)
