"""Rerun's viewer as a separate process, its servers bound to one address; what `--view` accepts."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import socket
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path
from typing import Literal
from urllib.parse import quote

from sixthsense.config.errors import InputError
from sixthsense.config.section import shown
from sixthsense.view import LOOPBACK, VIEW_TARGETS, is_view_target, keeper
from sixthsense.view.relay import Relay, hosts_of, reachable

_START_TIMEOUT_S = 60.0  # until the viewer listens


class ViewError(InputError):
    """A view that cannot be opened; its message is one line."""


def check_view_target(target: str | Path, address: str = LOOPBACK) -> None:
    """Raise ViewError for an unknown target, a window without a display, or an invalid address.

    Without Rerun the error says how to install it.
    """
    if not is_view_target(str(target)):
        raise ViewError(f"--view: found {shown(str(target))}, allowed: {VIEW_TARGETS}")
    try:
        ipaddress.ip_address(address)
    except ValueError:
        raise ViewError(f"--bind: found {shown(address)}, allowed: an IP address of this machine") from None
    if find_spec("rerun") is None:
        raise ViewError("--view: needs Rerun, which is not installed, allowed: after pip install 'sixthsense[view]'")
    on_linux = sys.platform.startswith("linux")
    if str(target) == "window" and on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise ViewError("--view: found window, but there is no display to open one on, allowed: browser or FILE.rrd")


class Viewer:
    """A viewer in a separate process that listens on one address: a native window, or a server for browsers."""

    def __init__(self, kind: Literal["window", "browser"], address: str = LOOPBACK) -> None:
        """Start the viewer and wait until it listens; ViewError if it does not."""
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
        # A session of its own: Ctrl-C stops the run, and the viewer keeps showing its end. The keeper ends the viewer
        # when this process is gone.
        self._process = subprocess.Popen(
            [sys.executable, "-I", "-S", keeper.__file__, *command],
            env=_environment(), stdin=subprocess.PIPE, stdout=null, stderr=null, start_new_session=True,
        )  # fmt: skip
        deadline = time.monotonic() + _START_TIMEOUT_S
        while not all(_listens(here, port) for port in ports):
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.end()
                raise ViewError(f"--view: Rerun's viewer does not start on {address}, allowed: FILE.rrd")
            time.sleep(0.05)

    def wait(self) -> None:
        """Wait until the viewer ends, or Ctrl-C."""
        self._process.wait()

    def leave(self) -> None:
        """Leave the viewer running when this process ends."""
        self._say(keeper.STAY)

    def end(self) -> None:
        """Stop the viewer if it is still running."""
        if self._relay is not None:
            self._relay.end()
        self._say(b"")
        try:
            self._process.wait(2.0 * keeper.TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _say(self, word: bytes) -> None:
        """Write the last word to the keeper."""
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
    raise ViewError("--view: Rerun's viewer is not installed, allowed: FILE.rrd")


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
        found = f"--bind: found {address}, which cannot be bound ({error.strerror})"
        raise ViewError(f"{found}, allowed: an IP address of this machine") from None


def _listens(address: str, port: int) -> bool:
    try:
        with socket.create_connection((address, port), timeout=1.0):
            return True
    except OSError:
        return False
