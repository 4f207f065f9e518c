"""Messages of a log that cannot be used: each costs itself, and is counted by its reason."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping


class Refused:
    """Counts the messages that were left out, by what they should have been."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], str] = {}
        """text of the first of a kind, by topic and by what is allowed"""
        self._counts: Counter[tuple[str, str]] = Counter()

    def add(self, topic: str, error: Exception) -> None:
        """Count a message of a topic, or a line of a file, that cannot be used."""
        text = " ".join(str(error).split())
        kind = topic, text.partition("allowed:")[2] or type(error).__name__
        self._found.setdefault(kind, text)
        self._counts[kind] += 1

    def count(self, topic: str) -> int:
        """Number of messages of a topic that were left out."""
        return sum(count for (name, _), count in self._counts.items() if name == topic)

    def first(self, topic: str) -> str:
        """What was wrong with most of the messages of a topic."""
        kind = max((kind for kind in self._counts if kind[0] == topic), key=lambda kind: self._counts[kind])
        return self._found[kind]

    def remarks(self, totals: Mapping[str, int], what: str = "messages of {}") -> list[str]:
        """A line for each reason; `totals` has the number of all messages by topic, `what` is their name."""
        return [
            f"{count} of {totals.get(topic, count)} {what.format(topic)} left out: {self._found[topic, kind]}"
            for (topic, kind), count in self._counts.items()
        ]
