"""What a live run says of its own map: `/diagnostics`, once a second, and how fast the robot may drive by it."""

from __future__ import annotations

from collections.abc import Callable

from sixthsense.core.source import Tick
from sixthsense.live.topics import RELIABLE, Topic
from sixthsense.loop.run import OnTick
from sixthsense.navigation.pilot import Pilot
from sixthsense.record.messages import DIAGNOSTICS, Messages
from sixthsense.record.trace import Trace
from sixthsense.verdict.judge import judge
from sixthsense.verdict.verdict import Level

TOPIC = Topic("/diagnostics", DIAGNOSTICS, RELIABLE)
NAME, HARDWARE = "sixthsense: map", "sixthsense"
LEVELS: dict[Level, int] = {"good": 0, "unjudged": 0, "doubtful": 1, "broken": 2}
"""OK, WARN and ERROR of diagnostic_msgs/DiagnosticStatus"""
PACES: dict[Level, float] = {"good": 1.0, "unjudged": 1.0, "doubtful": 0.5, "broken": 0.0}
"""share of its speed that a robot drives at by itself; at 0 it turns in place, to find its place"""
KEYFRAMES = 200
"""that are judged while a run goes on: the last 50 m, in some 20 ms"""

_PERIOD_NS = 1_000_000_000


def diagnostics(send: Callable[[bytes], object], pilot: Pilot) -> OnTick:
    """A hook that judges the map so far once a second, says so, and slows the pilot down.

    `send` takes serialized messages.
    """
    messages, next_ns, judged = Messages(), -1, 0  # keyframes of the newest verdict

    def hook(tick: Tick, trace: Trace) -> None:
        nonlocal next_ns, judged
        if trace.live is None or tick.stamp_ns < next_ns:
            return
        next_ns, count = tick.stamp_ns + _PERIOD_NS, len(trace.key_stamps_ns)
        if trace.live.verdict is None or count != judged:
            judged, trace.live.verdict = count, judge(trace.witnesses(KEYFRAMES))
        verdict = trace.live.verdict
        pilot.pace = PACES[verdict.level]
        values = {"cause": verdict.cause}
        if verdict.probability is not None:
            values["probability that the map is wrong"] = f"{verdict.probability:.3g}"
        values |= {name: f"{value:.4g}" for name, value in verdict.evidence.items()}
        status = messages.status(LEVELS[verdict.level], NAME, f"map {verdict}", HARDWARE, values)
        send(messages.serialized(messages.diagnostics(tick.stamp_ns, [status]), DIAGNOSTICS))

    return hook
