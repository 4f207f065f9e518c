"""What a live run has to say of its messages: each kind of fault once, events as they come, numbers at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

_MOST_KINDS = 50
_AGAIN_NS = 10_000_000_000  # from one line of an event to the next of its kind


class Notices:
    """Counts what was dropped, and says it when it happens for the first time."""

    def __init__(self, say: Callable[[str], object]) -> None:
        """`say` prints a line."""
        self._say = say
        self.dropped: Counter[str] = Counter()
        """number of messages by what was wrong with them"""
        self.events: Counter[str] = Counter()
        """number of events by kind"""
        self._said: set[str] = set()
        self._said_ns: dict[str, int] = {}

    def event(self, kind: str, text: str, now_ns: int) -> None:
        """Count an event, and say it unless another of its kind has been said within ten seconds."""
        self.events[kind] += 1
        if now_ns - self._said_ns.get(kind, -_AGAIN_NS) >= _AGAIN_NS:
            self._said_ns[kind] = now_ns
            self._say(text)

    def unusable(self, topic: str, error: ValueError) -> None:
        """Count a message of a topic that cannot be used; one line for each that is not allowed for another reason."""
        self.dropped[f"{topic} unusable"] += 1
        text = str(error)
        kind = text.partition("allowed:")[2] or text
        if kind not in self._said and len(self._said) < _MOST_KINDS:
            self._said.add(kind)
            self._say(f"{topic}: {text}; dropped")

    def take(self, dropped: Mapping[str, int]) -> None:
        """Take in the present numbers of another counter."""
        for kind, count in dropped.items():
            if kind not in self.dropped:
                self._say(f"dropped: {kind}")
            self.dropped[kind] = count

    def summary(self) -> list[str]:
        """The numbers of what was dropped and of what happened, a line each if there was any."""
        both = (("dropped", self.dropped), ("events", self.events))
        return [f"{name}: {', '.join(f'{k} {n}' for k, n in sorted(c.items()))}" for name, c in both if c]
