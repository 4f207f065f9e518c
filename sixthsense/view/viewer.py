"""Rerun's viewer as a separate process, which serves its page itself, bound to one address."""

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

from sixthsense.config.errors import InputError, installing
from sixthsense.config.section import shown
from sixthsense.view import LOOPBACK, VIEW_TARGETS, is_view_target, watchdog

_START_TIMEOUT_S = 60.0  # until the viewer listens


def check_view_target(target: str | Path, address: str = LOOPBACK) -> None:
    """Raise InputError for an unknown target, a window without a display, or an invalid address.

    Without Rerun the error says how to install it.
    """
    if not is_view_target(str(target)):
        raise InputError("view", f"found {shown(str(target))}", VIEW_TARGETS)
    try:
        is_one = not ipaddress.ip_address(address).is_unspecified
    except ValueError:
        is_one = False
    if not is_one:
        raise InputError("address", f"found {shown(address)}", "one IP address of this machine")
    if find_spec("rerun") is None:
        raise InputError("view", f"needs Rerun, {installing('view')}")
    on_linux = sys.platform.startswith("linux")
    if str(target) == "window" and on_linux and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise InputError("view", "found window, but there is no display to open one on", "browser or FILE.rrd")


class Viewer:
    """A viewer in a separate process that listens on one address: a native window, or a server for browsers."""

    def __init__(self, kind: Literal["window", "browser"], address: str = LOOPBACK) -> None:
        """Start the viewer and wait until it listens; InputError if it does not."""
        host = f"[{address}]" if ":" in address else address
        port = _free_port(address)
        self.stream = f"rerun+http://{host}:{port}/proxy"
        """address that data is sent to"""
        self.page = ""
        """address of the page for a browser; empty for a window"""
        command, ports = [_program(), "--bind", address, "--port", str(port)], [port]
        if kind == "browser":
            ports.append(_free_port(address))
            origin = f"http://{host}:{ports[1]}"
            self.page = f"{origin}/?url={quote(self.stream, safe='')}"
            command += ["--serve-web", "--web-viewer-port", str(ports[1]), "--cors-allow-origin", origin]
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
        while not all(_listens(address, port) for port in ports):
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
