"""Rerun's viewer as a separate process, which serves its page itself, bound to one address."""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import quote

from sixthsense.config.errors import InputError, installing
from sixthsense.config.section import shown
from sixthsense.view import LOOPBACK, VIEW_TARGETS, is_view_target, watchdog

_START_TIMEOUT_S = 60.0  # until the viewer listens
_MOST_BYTES = 1 << 16  # of what the viewer writes first
_STREAM, _PAGE = rb"gRPC connections on \S+:(\d+)\.", rb"web-viewer at \S+:(\d+) "
"""what the viewer writes when it listens, with the ports that it has bound"""


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

    def __init__(self, kind: str, address: str = LOOPBACK) -> None:
        """Start a viewer, "window" or "browser", and wait until it listens; InputError if it does not."""
        host = f"[{address}]" if ":" in address else address
        command = [_program(), "--bind", address, "--port", "0", "--hide-welcome-screen", "--expect-data-soon"]
        if kind == "browser":
            command += ["--serve-web", "--web-viewer-port", "0", "--cors-allow-origin", f"http://{host}:*"]
        # A session of its own: Ctrl-C stops the run, and the viewer keeps showing its end. The watchdog ends the viewer
        # when this process is gone.
        with tempfile.TemporaryFile() as written:
            self._process = subprocess.Popen(
                [sys.executable, "-I", "-S", watchdog.__file__, *command],
                env=_environment(), stdin=subprocess.PIPE, stdout=written, stderr=written, start_new_session=True,
            )  # fmt: skip
            self.stream = f"rerun+http://{host}:{self._port(written.fileno(), _STREAM)}/proxy"
            """address that data is sent to"""
            self.page = ""
            """address of the page for a browser; empty for a window"""
            if kind == "browser":
                port = self._port(written.fileno(), _PAGE)
                self.page = f"http://{host}:{port}/?url={quote(self.stream, safe='')}"

    def _port(self, written: int, pattern: bytes) -> str:
        """The port that the viewer has bound, by what it has written to a file descriptor; InputError without one."""
        deadline = time.monotonic() + _START_TIMEOUT_S
        while (found := re.search(pattern, os.pread(written, _MOST_BYTES, 0))) is None:
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.end()
                raise InputError("view", "Rerun's viewer does not start", "an IP address of this machine, or FILE.rrd")
            time.sleep(0.05)
        return found[1].decode()

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
    return kept | {"CI": "1", "TELEMETRY_ENABLED": "false", "RUST_LOG": "info"}
