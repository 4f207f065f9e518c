"""What a live run has to say of its messages: each kind of fault once, and their numbers at the end."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping

_MOST_KINDS = 50


class Notices:
    """Counts what was dropped, and says it when it happens for the first time."""

    def __init__(self, say: Callable[[str], object]) -> None:
        """`say` prints a line."""
        self.say = say
        self.dropped: Counter[str] = Counter()
        """number of messages by what was wrong with them"""
        self._said: set[str] = set()

    def unusable(self, topic: str, error: ValueError) -> None:
        """Count a message of a topic that cannot be used; one line for each that is not allowed for another reason."""
        self.dropped[f"{topic} unusable"] += 1
        text = str(error)
        kind = text.partition("allowed:")[2] or text
        if kind not in self._said and len(self._said) < _MOST_KINDS:
            self._said.add(kind)
            self.say(f"{topic}: {text}; dropped")

    def take(self, dropped: Mapping[str, int]) -> None:
        """Take in the present numbers of another counter."""
        for kind, count in dropped.items():
            if kind not in self.dropped:
                self.say(f"dropped: {kind}")
            self.dropped[kind] = count

    def summary(self) -> str:
        """The numbers in one line; empty if nothing was dropped."""
        counts = ", ".join(f"{kind} {count}" for kind, count in sorted(self.dropped.items()))
        return f"dropped: {counts}" if counts else ""
