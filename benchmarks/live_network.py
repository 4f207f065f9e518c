"""Live runs beside Fast DDS: who is found how soon.

The robot is that of `tests/interop`. Networks beside the loopback are two network namespaces, which need root.
"""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from runs import Figures, Setting

from sixthsense.live.network import LOOPBACK, SENSOR, Network, Node
from sixthsense.live.publishing import MAP
from sixthsense.live.simulated import SCAN

PEER = Path("runs/interop/peer")
APART_S = 36.0  # more than the 30 s after which Cyclone DDS by itself forgets peers
LOST_S = 20.0
SIDES = {"a": "10.77.0.1", "b": "10.77.0.2"}


def listen(domain: str, interface: str) -> None:
    """Print the time of joining, and that at which each publisher of scans is heard first, once it hears this program.

    That is so when it takes the map that is offered.
    """
    with Node(Network(int(domain), interface)) as node:
        scans, maps, heard = node.reader(SCAN._replace(quality=SENSOR)), node.writer(MAP), set()
        print(time.time(), flush=True)
        while True:
            node.wait(0.02)
            for message in scans.messages():
                if message.publisher not in heard and maps.readers:
                    heard.add(message.publisher)
                    print(time.time(), flush=True)


class Program:
    """A process whose lines are kept as they come."""

    def __init__(self, words: Sequence[str], namespace: str = "") -> None:
        inside = ["ip", "netns", "exec", f"sixthsense-{namespace}"] if namespace else []
        self.process = subprocess.Popen([*inside, *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.lines: list[str] = []
        self.thread = threading.Thread(target=self._read, daemon=True)
        self.thread.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        for line in self.process.stdout:
            self.lines.append(line)

    def line(self, number: int, within_s: float = LOST_S) -> str | None:
        """A line, counted from 0, if it comes within a time."""
        until_s = time.monotonic() + within_s
        while len(self.lines) <= number and time.monotonic() < until_s:
            time.sleep(0.01)
        return self.lines[number] if len(self.lines) > number else None

    def end(self) -> None:
        """Kill it, and wait for the end."""
        self.process.kill()
        self.process.wait()
        self.thread.join()


def robot(domain: int, namespace: str) -> Program:
    joined = Program([str(PEER), "--domain", str(domain), "--seconds", "9999"], namespace)
    assert joined.line(0, 200.0) is not None, "the robot cannot join"
    return joined


def listener(domain: int, namespace: str, interface: str) -> Program:
    found = Program([sys.executable, __file__, "--listen", str(domain), interface], namespace)
    assert found.line(0, 200.0) is not None, "the network cannot be joined"
    return found


def delay(of: Program, number: int, robot: Program) -> float:
    """Seconds from when both have joined to a line."""
    line = of.line(number)
    return float("inf") if line is None else float(line) - max(float(of.lines[0]), float(robot.lines[0]))


def found_in(domain: int, namespaces: tuple[str, str], interface: str) -> list[float]:
    """Seconds until both have found each other: listener first, robot again, listener again, robot first."""
    ours, theirs = namespaces
    first = listener(domain, ours, interface)
    time.sleep(APART_S)
    one = robot(domain, theirs)
    delays = [delay(first, 1, one)]
    one.end()
    two = robot(domain, theirs)
    delays.append(delay(first, 2, two))
    first.end()
    second = listener(domain, ours, interface)
    delays.append(delay(second, 1, two))
    two.end()
    second.end()
    three = robot(domain, theirs)
    time.sleep(APART_S)
    third = listener(domain, ours, interface)
    delays.append(delay(third, 1, three))
    three.end()
    third.end()
    return delays


@contextlib.contextmanager
def namespaces() -> Iterator[None]:
    """Two network namespaces with a cable between them."""

    def ip(words: str) -> None:
        subprocess.run(["ip", *words.split()], check=True)

    names = {side: f"sixthsense-{side}" for side in SIDES}
    try:
        for name in names.values():
            ip(f"netns add {name}")
            ip(f"-n {name} link set lo up")
        ip(f"link add cable-a netns {names['a']} type veth peer name cable-b netns {names['b']}")
        for side, name in names.items():
            ip(f"-n {name} address add {SIDES[side]}/24 dev cable-{side}")
            ip(f"-n {name} link set cable-{side} up")
            ip(f"-n {name} route add 239.0.0.0/8 dev cable-{side}")
        yield
    finally:
        for name in names.values():
            subprocess.run(["ip", "netns", "delete", name], check=False)


CONNECTIONS = {"loopback": (("", ""), LOOPBACK), "one interface": (("a", "b"), "cable-a")}
"""namespaces of both, and our interface"""


def found(setting: Setting, seed: int) -> Figures:
    """Seconds until both have found each other; the networks beside the loopback need root."""
    subprocess.run(["tests/interop/build.sh", str(PEER.parent)], check=True, cwd=Path(__file__).parents[1])
    with namespaces() if setting[0] != "loopback" else contextlib.nullcontext():
        delays = found_in(90, *CONNECTIONS[setting[0]])
    return dict(zip(("live_first", "robot_again", "live_again", "robot_first"), delays, strict=True))


if __name__ == "__main__":
    listen(*sys.argv[sys.argv.index("--listen") + 1 :])
