"""What a live run says of its own map: `/diagnostics`, once a second, and how fast the robot may drive by it."""

from __future__ import annotations

from collections.abc import Callable

from sixthsense.core.source import Tick
from sixthsense.live.topics import RELIABLE, Topic
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.messages import DIAGNOSTICS, Messages
from sixthsense.record.trace import Trace
from sixthsense.verdict.judge import judge
from sixthsense.verdict.verdict import Level, Verdict

TOPIC = Topic("/diagnostics", DIAGNOSTICS, RELIABLE)
NAME, HARDWARE = "sixthsense: map", "sixthsense"
LEVELS: dict[Level, int] = {"good": 0, "doubtful": 1, "broken": 2}
"""OK, WARN and ERROR of diagnostic_msgs/DiagnosticStatus"""
PACES: dict[Level, float] = {"good": 1.0, "doubtful": 0.5, "broken": 0.0}
"""share of its speed that a robot drives at by itself; at 0 it turns in place, to find its place"""
KEYFRAMES = 200
"""that are judged while a run goes on: the last 50 m, in some 20 ms"""

_PERIOD_NS = 1_000_000_000


class Diagnostics:
    """A hook of the loop: judges the map so far once a second, says so, and slows the pilot down."""

    def __init__(self, send: Callable[[bytes], object], stamp: Callable[[int], int], pilot: Pilot) -> None:
        """`send` takes serialized messages, and `stamp` makes the robot's stamp of a tick's."""
        self._send, self._stamp, self._pilot = send, stamp, pilot
        self._messages = Messages()
        self._next_ns: int | None = None
        self._judged = 0
        """keyframes of the newest verdict"""
        self._verdict: Verdict | None = None

    def __call__(self, tick: Tick, trace: Trace) -> None:
        """Judge and send, if a second has passed."""
        if trace.live is None or (self._next_ns is not None and tick.stamp_ns < self._next_ns):
            return
        self._next_ns = tick.stamp_ns + _PERIOD_NS
        count = len(trace.key_stamps_ns)
        if self._verdict is None or count != self._judged:
            self._judged, self._verdict = count, judge(trace.witnesses(KEYFRAMES))
        trace.live.verdict = self._verdict
        self._pilot.pace = PACES[self._verdict.level]
        self._send(self._serialized(self._stamp(tick.stamp_ns), self._verdict))

    def _serialized(self, stamp_ns: int, verdict: Verdict) -> bytes:
        values = {"probability that the map is wrong": f"{verdict.probability:.3g}", "cause": verdict.cause}
        values |= {name: f"{value:.4g}" for name, value in verdict.evidence.items()}
        status = self._messages.status(LEVELS[verdict.level], NAME, f"map {verdict}", HARDWARE, values)
        return self._messages.serialized(self._messages.diagnostics(stamp_ns, [status]), DIAGNOSTICS)
