"""A participant of a DDS network, through Cyclone DDS: topics of ROS 2 with their qualities of service."""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import os
import re
import socket
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple, Self
from xml.sax.saxutils import quoteattr

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


SENSOR = Quality(is_reliable=False, depth=500)
"""of a reader of sensor data, from reliable writers and others: a program that is held up for seconds loses none"""
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


LOOPBACK = "127.0.0.1"

_MOST_PARTICIPANTS = 32  # of this machine, that are looked for: the loopback has no multicast
_ANNOUNCED_S = 1  # from one announcement of this program to the next
_LARGEST_DOMAIN = 232
_MOST_ENDPOINTS = 10_000  # of a network, that are looked at
_ADDRESS = re.compile(r"\d+\.\d+\.\d+\.\d+")
_ROS_TYPE = re.compile(r"(\w+)::(msg)::dds_::(\w+)_")


@dataclass(frozen=True, slots=True)
class Network:
    """Which network to join; by default that of this machine alone."""

    domain: int = 0
    """separates networks, 0 to 232"""
    interface: str = LOOPBACK
    """name or address of the network interface"""

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= _LARGEST_DOMAIN:
            raise InputError("domain", f"found {self.domain}", f"0 to {_LARGEST_DOMAIN}")

    @property
    def is_loopback(self) -> bool:
        """Whether no other machine takes part."""
        return self.interface == "lo" or self.interface.startswith("127.")

    def xml(self) -> str:
        """The configuration of Cyclone DDS: others are found by multicast, on the loopback by asking each port."""
        named = "address" if _ADDRESS.fullmatch(self.interface) else "name"
        return f"""<CycloneDDS><Domain>
  <General>
    <Interfaces><NetworkInterface {named}={quoteattr(self.interface)}/></Interfaces>
    <AllowMulticast>{"false" if self.is_loopback else "spdp"}</AllowMulticast>
  </General>
  <Discovery>
    <SPDPInterval>{_ANNOUNCED_S} s</SPDPInterval>
    <InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}</MaxAutoParticipantIndex>
    <Peers>{f"<Peer address='{LOOPBACK}'/>" * self.is_loopback}</Peers>
  </Discovery>
  <Tracing><Verbosity>none</Verbosity></Tracing>
</Domain></CycloneDDS>"""


def domain_of_environment() -> int:
    """The domain of ROS_DOMAIN_ID, 0 without it; InputError for one that is no number."""
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isascii() or not text.isdigit():
        raise InputError("ROS_DOMAIN_ID", f"found {shown(text)}", f"0 to {_LARGEST_DOMAIN}")
    return int(text)


class Endpoint(NamedTuple):
    """A publisher or subscriber of a topic."""

    topic: str
    """such as /scan"""
    type: str
    """such as sensor_msgs/msg/LaserScan"""


class Message(NamedTuple):
    """A message as it arrived."""

    data: bytes
    """its serialized form"""
    publisher: str
    """identifier of who sent it"""


