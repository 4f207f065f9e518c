"""Topics of ROS 2 for Cyclone DDS: names, types and qualities of service.

Messages are bytes here, as `record.messages` serializes them. DDS needs the structure of a type only to announce it to
others; it is made from the same definitions.
"""

from __future__ import annotations

import re
from functools import cache
from importlib import import_module
from typing import Any, NamedTuple

from sixthsense.config.errors import InputError, installing
from sixthsense.config.section import shown
from sixthsense.record.messages import Messages

_ROS_NAME = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")
_BLOCKED_MS = 20  # a writer waits at most this long for a reader that lags behind


class Quality(NamedTuple):
    """Quality of service of a reader or writer."""

    is_reliable: bool
    is_latched: bool = False
    """whether who comes late gets the last message"""
    depth: int = 10
    """messages that are kept"""


SENSOR = Quality(is_reliable=False, depth=50)
"""of a reader of sensor data, which takes it from reliable writers and others"""
FAST_SENSOR = SENSOR._replace(depth=500)
"""of odometry, which comes more often: a program that is held up for some seconds loses none"""
RELIABLE = Quality(is_reliable=True)
LATCHED = Quality(is_reliable=True, is_latched=True, depth=1)


class Topic(NamedTuple):
    """A topic, its type and its quality of service."""

    name: str
    """as ROS has it, such as /scan"""
    type: str
    """such as sensor_msgs/msg/LaserScan"""
    quality: Quality


def checked_topic(option: str, name: str) -> str:
    """The absolute name of a topic; InputError for one that is not allowed."""
    if not _ROS_NAME.fullmatch(name) or len(name) > 200:
        raise InputError(option, f"found {shown(name)}", "a name such as /scan")
    return "/" + name.lstrip("/")


@cache
def dds_type(name: str) -> Any:
    """The structure of a message as Cyclone DDS needs it, whose samples hold their serialized form as `data`."""
    struct = _structure(Messages().store.fielddefs, name)

    def holding(data: bytes) -> Any:
        sample = struct.__new__(struct)
        sample.data = data
        return sample

    struct.holding = staticmethod(holding)
    struct.serialize = lambda sample, **_: sample.data
    struct.deserialize = staticmethod(lambda data, **_: holding(data))
    return struct


def _structure(definitions: Any, name: str) -> Any:
    """The structure of a message, by the names and types of its fields."""
    from rosbags.interfaces import Nodetype

    idl, types = dds("idl"), dds("idl.types")

    def kind(node: Any) -> Any:
        category, what = node
        if category is Nodetype.BASE:
            return {"string": str, "bool": bool}.get(what[0]) or getattr(types, what[0])
        if category is Nodetype.NAME:
            return _structure(definitions, what)
        element, count = what
        return types.array[kind(element), count] if category is Nodetype.ARRAY else types.sequence[kind(element)]

    package, _, short = name.split("/")
    fields = {field: kind(node) for field, node in definitions[name][1]}
    return idl.make_idl_struct(f"{short}_", f"{package}.msg.dds_.{short}_", fields)


def qos(quality: Quality) -> Any:
    """The quality of service as Cyclone DDS has it; data as CDR, which all vendors of ROS 2 read."""
    found, duration = dds("qos"), dds("util").duration
    policy = found.Policy
    return found.Qos(
        policy.Reliability.Reliable(duration(milliseconds=_BLOCKED_MS))
        if quality.is_reliable
        else policy.Reliability.BestEffort,
        policy.Durability.TransientLocal if quality.is_latched else policy.Durability.Volatile,
        policy.History.KeepLast(quality.depth),
        policy.DataRepresentation(use_cdrv0_representation=True),
    )


def dds(module: str) -> Any:
    """A module of Cyclone DDS; InputError that says how to install it."""
    try:
        return import_module(f"cyclonedds.{module}")
    except ImportError as error:
        raise InputError("ROS 2", f"Cyclone DDS cannot be imported ({error}), {installing('ros2')}") from None
