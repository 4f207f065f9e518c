"""A source whose first ticks can be taken a second time."""

from __future__ import annotations

from collections import deque

from sixthsense.core.source import Command, Source, Tick


class RewindableSource:
    """Passes on the ticks of another source, and keeps them until `rewind`, after which they come first."""

    def __init__(self, source: Source) -> None:
        self._source = source
        self._kept: deque[Tick] = deque()
        self._is_rewound = False

    def step(self, command: Command) -> Tick | None:
        """The next tick; for one that comes a second time the command is ignored."""
        if self._is_rewound and self._kept:
            return self._kept.popleft()
        tick = self._source.step(command)
        if tick is not None and not self._is_rewound:
            self._kept.append(tick)
        return tick

    def rewind(self) -> None:
        """Begin again; ticks that follow those so far are not kept."""
        self._is_rewound = True
