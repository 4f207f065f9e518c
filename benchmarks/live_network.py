"""Live runs beside Fast DDS: who is found how soon, gaps of /pose, restarts, memory.

The robot is that of `tests/interop`. Networks beside the loopback are two network namespaces, which need root.
"""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from runs import Figures, Setting

from sixthsense.live.network import LOOPBACK, SENSOR, Network, Node
from sixthsense.live.publishing import MAP
from sixthsense.live.reading import TWIST
from sixthsense.live.simulated import CMD_VEL, SCAN
from sixthsense.record.messages import Messages

PROGRAM = "import sys; from sixthsense.cli import main; sys.exit(main())"
PEER = Path("runs/interop/peer")
APART_S = 36.0  # more than the 30 s after which Cyclone DDS by itself forgets peers
LOST_S = 20.0
SIDES = {"a": "10.77.0.1", "b": "10.77.0.2"}
HALL_M, RESTARTS = 200.0, 50


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

    def end(self, by: int = signal.SIGKILL) -> None:
        """Send a signal, and wait for the end."""
        self.process.send_signal(by)
        self.process.wait()
        self.thread.join()


def robot(domain: int, namespace: str = "", *more: str) -> Program:
    joined = Program([str(PEER), "--domain", str(domain), "--seconds", "9999", *more], namespace)
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
    build()
    with namespaces() if setting[0] != "loopback" else contextlib.nullcontext():
        delays = found_in(90, *CONNECTIONS[setting[0]])
    return dict(zip(("live_first", "robot_again", "live_again", "robot_first"), delays, strict=True))


def build() -> None:
    """The robot on Fast DDS."""
    subprocess.run(["tests/interop/build.sh", str(PEER.parent)], check=True, cwd=Path(__file__).parents[1])


def live(domain: int, folder: Path, seconds: float, *more: str) -> Program:
    words = ["--domain", str(domain), "--out", str(folder / "run"), "--max-time", str(seconds), *more]
    return Program([sys.executable, "-c", PROGRAM, "live", *words])


def gaps(setting: Setting, seed: int) -> Figures:
    """The gaps of /pose beside the map of a hall of 200 m by 200 m with pillars, all of which each scan sees."""
    build()
    with tempfile.TemporaryDirectory() as name:
        return beside_a_hall(Path(name))


def beside_a_hall(folder: Path) -> Figures:
    """Scans at 10 Hz."""
    half = HALL_M / 2.0
    corners = [[-half, -half], [half, -half], [half, half], [-half, half]]
    pillars = [[[x, y], [x + 2.1, y + 0.3], [x + 1.7, y + 2.6]] for x in range(-81, 90, 33) for y in range(-73, 90, 29)]
    scene = folder / "hall.toml"
    tables = "".join(f"[[polygons]]\npoints = {points}\n" for points in (corners, *pillars))
    scene.write_text(f"start = [3.3, -9.2, 0.4]\nradius = 0.15\n{tables}")
    laser = ["--laser.beams", "720", "--laser.max-range", "120"]
    words = ["simulate", str(scene), "--domain", "97", "--max-time", "200", "--timeout", "9", *laser]
    simulated = Program([sys.executable, "-c", PROGRAM, *words])
    poses = Program([str(PEER), "--domain", "97", "--listen", "--seconds", "9999", "--no-map"])
    run = live(97, folder, 60.0)
    with Node(Network(97)) as node:  # the robot drives a circle; by itself it would map the hall, too
        commands, make = node.writer(CMD_VEL), Messages()
        while run.process.poll() is None:
            commands.send(make.serialized(make.twist(0.3, 0.2), TWIST))
            time.sleep(1.0)
    poses.end(signal.SIGTERM)
    simulated.end()
    pose = json.loads(poses.lines[-1])["/pose"]
    return {"poses": pose["count"], "gap_p99_s": pose["gap_p99_s"], "gap_max_s": pose["gap_max_s"]}


def restarts(setting: Setting, seed: int) -> Figures:
    """Fifty robots that are killed and start again, one after the other."""
    build()
    waiting, delays = listener(98, "", LOOPBACK), list[float]()
    for k in range(RESTARTS):
        one = robot(98)
        delays.append(delay(waiting, k + 1 - delays.count(float("inf")), one))
        one.end()
    waiting.end()
    known = [s for s in delays if s != float("inf")]
    return {"lost": RESTARTS - len(known), "median_s": sorted(known)[len(known) // 2], "longest_s": max(known)}


if __name__ == "__main__":
    listen(*sys.argv[sys.argv.index("--listen") + 1 :])