class Node:
    """A participant with its readers and writers. A context manager, which leaves the network at its end."""

    def __init__(self, network: Network) -> None:
        """Join; InputError if an interface is not there or all places of the domain are taken."""
        core, domain, builtin = dds("core"), dds("domain"), dds("builtin")
        _check_interface(network.interface)
        before = _open_sockets()
        self._open = contextlib.ExitStack()
        try:
            self._keep(domain.Domain(network.domain, network.xml()))
            self._participant = self._keep(domain.DomainParticipant(network.domain))
        except core.DDSException as error:
            where = f"interface {network.interface}, domain {network.domain}"
            raise InputError(where, f"cannot be joined ({error.msg})", "an interface that is up") from None
        is_confined = not network.is_loopback or _confine_to_loopback(_open_sockets() - before)
        self.leak = "" if is_confined else "found the loopback, to which this system lets other machines send"
        """what is wrong with the confinement to this machine, where no other one is to take part"""
        self._waitset = core.WaitSet(self._participant)
        self._published, self._subscribed = (
            self._keep(builtin.BuiltinDataReader(self._participant, topic))
            for topic in (builtin.BuiltinTopicDcpsPublication, builtin.BuiltinTopicDcpsSubscription)
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Leave the network, so that the others know it at once."""
        self._waitset.__del__()
        self._open.close()

    def reader(self, topic: Topic) -> Reader:
        """Subscribe."""
        core = dds("core")
        reader = dds("sub").DataReader(self._participant, self._topic(topic), qos(topic.quality))
        fresh = core.ReadCondition(reader, core.ViewState.Any | core.InstanceState.Any | core.SampleState.NotRead)
        self._waitset.attach(fresh)
        self._keep(reader)
        self._keep(fresh)
        return Reader(reader, topic)

    def writer(self, topic: Topic) -> Writer:
        """Advertise."""
        writer = dds("pub").DataWriter(self._participant, self._topic(topic), qos(topic.quality))
        return Writer(self._keep(writer), dds_type(topic.type))

    def publishers(self, name: str = "") -> list[Endpoint]:
        """The publishers of the topic of this name, or of all topics of ROS, this program's included."""
        return _announced(self._published, name)

    def subscribers(self, name: str) -> list[Endpoint]:
        """The subscribers of the topic of this name, this program's included."""
        return _announced(self._subscribed, name)

    def wait(self, timeout_s: float) -> None:
        """Wait until a reader has a message, at most for a time."""
        self._waitset.wait(round(1e9 * timeout_s))

    def _topic(self, topic: Topic) -> Any:
        return self._keep(dds("topic").Topic(self._participant, f"rt{topic.name}", dds_type(topic.type)))

    def _keep(self, entity: Any) -> Any:
        """The entity, which is let go at the end: a call of `__del__` is the only way that the binding offers."""
        self._open.callback(entity.__del__)
        return entity


class Reader:
    """Takes the messages of a topic."""

    def __init__(self, reader: Any, topic: Topic) -> None:
        self._reader = reader
        self.topic = topic
        """what is subscribed"""
        self._publisher = functools.cache(functools.partial(_publisher, reader))

    def take(self) -> list[bytes]:
        """The serialized messages that have arrived since the last call, the newest at last."""
        return [message.data for message in self.messages()]

    def messages(self) -> list[Message]:
        """The messages that have arrived since the last call, the newest at last."""
        samples = self._reader.take(N=self.topic.quality.depth)
        arrived = [sample for sample in samples if hasattr(sample, "data")]
        return [Message(sample.data, self._publisher(sample.sample_info.publication_handle)) for sample in arrived]


class Writer:
    """Sends messages of a topic."""

    def __init__(self, writer: Any, kind: Any) -> None:
        self._writer, self._kind = writer, kind

    def send(self, data: bytes) -> None:
        """Send a serialized message; it is lost where a reader that must confirm it lags behind."""
        with contextlib.suppress(dds("core").DDSException):
            self._writer.write(self._kind.holding(data))

    @property
    def readers(self) -> int:
        """How many readers there are."""
        return len(self._writer.get_matched_subscriptions())


def _announced(reader: Any, name: str) -> list[Endpoint]:
    """What a network announces now of a topic of ROS, or of all."""
    alive = dds("core").InstanceState.Alive
    found = [
        Endpoint(e.topic_name.removeprefix("rt"), _ROS_TYPE.sub(r"\1/\2/\3", e.type_name))
        for e in reader.read(N=_MOST_ENDPOINTS)
        if e.sample_info.valid_data and e.sample_info.instance_state == alive and e.topic_name.startswith("rt/")
    ]
    return [endpoint for endpoint in found if name in ("", endpoint.topic)]


def _publisher(reader: Any, handle: int) -> str:
    """The identifier of a publisher in the network: its handle is another one after a break of the network."""
    found = reader.get_matched_publication_data(handle)
    return str(handle if found is None else found.key)


def _check_interface(interface: str) -> None:
    """Raise InputError for an interface that this machine has not; Cyclone DDS would take another one."""
    names = [name for _, name in socket.if_nameindex()]
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            if interface not in names:
                probe.bind((str(ipaddress.IPv4Address(interface)), 0))
    except (OSError, ValueError):
        allowed = f"{', '.join(names)}, or an address of one"
        raise InputError("interface", f"found {shown(interface)}", allowed) from None


def _open_sockets() -> set[int]:
    """File descriptors of this process's sockets; empty where the system does not list them."""
    return {int(entry.name) for entry in Path("/proc/self/fd").glob("*") if entry.is_socket()}


def _confine_to_loopback(descriptors: set[int]) -> bool:
    """Let sockets receive from this machine alone: Cyclone DDS binds those that receive to all interfaces.

    Returns whether that is so for all of them, and there are some.
    """
    try:
        for descriptor in descriptors:
            with socket.socket(fileno=os.dup(descriptor)) as copy:
                copy.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
    except (OSError, AttributeError):  # not permitted, or another system
        return False
    return bool(descriptors)
