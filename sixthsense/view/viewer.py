"""Rerun's viewer as a separate process, its servers bound to one address, and the relay of its page for browsers."""

from __future__ import annotations

import contextlib
import http.client
import ipaddress
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from typing import Literal
from urllib.parse import quote, urlsplit

from sixthsense.config.errors import InputError, installing
from sixthsense.config.section import shown
from sixthsense.view import LOOPBACK, VIEW_TARGETS, is_view_target, watchdog

_START_TIMEOUT_S = 60.0  # until the viewer listens
_OWN = "'self' 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval' data: blob:"
_KEPT = ("Content-Type", "Content-Encoding", "Content-Length", "Cache-Control", "ETag")
_TIMEOUT_S = 60.0
_GET_ADDRESS = 0x8915  # SIOCGIFADDR of Linux


def check_view_target(target: str | Path, address: str = LOOPBACK) -> None:
    """Raise InputError for an unknown target, a window without a display, or an invalid address.

    Without Rerun the error says how to install it.
    """
    if not is_view_target(str(target)):
        raise InputError("view", f"found {shown(str(target))}", VIEW_TARGETS)
    try:
        ipaddress.ip_address(address)
    except ValueError:
        raise InputError("address", f"found {shown(address)}", "an IP address of this machine") from None
    if find_spec("rerun") is None:
        raise InputError("view", f"needs Rerun, {installing('view')}")
    on_linux = sys.platform.startswith("linux")
    if str(target) == "window" and on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("view", "found window, but there is no display to open one on", "browser or FILE.rrd")


class Viewer:
    """A viewer in a separate process that listens on one address: a native window, or a server for browsers."""

    def __init__(self, kind: Literal["window", "browser"], address: str = LOOPBACK) -> None:
        """Start the viewer and wait until it listens; InputError if it does not."""
        here, hosts = reachable(address), hosts_of(address)
        host = f"[{here}]" if ":" in here else here
        port = _free_port(address)
        self.stream = f"rerun+http://{host}:{port}/proxy"
        """address that data is sent to"""
        self.page = ""
        """address of the page for a browser; empty for a window"""
        self._relay: Relay | None = None
        command, ports = [_program(), "--bind", address, "--port", str(port)], [port]
        if kind == "browser":
            ports.append(_free_port(address))
            self._relay = Relay(address, f"http://{host}:{ports[1]}", port)
            origins = [f"http://{name}:{self._relay.port}" for name in hosts]
            stream = f"rerun+http://{hosts[0]}:{port}/proxy"
            self.page = f"{origins[0]}/?url={quote(stream, safe='')}"
            command += ["--serve-web", "--web-viewer-port", str(ports[1])]
            command += [word for origin in origins for word in ("--cors-allow-origin", origin)]
        else:
            command += ["--hide-welcome-screen", "--expect-data-soon"]
        null = subprocess.DEVNULL
        # A session of its own: Ctrl-C stops the run, and the viewer keeps showing its end. The watchdog ends the viewer
        # when this process is gone.
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", watchdog.__file__, *command],
            env=_environment(), stdin=subprocess.PIPE, stdout=null, stderr=null, start_new_session=True,
        )  # fmt: skip
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not all(_listens(here, port) for port in ports):
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.end()
                raise InputError("view", f"Rerun's viewer does not start on {address}", "FILE.rrd")
            time.sleep(0.05)

    def wait(self) -> None:
        """Wait until the viewer ends, or Ctrl-C."""
        self._process.wait()

    def leave(self) -> None:
        """Leave the viewer running when this process ends."""
        self._say(watchdog.STAY)

    def end(self) -> None:
        """Stop the viewer if it is still running."""
        if self._relay is not None:
            self._relay.end()
        self._say(b"")
        try:
            self._process.wait(2.0 * watchdog.TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _say(self, word: bytes) -> None:
        """Write the last word to the watchdog."""
        assert self._process.stdin is not None
        with contextlib.suppress(OSError, ValueError):  # it has ended, or has been told before
            self._process.stdin.write(word)
            self._process.stdin.close()


def _program() -> str:
    """The path of Rerun's binary; its wrapper script would not forward the signal that ends it."""
    spec = find_spec("rerun_cli")
    folders = list(spec.submodule_search_locations or ()) if spec is not None else []
    names = ("rerun", "rerun.exe", "Rerun.app/Contents/MacOS/Rerun")
    for file in (Path(folder) / name for folder in folders for name in names):
        if file.is_file():
            return str(file)
    raise InputError("view", "Rerun's viewer is not installed", "FILE.rrd")


def _environment() -> dict[str, str]:
    """The environment without usage statistics: the viewer sends none if `CI` is set."""
    kept = {name: value for name, value in os.environ.items() if name != "FORCE_RERUN_ANALYTICS"}
    return kept | {"CI": "1", "TELEMETRY_ENABLED": "false"}


def _free_port(address: str) -> int:
    try:
        family = socket.getaddrinfo(address, 0, type=socket.SOCK_STREAM)[0][0]
        with socket.socket(family, socket.SOCK_STREAM) as probe:
            probe.bind((address, 0))
            return int(probe.getsockname()[1])
    except OSError as error:
        found = f"found {address}, which cannot be bound ({error.strerror})"
        raise InputError("bind", found, "an IP address of this machine") from None


def _listens(address: str, port: int) -> bool:
    try:
        with socket.create_connection((address, port), timeout=1.0):
            return True
    except OSError:
        return False


class Relay:
    """A server that relays Rerun's page for browsers with a policy that blocks requests to other machines.

    The page itself sends usage statistics and checks for updates. With the Content-Security-Policy the browser blocks
    every request except those to this server and to the stream.
    """

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
