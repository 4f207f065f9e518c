"""Commands to a robot, with a dead man's switch: without a new one in time the robot is told to stop."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import NamedTuple, Protocol, Self

from sixthsense.core.source import Command
from sixthsense.live.reading import TWIST, TWIST_STAMPED
from sixthsense.record.messages import Messages

TIMEOUT_S = 0.3
"""A moving robot is stopped if no command has followed for this long."""

_CHECK_S = 0.05
_FAREWELLS, _BETWEEN_S = 3, 0.02


class Sender(Protocol):
    """A writer of serialized messages."""

    def send(self, data: bytes) -> None:
        """Send a message."""
        ...


class Stamped(NamedTuple):
    """The header of commands that have one."""

    now_ns: Callable[[], int]
    """the robot's clock"""
    frame: str
    """of the robot"""


class Commands:
    """Sends commands; a thread of its own stops the robot if the loop stalls. A context manager that stops it, too."""

    def __init__(self, writer: Sender, stamped: Stamped | None = None) -> None:
        """Send to `writer`: messages of type TwistStamped if they are to be stamped, else Twist."""
        self.stalls = 0
        """how often the loop was too late"""
        self._writer, self._stamped, self._messages = writer, stamped, Messages()
        self._lock = threading.Lock()
        self._is_moving = False
        self._sent_s = time.monotonic()
        self._over = threading.Event()
        self._watch = threading.Thread(target=self._stop_if_late, name="dead man's switch", daemon=True)

    def __enter__(self) -> Self:
        self._watch.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Stop the robot: the last thing that it hears is a standstill."""
        self._over.set()
        for _again in range(_FAREWELLS):
            self.send(Command())
            time.sleep(_BETWEEN_S)
        self._watch.join()

    def send(self, command: Command) -> None:
        """Send a command now."""
        data = self._serialized(command)
        with self._lock:
            self._writer.send(data)
            self._is_moving = command != Command()
            self._sent_s = time.monotonic()

    def _serialized(self, command: Command) -> bytes:
        make, velocities = self._messages, (command.speed, command.turn_rate)
        if self._stamped is None:
            return make.serialized(make.twist(*velocities), TWIST)
        message = make.twist_stamped(self._stamped.now_ns(), self._stamped.frame, *velocities)
        return make.serialized(message, TWIST_STAMPED)

    def _stop_if_late(self) -> None:
        while not self._over.wait(_CHECK_S):
            if self._is_moving and time.monotonic() - self._sent_s > TIMEOUT_S:
                self.stalls += 1
                self.send(Command())
