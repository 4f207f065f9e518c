"""Live runs beside Fast DDS: who is found how soon, gaps of /pose beside a large map, restarts, memory.

The robot is that of `tests/interop`. Networks beside the loopback are two network namespaces, which need root. Six
minutes and those of `--minutes`; `--only found,pose,beams,restarts,memory` chooses parts.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from sixthsense.live.maps import MAP
from sixthsense.live.network import LOOPBACK, Network, Node
from sixthsense.live.reading import TWIST
from sixthsense.live.simulated import SCAN, cmd_vel
from sixthsense.live.topics import SENSOR
from sixthsense.record.messages import Messages

PROGRAM = "import sys; from sixthsense.cli import main; sys.exit(main())"
PEER = Path("runs/interop/peer")
APART_S = 36.0  # more than the 30 s after which Cyclone DDS by itself forgets peers
LOST_S = 20.0
SIDES = {"a": ("10.77.0.1", "10.78.0.1"), "b": ("10.77.0.2", "10.78.0.2")}
HALL_M = 200.0


def listen(domain: str, interfaces: str, peers: str) -> None:
    """Print the time of joining, and that at which each publisher of scans is heard first, once it hears this program.

    That is so when it takes the map that is offered.
    """
    network = Network(int(domain), tuple(interfaces.split(",")), tuple(filter(None, peers.split(","))))
    with Node(network) as node:
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


def listener(domain: int, namespace: str, interfaces: str, peers: str) -> Program:
    found = Program([sys.executable, __file__, "--listen", str(domain), interfaces, peers], namespace)
    assert found.line(0, 200.0) is not None, "the network cannot be joined"
    return found


def delay(of: Program, number: int, robot: Program) -> float:
    """Seconds from when both have joined to a line."""
    line = of.line(number)
    return float("inf") if line is None else float(line) - max(float(of.lines[0]), float(robot.lines[0]))


def found_in(domain: int, namespaces: tuple[str, str], interfaces: str, peers: str) -> list[float]:
    """Seconds until both have found each other: listener first, robot again, listener again, robot first."""
    ours, theirs = namespaces
    first = listener(domain, ours, interfaces, peers)
    time.sleep(APART_S)
    one = robot(domain, theirs)
    delays = [delay(first, 1, one)]
    one.end()
    two = robot(domain, theirs)
    delays.append(delay(first, 2, two))
    first.end()
    second = listener(domain, ours, interfaces, peers)
    delays.append(delay(second, 1, two))
    two.end()
    second.end()
    three = robot(domain, theirs)
    time.sleep(APART_S)
    third = listener(domain, ours, interfaces, peers)
    delays.append(delay(third, 1, three))
    three.end()
    third.end()
    return delays


@contextlib.contextmanager
def namespaces() -> Iterator[None]:
    """Two network namespaces with two cables between them."""

    def ip(words: str) -> None:
        subprocess.run(["ip", *words.split()], check=True)

    names = {side: f"sixthsense-{side}" for side in SIDES}
    try:
        for name in names.values():
            ip(f"netns add {name}")
            ip(f"-n {name} link set lo up")
        for k in range(2):
            ip(f"link add cable{k}a netns {names['a']} type veth peer name cable{k}b netns {names['b']}")
            for side, name in names.items():
                ip(f"-n {name} address add {SIDES[side][k]}/24 dev cable{k}{side}")
                ip(f"-n {name} link set cable{k}{side} up")
                if k == 0:
                    ip(f"-n {name} route add 239.0.0.0/8 dev cable0{side}")
        yield
    finally:
        for name in names.values():
            subprocess.run(["ip", "netns", "delete", name], check=False)


def found() -> None:
    cases = {
        "loopback": (("", ""), LOOPBACK, ""),
        "one interface": (("a", "b"), "cable0a", ""),
        "several interfaces": (("a", "b"), "cable0a,cable1a", ""),
        "one interface and peers": (("a", "b"), "cable0a", SIDES["b"][0]),
        "peers of a network without multicast": (("a", "b"), "cable1a", SIDES["b"][1]),
    }
    delays: dict[str, list[float]] = {}
    with namespaces():
        for side in SIDES:  # the second cable carries no multicast
            words = f"ip -n sixthsense-{side} link set cable1{side} multicast off"
            subprocess.run(words.split(), check=True)
        threads = [
            threading.Thread(target=lambda n=name, k=k, of=of: delays.update({n: found_in(90 + k, *of)}))
            for k, (name, of) in enumerate(cases.items())
        ]
        for thread in threads:
            thread.start()
            time.sleep(3.0)  # so that not all of them start programs at once
        for thread in threads:
            thread.join()
    print("| seconds until both have found each other | `live` first | robot again | `live` again | robot first |")
    print("| --- | --- | --- | --- | --- |")
    for name in cases:
        print(f"| {name} | {' | '.join(f'{s:.1f}' for s in delays.get(name, []))} |")


def live(domain: int, folder: Path, seconds: float, *more: str) -> Program:
    words = ["--domain", str(domain), "--out", str(folder / "run"), "--max-time", str(seconds), *more]
    return Program([sys.executable, "-c", PROGRAM, "live", *words])


def pose_gaps(folder: Path) -> None:
    """The gaps of /pose, where every scan sees all of a hall."""
    half = HALL_M / 2.0
    corners = [[-half, -half], [half, -half], [half, half], [-half, half]]
    pillars = [[[x, y], [x + 2.1, y + 0.3], [x + 1.7, y + 2.6]] for x in range(-81, 90, 33) for y in range(-73, 90, 29)]
    scene = folder / "hall.toml"
    tables = "".join(f"[[polygons]]\npoints = {points}\n" for points in (corners, *pillars))
    scene.write_text(f"start = [3.3, -9.2, 0.4]\nradius = 0.15\n{tables}")
    laser = ["--laser.beams", "720", "--laser.max-range", "120"]
    words = ["simulate", str(scene), "--domain", "97", "--max-time", "200", "--timeout", "9", *laser]
    simulated = Program([sys.executable, "-c", PROGRAM, *words])
    words = [str(PEER), "--domain", "97", "--listen", "--seconds", "9999"]
    heard, poses = Program(words), Program([*words, "--no-map"])  # who takes 40 MB apart hears nothing meanwhile
    run = live(97, folder, 60.0)
    with Node(Network(97)) as node:  # the robot drives a circle; by itself it would map the hall, too
        commands, make = node.writer(cmd_vel()), Messages()
        while run.process.poll() is None:
            commands.send(make.serialized(make.twist(0.3, 0.2), TWIST))
            time.sleep(1.0)
    for one in (heard, poses):
        one.end(signal.SIGTERM)
    simulated.end()
    told = json.loads(heard.lines[-1])
    whole, part = (told.get(topic, {}).get("count", 0) for topic in ("/map", "/map_updates"))
    sent = f"{told['map_bytes'] / 1e6:.1f} MB, {whole} times whole and {part} times in part"
    heard_gaps = gaps(json.loads(poses.lines[-1]))
    print(f"/pose beside the map of a hall of {HALL_M**2:,.0f} m² ({sent}), scans at 10 Hz: {heard_gaps}")


def many_beams(folder: Path) -> None:
    """The gaps of /pose beside a laser of many beams that scans fast."""
    one = robot(96, "", "--beams", "3600", "--hz", "20")
    live(96, folder, 40.0).process.wait()
    one.end(signal.SIGTERM)
    print(f"/pose with 3,600 beams, scans at 20 Hz: {gaps(json.loads(one.lines[-1]))}")


def gaps(told: dict[str, dict[str, float]]) -> str:
    pose = told["/pose"]
    return f"{pose['count']} poses, gap p99 {pose['gap_p99_s']:.3f} s, largest {pose['gap_max_s']:.3f} s"


def restarts(times: int) -> None:
    """Robots that are killed and start again, one after the other."""
    waiting, delays = listener(98, "", LOOPBACK, ""), []
    for k in range(times):
        one = robot(98)
        delays.append(delay(waiting, k + 1 - delays.count(float("inf")), one))
        one.end()
    waiting.end()
    lost = delays.count(float("inf"))
    median_s = sorted(delays)[times // 2]
    print(f"{times} restarts of the robot: {lost} lost, found within {max(delays):.1f} s, median {median_s:.1f} s")


def memory(folder: Path, minutes: Sequence[float]) -> None:
    """Memory of a run at 10 Hz after some times."""
    one = robot(99)
    run = live(99, folder / "long", 60.0 * minutes[-1] + 5.0)
    while not (folder / "long" / "run.partial").exists():
        time.sleep(0.1)
    began_s, found = time.monotonic(), []
    for at in minutes:
        time.sleep(max(0.0, began_s + 60.0 * at - time.monotonic()))
        pids = subprocess.run(["pgrep", "-P", str(run.process.pid)], capture_output=True, text=True).stdout.split()
        found.append(sum(resident_mb(int(pid)) for pid in (run.process.pid, *pids)))
    run.process.wait()
    one.end()
    told = ", ".join(f"{mb:.0f} MB after {at:g} min" for at, mb in zip(minutes, found, strict=True))
    print(f"memory of `live` and the process of its map: {told}")


def resident_mb(pid: int) -> float:
    status = Path(f"/proc/{pid}/status").read_text()
    return int(status.split("VmRSS:")[1].split()[0]) / 1024.0


def main() -> None:
    if "--listen" in sys.argv:
        listen(*sys.argv[sys.argv.index("--listen") + 1 :])
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", default="found,pose,beams,restarts,memory")
    parser.add_argument("--minutes", type=float, nargs="+", default=[3.0, 15.0])
    parser.add_argument("--times", type=int, default=50)
    options = parser.parse_args()
    subprocess.run(["tests/interop/build.sh", str(PEER.parent)], check=True)
    with tempfile.TemporaryDirectory() as name:
        folder, parts = Path(name), options.only.split(",")
        for part in ("long", "beams"):
            (folder / part).mkdir()
        print(f"load of {os.cpu_count()} processors before: {os.getloadavg()[0]:.1f}")
        lasting = threading.Thread(target=memory, args=(folder, options.minutes))
        if "found" in parts:
            found()
        if "pose" in parts:
            pose_gaps(folder)
        if "beams" in parts:
            many_beams(folder / "beams")
        if "memory" in parts:
            lasting.start()
        if "restarts" in parts:
            restarts(options.times)
        if lasting.ident is not None:
            lasting.join()
        print(f"load after: {os.getloadavg()[0]:.1f}")


if __name__ == "__main__":
    main()
