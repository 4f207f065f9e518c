"""The names and addresses under which a browser reaches a server on this machine."""

from __future__ import annotations

import ipaddress
import socket
import struct
import sys
from collections.abc import Iterator

from sixthsense.view.target import LOOPBACK

_GET_ADDRESS = 0x8915  # SIOCGIFADDR of Linux


def is_wildcard(address: str) -> bool:
    """Whether a server that is bound to this address listens on all addresses of the machine."""
    return ipaddress.ip_address(address).is_unspecified


def hosts_of(address: str) -> tuple[str, ...]:
    """The hosts in the addresses of a server that is bound to `address`, the one to tell first; IPv6 in brackets."""
    if not is_wildcard(address):
        own = [address, *(["localhost"] if ipaddress.ip_address(address).is_loopback else [])]
    else:
        name = socket.gethostname()
        own = [*_addresses(), name, f"{name}.local", socket.getfqdn(), "localhost", LOOPBACK, "::1"]
    return tuple(dict.fromkeys(f"[{host}]" if ":" in host else host.lower() for host in own if host))


def reachable(address: str) -> str:
    """The address at which this machine itself reaches a server that is bound to `address`."""
    if not is_wildcard(address):
        return address
    return "::1" if ":" in address else LOOPBACK


def _addresses() -> Iterator[str]:
    """The addresses of this machine's interfaces, that of the default route first; no packet is sent."""
    for family, elsewhere in ((socket.AF_INET, "192.0.2.1"), (socket.AF_INET6, "2001:db8::1")):
        try:
            with socket.socket(family, socket.SOCK_DGRAM) as probe:
                probe.connect((elsewhere, 9))
                yield str(probe.getsockname()[0])
        except OSError:
            continue
    if sys.platform.startswith("linux"):
        import fcntl

        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            for _, name in socket.if_nameindex():
                try:
                    answer = fcntl.ioctl(probe.fileno(), _GET_ADDRESS, struct.pack("256s", name.encode()[:15]))
                except OSError:
                    continue  # an interface without an IPv4 address
                yield socket.inet_ntoa(answer[20:24])
