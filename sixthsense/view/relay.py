"""A relay of Rerun's page for browsers with a policy that blocks requests to other machines, and its hosts.

The page itself sends usage statistics and checks for updates. With the Content-Security-Policy the browser blocks every
request except those to this server and to the stream.
"""

from __future__ import annotations

import http.client
import ipaddress
import socket
import struct
import sys
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import quote, urlsplit

from sixthsense.view import LOOPBACK

_OWN = "'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:"
_KEPT = ("Content-Type", "Content-Encoding", "Content-Length", "Cache-Control", "ETag")
_TIMEOUT_S = 60.0
_GET_ADDRESS = 0x8915  # SIOCGIFADDR of Linux


class Relay:
    """A server that relays another server on this machine, with the policy."""

    def __init__(self, address: str, page: str, stream_port: int) -> None:
        """Listen on `address` and relay `page`, http://...; the policy allows requests to it and to the stream alone.

        The host of the stream is the one under which the browser has reached this server. Requests for any other host
        are refused: a name of someone else that leads here is no page of this machine.
        """
        hosts, origin = hosts_of(address), urlsplit(page)

        class Handler(BaseHTTPRequestHandler):
            protocol_version = "HTTP/1.1"

            def do_GET(self) -> None:
                host = _host(self.headers["Host"])
                if host not in hosts:
                    self.send_error(421, f"allowed hosts: {', '.join(hosts)}")
                    return
                stream = f"http://{host}:{stream_port}"
                path = urlsplit(self.path)
                if path.path == "/" and "url=" not in path.query:
                    self.send_response(302)
                    self.send_header("Location", f"/?url={quote(f'rerun+{stream}/proxy', safe='')}")
                    self.send_header("Content-Length", "0")
                    self.end_headers()
                    return
                connection = http.client.HTTPConnection(str(origin.hostname), origin.port, timeout=_TIMEOUT_S)
                try:
                    asked = {name: self.headers[name] for name in ("Accept-Encoding",) if name in self.headers}
                    connection.request("GET", self.path, headers=asked)
                    answer = connection.getresponse()
                    body = answer.read()
                except (OSError, http.client.HTTPException):
                    self.send_error(502)
                    return
                finally:
                    connection.close()
                self.send_response(answer.status)
                kept = {name: value for name in _KEPT if (value := answer.headers[name]) is not None}
                for name, value in (kept | {"Content-Length": str(len(body))}).items():
                    self.send_header(name, value)
                self.send_header("Content-Security-Policy", f"default-src {_OWN}; connect-src {_OWN} {stream}")
                self.send_header("Referrer-Policy", "no-referrer")
                self.end_headers()
                self.wfile.write(body)

            def log_message(self, *_: object) -> None:
                """Log nothing: the terminal belongs to the run."""

        class Server(ThreadingHTTPServer):
            daemon_threads = True
            address_family = socket.AF_INET6 if ":" in address else socket.AF_INET

            def handle_error(self, *_: object) -> None:
                """Ignore the error of a closed browser."""

        self._server = Server((address, 0), Handler)
        self.port = int(self._server.server_address[1])
        """port of the relay"""
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Stop the server."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


def _host(header: str | None) -> str:
    """The host of a Host header without its port, as `hosts_of` writes it; empty for none and for a damaged one."""
    try:
        host = urlsplit(f"//{header or ''}").hostname or ""
    except ValueError:
        return ""
    return f"[{host}]" if ":" in host else host.lower()


def _is_wildcard(address: str) -> bool:
    """Whether a server that is bound to this address listens on all addresses of the machine."""
    return ipaddress.ip_address(address).is_unspecified


def hosts_of(address: str) -> tuple[str, ...]:
    """The hosts in the addresses of a server that is bound to `address`, the one to tell first; IPv6 in brackets."""
    if not _is_wildcard(address):
        own = [address, *(["localhost"] if ipaddress.ip_address(address).is_loopback else [])]
    else:
        name = socket.gethostname()
        own = [*_addresses(), name, f"{name}.local", socket.getfqdn(), "localhost", LOOPBACK, "::1"]
    return tuple(dict.fromkeys(f"[{host}]" if ":" in host else host.lower() for host in own if host))


def reachable(address: str) -> str:
    """The address at which this machine itself reaches a server that is bound to `address`."""
    if not _is_wildcard(address):
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
