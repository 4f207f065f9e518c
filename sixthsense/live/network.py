"""A participant of a DDS network, through Cyclone DDS: topics of ROS 2 with their qualities of service."""

from __future__ import annotations

import contextlib
import functools
import ipaddress
import os
import re
import socket
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self
from xml.sax.saxutils import quoteattr

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.live.topics import Topic, dds, dds_type, qos

LOOPBACK = "127.0.0.1"
LARGEST_MESSAGE_BYTES = 64 << 20
"""A larger message is dropped before it is put together from its packets."""

_OWN_CONFIGURATION = "CYCLONEDDS_URI"
_INTERFACE_NAME = re.compile(r"[A-Za-z0-9_.:-]{1,15}")
_MOST_PARTICIPANTS = 32  # of a host, that are looked for at an address without multicast
_ANNOUNCED_S = 1  # from one announcement of this program to the next
_LARGEST_DOMAIN = 232
_MOST_ENDPOINTS = 10_000  # of a network, that are looked at
_ROS_TYPE = re.compile(r"(\w+)::(msg)::dds_::(\w+)_")


@dataclass(frozen=True, slots=True)
class Network:
    """Which network to join; by default that of this machine alone."""

    domain: int = 0
    """separates networks, 0 to 232"""
    interfaces: tuple[str, ...] = (LOOPBACK,)
    """names or addresses of the network interfaces"""
    peers: tuple[str, ...] = ()
    """addresses of hosts to ask for participants, beside those that multicast finds"""
    is_configured: bool = False
    """whether CYCLONEDDS_URI has the user's own configuration, instead of interfaces and peers"""

    def __post_init__(self) -> None:
        if not 0 <= self.domain <= _LARGEST_DOMAIN:
            raise InputError("domain", f"found {self.domain}", f"0 to {_LARGEST_DOMAIN}")
        for interface in self.interfaces:
            if not (_is_address(interface) or _INTERFACE_NAME.fullmatch(interface)):
                found = f"found {shown(interface)}"
                raise InputError("interface", found, "names or addresses of network interfaces")
        if any(map(_is_loopback, self.interfaces)) and not self.is_loopback:
            found = f"found {','.join(self.interfaces)}"
            raise InputError("interface", found, "others without the loopback: they reach this machine, too")
        for peer in self.peers:
            if not _is_address(peer):
                raise InputError("peers", f"found {shown(peer)}", "addresses such as 192.168.1.7")
            if self.is_loopback and not ipaddress.ip_address(peer).is_loopback:
                found = f"found {peer} with `interface` {','.join(self.interfaces)}"
                raise InputError("peers", found, "with the interface that leads there")

    @property
    def is_loopback(self) -> bool:
        """Whether no other machine takes part."""
        return not self.is_configured and all(map(_is_loopback, self.interfaces))

    def xml(self) -> str:
        """The configuration of Cyclone DDS; docs/howto/live.md says what its settings are for."""
        interfaces = "".join(
            f"\n      <NetworkInterface {'address' if _is_address(one) else 'name'}={quoteattr(one)}/>"
            for one in self.interfaces
        )
        peers = (LOOPBACK,) if self.is_loopback and not self.peers else self.peers
        listed = "".join(f"\n      <Peer address={quoteattr(peer)}/>" for peer in peers)
        return f"""<CycloneDDS><Domain>
  <General>
    <Interfaces>{interfaces}
    </Interfaces>
    <AllowMulticast>{"false" if self.is_loopback else "spdp"}</AllowMulticast>
  </General>
  <Discovery>
    <SPDPInterval>{_ANNOUNCED_S} s</SPDPInterval>
    <InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>
    <ParticipantIndex>auto</ParticipantIndex>
    <MaxAutoParticipantIndex>{_MOST_PARTICIPANTS}</MaxAutoParticipantIndex>
    <Peers>{listed}
    </Peers>
  </Discovery>
  <Internal><MaxSampleSize>{LARGEST_MESSAGE_BYTES} B</MaxSampleSize></Internal>
  <Tracing><Verbosity>none</Verbosity></Tracing>
</Domain></CycloneDDS>"""


def domain_of_environment() -> int:
    """The domain of ROS_DOMAIN_ID, 0 without it; InputError for one that is no number."""
    text = os.environ.get("ROS_DOMAIN_ID", "") or "0"
    if not text.isascii() or not text.isdigit():
        raise InputError("ROS_DOMAIN_ID", f"found {shown(text)}", f"0 to {_LARGEST_DOMAIN}")
    return int(text)


def is_configured_by_user() -> bool:
    """Whether CYCLONEDDS_URI has a configuration of Cyclone DDS."""
    return bool(os.environ.get(_OWN_CONFIGURATION))


def check_installed() -> None:
    """Raise InputError, which says how to install it, if there is no Cyclone DDS."""
    dds("core")


