"""Who is on a robot's topics: whether a sensor still sends; a second robot or simulator is refused."""

from __future__ import annotations

from typing import Literal

from sixthsense.config.section import shown
from sixthsense.live.network import Endpoint, Node, Reader
from sixthsense.live.reading import TWIST, TWIST_STAMPED
from sixthsense.live.topics import NetworkError, Topic

SILENT_NS = 400_000_000
"""A sensor that has sent nothing for this long is silent where the robot is driven: it must not drive on."""
LONG_SILENT_NS = 2_000_000_000
"""The same where it is only listened to."""
ANNOUNCED_S = 0.5
"""A network has told who is in it this long after one has joined: it takes a few messages of it."""

Publisher = Literal["known", "new", "unknown", "second"]
"""of a message: the one that sends; one that has taken its place; one that may do so; or one beside it"""


class Presence:
    """Tells when a sensor falls silent, and when it is back."""

    def __init__(self, name: str, now_ns: int, silent_ns: int) -> None:
        """The sensor of this name has last been heard now; after `silent_ns` without a message it is silent."""
        self.is_silent = False
        self._silent_ns = silent_ns
        self.name, self._heard_ns = name, now_ns

    def heard(self, now_ns: int) -> float | None:
        """Take in a message; how long the sensor had been silent, seconds, if it had been."""
        silent_s, self._heard_ns = 1e-9 * (now_ns - self._heard_ns), now_ns
        was_silent, self.is_silent = self.is_silent, False
        return silent_s if was_silent else None

    def falls_silent(self, now_ns: int) -> bool:
        """Whether the sensor has fallen silent since the last call."""
        was_silent, self.is_silent = self.is_silent, now_ns - self._heard_ns > self._silent_ns
        return self.is_silent and not was_silent


class Publishers:
    """Tells a publisher that takes the place of another one, as after a restart of a driver, from one beside it.

    What the network announces does not tell them apart: a program that was killed is announced for some seconds more.
    """

    def __init__(self) -> None:
        self._present, self._heard_ns = "", 0
        self._former: set[str] = set()
        self._waiting = ""  # to take the place of the present one

    def heard(self, publisher: str, now_ns: int) -> Publisher:
        """Take in the publisher of a message that has arrived now."""
        if publisher == self._present or not self._present:
            self._present, self._heard_ns = publisher, now_ns
            return "second" if self._waiting else "known"
        if publisher in self._former or self._waiting not in ("", publisher):
            return "second"
        self._waiting = publisher
        if now_ns - self._heard_ns < SILENT_NS:
            return "unknown"
        self._former.add(self._present)
        self._present, self._heard_ns, self._waiting = publisher, now_ns, ""
        return "new"


def check_one_publisher(reader: Reader) -> None:
    """Raise NetworkError if a topic has several publishers: a map of two robots is of neither."""
    if (count := reader.publishers) > 1:
        found = f"{reader.topic.name}: found {count} publishers"
        raise NetworkError(f"{found}, allowed: one robot; --scan and --odom name its topics, --domain its network")


def command_type(node: Node, topic: str, is_stamped: bool) -> str | None:
    """The type of the commands that a robot takes, by its subscription; None before there is one.

    `is_stamped` demands TwistStamped. Raises NetworkError for several subscribers, since each may be a robot, and for
    one of another type.
    """
    found = node.subscribers(topic)
    if not found:
        return None
    if len(found) > 1:
        raise NetworkError(f"{topic}: found {len(found)} subscribers, allowed: one, as each may be a robot that drives")
    (kind, _) = found[0]
    allowed = (TWIST_STAMPED,) if is_stamped else (TWIST, TWIST_STAMPED)
    if kind in allowed:
        return kind
    if kind == TWIST:
        raise NetworkError(f"--cmd-vel-stamped: found a subscriber of {TWIST} on {topic}, allowed: without this option")
    raise NetworkError(f"{topic}: found a subscriber of {shown(kind)}, allowed: {' or '.join(allowed)}")


def check_alone(node: Node, published: tuple[Topic, ...], subscribed: tuple[Topic, ...], before: str = "") -> None:
    """Raise NetworkError if another program publishes or subscribes to a topic that a simulated robot is to have alone.

    With `before` only programs count whose identifier is smaller: of two that begin at once, one stays.
    """
    for topics, ends, what in ((published, node.publishers, "publisher"), (subscribed, node.subscribers, "subscriber")):
        for topic in topics:
            if any(_counts(end, before) for end in ends(topic.name)):
                found = f"{topic.name}: found another {what}"
                raise NetworkError(f"{found}, allowed: one robot or simulator in a network; --domain N is another one")


def _counts(end: Endpoint, before: str) -> bool:
    return not before or end.participant < before
