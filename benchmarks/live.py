"""A live run with a simulated robot, two processes in real time on the loopback: `tour`, `drive`, `stop` or `long`.

tour: ATE with scans late, lost and doubled, as a multiple of that of the same seed undisturbed, and the time from a
scan to its published pose. drive: exploration by commands. stop: how long the robot drives on when either process is
killed. long: memory of a long run. Wall times are those of a machine that does nothing else; of `tour`, the processor
time per scan of a replay of the record does not depend on that.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from harness import Figures, arguments, print_figures, write_json
from numpy.typing import NDArray

import sixthsense as ss
from sixthsense.config import preset
from sixthsense.core.geometry import Array
from sixthsense.core.source import Tick
from sixthsense.evaluation.metrics import ate
from sixthsense.live.network import Network, Node
from sixthsense.live.notices import Notices
from sixthsense.live.publishing import MAP, POSE, TF, Publisher
from sixthsense.live.reading import LaserReader, MessageReader
from sixthsense.live.robot import LiveRobot
from sixthsense.live.simulated import SCAN
from sixthsense.live.topics import SENSOR
from sixthsense.record.messages import Messages
from sixthsense.record.trace import Trace
from sixthsense.sources.logs.ros_messages import LASER_SCAN, stamp_ns

PROGRAM = "import sys; from sixthsense.cli import main; sys.exit(main())"
DISTURBED = ("--late", "0.2", "--lost", "0.05", "--twice", "0.01")
REGIONS = {"apartment": ("0", "0", "14", "9"), "rectangle": ("-2", "-1", "2", "1")}
STOPS = 3
TARGETS = {
    "ate_ratio": "at most 1.25",
    "pose_p99_ms": "at most 30",
    "replay_cpu_p99_ms": "at most 30",
    "collisions": "0",
    "explored": "1",
    "stop_live_killed_s": "at most 0.5",
    "stop_robot_killed_s": "at most 0.5",
}


@contextmanager
def process(*words: str, is_heard: bool = False) -> Iterator[subprocess.Popen[str]]:
    """A command of the package, killed at the end of the block if it still runs."""
    piped = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE if is_heard else None, "text": True}
    started = subprocess.Popen([sys.executable, "-c", PROGRAM, *words], **piped)
    try:
        yield started
    finally:
        started.kill()
        started.wait()


def read_truth(file: Path) -> Array:
    """(N, 4): stamp in seconds, x, y, theta."""
    rows = [
        list(map(float, line.split())) for line in file.read_text().splitlines(keepends=True) if line.endswith("\n")
    ]
    return np.array([[t, x, y, 2.0 * np.arctan2(z, w)] for t, x, y, _, _, _, z, w in rows])


def live_ate(folder: Path, truth: Array) -> float:
    """ATE of the poses published at each scan, by the truth at the same stamps.

    The frames are aligned by least squares: the map begins as the frame of the odometry, which has drifted by then.
    """
    trace = ss.load(folder).trace
    stamps = np.array(trace.stamps_ns) / 1e9
    at = np.stack([np.interp(stamps, truth[:, 0], truth[:, k]) for k in (1, 2)], axis=1)
    return ate(aligned(np.array(trace.estimates)[:, :2], at), at)[0]


def aligned(points: Array, others: Array) -> Array:
    """(N, 2) points after the rigid motion that brings them nearest to others (Arun, Huang and Blostein 1987)."""
    centred, other_centred = points - points.mean(axis=0), others - others.mean(axis=0)
    u, _, vt = np.linalg.svd(centred.T @ other_centred)
    turn = np.diag([1.0, np.linalg.det(u @ vt)])
    return centred @ u @ turn @ vt + others.mean(axis=0)


def pose_delays(node: Node, live: subprocess.Popen[str]) -> Array:
    """Milliseconds from the arrival of each scan to that of its pose, until the live run ends."""
    scans, poses = node.reader(SCAN._replace(quality=SENSOR)), node.reader(POSE)
    reader, store = MessageReader(), Messages().store
    sent: dict[int, float] = {}
    delays = []
    while live.poll() is None:
        node.wait(0.05)
        now = time.monotonic()
        for data in scans.take():
            sent.setdefault(stamp_ns(reader.read(data, LASER_SCAN)), now)
        for data in poses.take():
            began = sent.pop(stamp_ns(store.deserialize_cdr(data, POSE.type)), None)
            if began is not None:
                delays.append(1e3 * (now - began))
    return np.array(delays)


def replay_cpu(folder: Path, domain: int) -> Array:
    """Processor milliseconds from one scan to the next in a replay of the record that publishes as a live run does."""
    times = []

    def publish(tick: Tick, trace: Trace) -> None:
        publisher(tick, trace)
        if tick.scan is not None:
            times.append(time.process_time())

    reader = MessageReader()
    with Node(Network(domain)) as node:
        listeners = [node.reader(topic) for topic in (POSE, TF, MAP)]
        trace = Trace(preset("log"), None, 0.2)
        robot = LiveRobot(lambda _: (), reader, LaserReader(reader, None, None), Notices(print), trace)
        publisher = Publisher(node, robot)
        ss.replay(folder, on_tick=publish, progress=False)
        assert all(listener.take() for listener in listeners)
    return 1e3 * np.diff(times)[1:]


def tour(scene: str, seed: int, seconds: float, domain: int) -> Figures:
    """The pair of runs, and the delay of the disturbed one."""
    errors, figures = [], {}
    with tempfile.TemporaryDirectory() as folder:
        for k, disturbance in enumerate(((), DISTURBED)):
            here, network = Path(folder), ("--domain", str(domain + k))
            truth, out = here / f"truth{k}.tum", here / f"live{k}"
            own = ("--task", "tour", "--seed", str(seed), "--truth", str(truth), "--max-time", str(seconds + 120.0))
            with (
                process("simulate", scene, *own, *disturbance, *network),
                process("live", "--out", str(out), "--max-time", str(seconds), *network) as live,
                Node(Network(domain + k)) as node,
            ):
                delays = pose_delays(node, live)
            errors.append(live_ate(out, read_truth(truth)))
            figures |= {f"scans_{k}": float(len(delays)), f"pose_p50_ms_{k}": float(np.median(delays))}
        figures["pose_p99_ms"] = float(np.percentile(delays, 99.0))
        figures["replay_cpu_p99_ms"] = float(np.percentile(replay_cpu(out, domain), 99.0))
    return figures | {"ate_m": errors[0], "ate_disturbed_m": errors[1], "ate_ratio": errors[1] / errors[0]}


def drive(scene: str, seed: int, seconds: float, domain: int) -> Figures:
    """An exploration by commands."""
    network = ("--domain", str(domain))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "live"
        task = ("--drive", "--region", *REGIONS[scene], "--max-time", str(seconds), "--out", str(out))
        with (
            process("simulate", scene, "--seed", str(seed), *network) as robot,
            process("live", *task, *network) as live,
        ):
            live.wait()
            robot.terminate()
            said = robot.communicate()[0]
        run = ss.load(out)
    return {
        "explored": float(run.outcome == "explored"),
        "time_s": run.metrics["sim_time_s"],
        "collisions": float("collisions: 0" not in said),
        "path_m": run.metrics["path_length_m"],
        "guard_stops": float(run.metrics["guard_stops"]),
    }


def stop(scene: str, seed: int, domain: int) -> Figures:
    """Seconds that the robot drives on after `live` is killed, and that `live` commands it on after the robot is.

    The longest of some times. The robot alone may subscribe to its commands: when they stop is what `live` says.
    """
    figures: Figures = dict.fromkeys(("stop_live_killed_s", "stop_robot_killed_s"), 0.0)
    network = ("--domain", str(domain))
    command = ("live", "--drive", "--region", *REGIONS[scene], *network)
    for killed in ("live", "robot") * STOPS:
        with tempfile.TemporaryDirectory() as folder:
            truth, out = Path(folder) / "truth.tum", Path(folder) / "live"
            with (
                process("simulate", scene, "--seed", str(seed), "--truth", str(truth), *network) as robot,
                process(*command, "--out", str(out), is_heard=True) as live,
            ):
                while not truth.exists() or moves(read_truth(truth)).sum() < 20:
                    time.sleep(0.1)
                (live if killed == "live" else robot).kill()
                at, killed_s = time.time(), time.monotonic()
                if killed == "live":
                    time.sleep(2.0)
                else:
                    assert live.stderr is not None
                    next(line for line in live.stderr if "the robot is stopped" in line)
                stopped_s = time.monotonic() - killed_s
            rows = read_truth(truth)
            figure = f"stop_{killed}_killed_s"
            moved_s = rows[1:, 0][moves(rows)][-1] - at if killed == "live" else stopped_s
            figures[figure] = max(figures[figure], moved_s)
    return figures


def moves(rows: Array) -> NDArray[np.bool_]:
    """(N - 1,) whether a robot moved between two rows of its trajectory."""
    return np.any(np.diff(rows[:, 1:], axis=0) != 0.0, axis=1) if len(rows) else np.zeros(0, dtype=np.bool_)


def memory_mb(pid: int) -> float:
    """Resident memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def long(scene: str, seed: int, seconds: float, domain: int) -> Figures:
    """Memory of a live run, a tenth of its time apart."""
    network = ("--domain", str(domain))
    with tempfile.TemporaryDirectory() as folder:
        out, rows = Path(folder) / "live", []
        own = ("--task", "tour", "--seed", str(seed), "--max-time", str(seconds + 300.0))
        with (
            process("simulate", scene, *own, *DISTURBED, *network),
            process("live", "--out", str(out), "--max-time", str(seconds), *network) as live,
        ):
            while live.poll() is None:
                time.sleep(min(10.0, seconds / 10.0))
                if live.poll() is None and (out.parent / "live.partial" / "record.jsonl").exists():
                    rows.append(memory_mb(live.pid))
                    print(f"{10 * len(rows)} s: {rows[-1]:.0f} MB", flush=True)
    tenth = max(1, len(rows) // 10)
    return {f"memory_{k}_mb": row for k, row in enumerate(rows[tenth - 1 :: tenth])}


def main() -> None:
    parser = arguments(__doc__)
    parser.add_argument("case", choices=("tour", "drive", "stop", "long"))
    parser.add_argument("--scene", default="apartment", choices=tuple(REGIONS))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=180.0, help="of each live run")
    parser.add_argument("--domain", type=int, default=70, help="of the network; the next one is used, too")
    options = parser.parse_args()
    given = options.scene, options.seed
    if options.case == "stop":
        figures = stop(*given, options.domain)
    else:
        figures = {"tour": tour, "drive": drive, "long": long}[options.case](*given, options.seconds, options.domain)
    print_figures(figures, TARGETS)
    write_json(options.json, figures)


if __name__ == "__main__":
    main()