class Endpoint(NamedTuple):
    """A publisher or subscriber of a topic."""

    type: str
    """such as sensor_msgs/msg/LaserScan"""
    participant: str
    """identifier of the program it is part of"""


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
        core, domain = dds("core"), dds("domain")
        own = not network.is_configured
        for interface in network.interfaces * own:
            _check_interface(interface)
        before = _open_sockets()
        self._open = contextlib.ExitStack()
        try:
            if own:
                self._keep(domain.Domain(network.domain, network.xml()))
            self._participant = self._keep(domain.DomainParticipant(network.domain))
        except core.DDSException as error:
            where = f"interface {','.join(network.interfaces)}" if own else _OWN_CONFIGURATION
            allowed = "an interface that is up" if own else "a configuration of Cyclone DDS"
            where = f"{where}, domain {network.domain}"
            raise InputError(where, f"cannot be joined ({error.msg})", allowed) from None
        self.is_confined = network.is_loopback and _confine_to_loopback(_open_sockets() - before)
        """whether no other machine can send: not on each system, and not with another interface"""
        self._waitset = core.WaitSet(self._participant)
        self._published, self._subscribed = map(self._announced, ("Publication", "Subscription"))

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

    @property
    def participant(self) -> str:
        """Identifier of this program."""
        return str(self._participant.get_guid())

    def publishers(self, name: str) -> list[Endpoint]:
        """The publishers of the topic of this name, this program's included."""
        return _endpoints(self._published, name)

    def subscribers(self, name: str) -> list[Endpoint]:
        """The subscribers of the topic of this name, this program's included."""
        return _endpoints(self._subscribed, name)

    def seen(self) -> dict[str, str]:
        """The type of each topic of ROS that another program publishes, by its name."""
        own, found = self.participant, _read_announced(self._published)
        return {e.topic_name.removeprefix("rt"): _ros_type(e) for e in found if str(e.participant_key) != own}

    def wait(self, timeout_s: float) -> None:
        """Wait until a reader has a message, at most for a time."""
        self._waitset.wait(round(1e9 * timeout_s))

    def _announced(self, kind: str) -> Any:
        """The reader of what the network announces of publications or subscriptions."""
        builtin = dds("builtin")
        return self._keep(builtin.BuiltinDataReader(self._participant, getattr(builtin, f"BuiltinTopicDcps{kind}")))

    def _topic(self, topic: Topic) -> Any:
        return self._keep(dds("topic").Topic(self._participant, f"rt{topic.name}", dds_type(topic.type)))

    def _keep(self, entity: Any) -> Any:
        """The entity, which is let go at the end: a call of `__del__` is the only way that the binding offers."""
        self._open.callback(entity.__del__)
        return entity


class Reader:
    """Takes the messages of a topic."""

    def __init__(self, reader: Any, topic: Topic) -> None:
        self._reader, self._depth = reader, topic.quality.depth
        self.topic = topic
        """what is subscribed"""
        self._publisher = functools.cache(functools.partial(_publisher, reader))

    @property
    def publishers(self) -> int:
        """How many publishers there are whose messages arrive here."""
        return len(self._reader.get_matched_publications())

    def take(self) -> list[bytes]:
        """The serialized messages that have arrived since the last call, the newest at last."""
        return [message.data for message in self.messages()]

    def messages(self) -> list[Message]:
        """The messages that have arrived since the last call, the newest at last."""
        samples = self._reader.take(N=self._depth)
        arrived = [sample for sample in samples if hasattr(sample, "data")]
        return [Message(sample.data, self._publisher(sample.sample_info.publication_handle)) for sample in arrived]


class Writer:
    """Sends messages of a topic."""

    def __init__(self, writer: Any, kind: Any) -> None:
        self._writer, self._kind = writer, kind

    def send(self, data: bytes) -> bool:
        """Send a serialized message; false if it is lost, as where a reader that must confirm it lags behind."""
        try:
            self._writer.write(self._kind.holding(data))
        except dds("core").DDSException:
            return False
        return True

    @property
    def readers(self) -> int:
        """How many readers there are."""
        return len(self._writer.get_matched_subscriptions())


def _endpoints(announced: Any, name: str) -> list[Endpoint]:
    """What a network announces of a topic now."""
    return [
        Endpoint(_ros_type(e), str(e.participant_key))
        for e in _read_announced(announced)
        if e.topic_name == f"rt{name}"
    ]


def _read_announced(announced: Any) -> list[Any]:
    """What a network announces now of topics of ROS."""
    alive, found = dds("core").InstanceState.Alive, announced.read(N=_MOST_ENDPOINTS)
    return [
        e
        for e in found
        if e.sample_info.valid_data and e.sample_info.instance_state == alive and e.topic_name.startswith("rt/")
    ]


def _ros_type(endpoint: Any) -> str:
    """The type of an endpoint as ROS has it."""
    return _ROS_TYPE.sub(r"\1/\2/\3", endpoint.type_name)


def _publisher(reader: Any, handle: int) -> str:
    """The identifier of a publisher in the network: its handle is another one after a break of the network."""
    found = reader.get_matched_publication_data(handle)
    return str(handle if found is None else found.key)


def _is_address(text: str) -> bool:
    try:
        return ipaddress.ip_address(text).version == 4
    except ValueError:
        return False


def _is_loopback(interface: str) -> bool:
    return interface == "lo" or (_is_address(interface) and ipaddress.ip_address(interface).is_loopback)


def _check_interface(interface: str) -> None:
    """Raise InputError for an interface that this machine has not; Cyclone DDS would take another one."""
    try:
        if _is_address(interface):
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
                probe.bind((interface, 0))
        else:
            socket.if_nametoindex(interface)
    except OSError:
        names = ", ".join(name for _, name in socket.if_nameindex())
        raise InputError("interface", f"found {interface}", f"{names}, or an address of one") from None


def _open_sockets() -> set[int]:
    """File descriptors of this process's sockets; empty where the system does not list them."""
    found = set()
    with contextlib.suppress(OSError):
        for entry in Path("/proc/self/fd").iterdir():
            with contextlib.suppress(OSError):
                if str(entry.readlink()).startswith("socket:"):
                    found.add(int(entry.name))
    return found


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
