"""What a user asks of a live run on topics: a pose, a pause, a new map."""

from __future__ import annotations

from typing import NamedTuple

from sixthsense.core.geometry import Array, Pose
from sixthsense.live.network import Node
from sixthsense.live.reading import EMPTY, POSE, SWITCH, MessageReader, Notices
from sixthsense.live.topics import RELIABLE, Topic


class SetPose(NamedTuple):
    """The robot is at this pose now."""

    T_map_robot: Pose
    cov: Array
    """(3, 3) of it, axes of the map; zero where none is stated"""


class Pause(NamedTuple):
    """Scans are left out from now on, or used again."""

    is_paused: bool


class Reset(NamedTuple):
    """The map begins anew."""


Request = SetPose | Pause | Reset

SET_POSE, PAUSE, RESET = (
    Topic(name, kind, RELIABLE) for name, kind in (("/initialpose", POSE), ("/pause", SWITCH), ("/reset", EMPTY))
)


class Requests:
    """Listens to the topics of requests."""

    def __init__(self, node: Node, reader: MessageReader, notices: Notices) -> None:
        self._reader, self._notices = reader, notices
        self._topics = [node.reader(topic) for topic in (SET_POSE, PAUSE, RESET)]
        self._pending: list[Request] = []

    def listen(self) -> None:
        """Read what has arrived."""
        for reader in self._topics:
            for data in reader.take():
                try:
                    self._pending.append(read_request(self._reader, data, reader.topic))
                except ValueError as error:
                    self._notices.unusable(reader.topic.name, error)

    def take(self) -> list[Request]:
        """The requests since the last call."""
        found, self._pending = self._pending, []
        return found


def read_request(reader: MessageReader, data: bytes, topic: Topic) -> Request:
    """The request of a serialized message; ValueError for one that cannot be used."""
    if topic == SET_POSE:
        return SetPose(*reader.pose_in_map(data))
    return Pause(reader.switch(data)) if topic == PAUSE else Reset()
