"""The commands `live` and `simulate` with each other: two processes, in real time, on this machine's network."""

import json
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from processes import start, wait_until

import sixthsense as ss
from sixthsense.cli import main
from sixthsense.live.network import Network, Node
from sixthsense.live.publishing import MAP, POSE, TF, VERDICT
from sixthsense.logs.ros_messages import stamp_ns
from sixthsense.record.folder import has_record, reason_not_a_run
from sixthsense.record.messages import Messages
from sixthsense.running.warmup import warm_up

pytest.importorskip("cyclonedds", reason="needs Cyclone DDS: pip install -e '.[ros2]'")

ODD_ROBOT = """
import threading
import numpy as np
import sixthsense.live.simulated as simulated
from sixthsense.live.reading import TWIST_STAMPED

class OddWriter:
    def __init__(self, writer):
        self.writer, self.rng = writer, np.random.default_rng(1)

    def send(self, data):
        late, lost, twice, by = self.rng.random(4)
        for _ in range(0 if lost < 0.05 else 2 if twice < 0.1 else 1):
            threading.Timer(0.5 * by if late < 0.2 else 0.0, self.writer.send, [data]).start()

simulated.CMD_VEL = simulated.CMD_VEL._replace(type=TWIST_STAMPED)

class OddRobot(simulated.SimulatedRobot):
    def begin(self, truth):
        super().begin(truth)
        self._scans = OddWriter(self._scans)

simulated.SimulatedRobot = OddRobot
"""
"""before a command: its robot takes TwistStamped, and its scans come late, not at all, and twice"""
PARTS = Path(__file__).parents[2] / "docs" / "howto" / "parts"
DOMAIN = str(20 + os.getpid() % 40)
TRUTH = ("--seed", "1", "--truth", "truth.tum")
DRIVE = ("--drive", "--task", "tour", "--tour", *("1.4", "0.4", "-1.4", "-0.4") * 20)


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def _compiled() -> None:
    warm_up()
    warm_up("scan-matching")


@contextmanager
def process(*words: str, program: str = "") -> Iterator[subprocess.Popen[str]]:
    """A command on the tests' domain, killed at the end of the block if it still runs."""
    started = start(*words, "--domain", DOMAIN, program=program)
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


def truth_of(file: Path) -> np.ndarray:
    lines = file.read_text().splitlines(keepends=True) if file.exists() else []
    rows = [list(map(float, line.split())) for line in lines if line.endswith("\n")]
    return np.array(rows).reshape(-1, 8)


def heard(live: subprocess.Popen[str]) -> dict[str, list[Any]]:
    """What a live run publishes until it ends, by topic."""
    make, found = Messages(), {topic.name: [] for topic in (MAP, POSE, TF, VERDICT)}
    with Node(Network(int(DOMAIN))) as node:
        readers = [node.reader(topic) for topic in (MAP, POSE, TF, VERDICT)]
        while live.poll() is None:
            node.wait(0.05)
            for one in readers:
                found[one.topic.name] += [make.store.deserialize_cdr(data, one.topic.type) for data in one.take()]
    return found


def test_a_live_run_maps_with_late_lost_and_doubled_scans_and_its_record_replays_it(here, _compiled):
    with (
        process(
            *["simulate", "rectangle", "--task", "tour", "--seed", "1", "--max-time", "300", "--truth", "truth.tum"],
            program=ODD_ROBOT,
        ),
        process("live", "--out", "x", "--max-time", "8") as live,
    ):
        published = heard(live)
        out, err = live.communicate(timeout=240)
    assert live.returncode == 0 and "written to x/" in out
    assert "dropped: scan" in err and "scan twice" in err
    trace = ss.load(here / "x").trace
    assert trace.outcome == "time is up" and len(trace.stamps_ns) > 40
    by_stamp = dict(zip(trace.stamps_ns, trace.estimates, strict=True))
    at = [(tuple(by_stamp[stamp_ns(one)][:2]), one.pose.pose.position) for one in published["/pose"]]
    assert len(at) > 20 and len(published["/tf"]) > 20 and all(pose == (p.x, p.y) for pose, p in at)
    assert set(np.unique(published["/map"][-1].data)) == {-1, 0, 100}
    told = [status.level for message in published["/diagnostics"] for status in message.status]
    assert 5 <= len(told) <= 10 and set(told) == {0}  # once a second
    truth = truth_of(here / "truth.tum")
    rows = truth[np.searchsorted(truth[:, 0], np.array(trace.stamps_ns) / 1e9 - 1e-3)]
    true_poses = [ss.Pose(x, y, 2.0 * np.arctan2(z, w)) for _, x, y, _, _, _, z, w in rows]
    # The map begins as the frame of the odometry, which has been drifting since the robot drives.
    T_truth_map = true_poses[0] @ ss.Pose(*trace.estimates[0]).inverse()
    found = [T_truth_map @ ss.Pose(*row) for row in trace.estimates]
    assert max(np.hypot(*(a.position - b.position)) for a, b in zip(found, true_poses, strict=True)) < 0.1
    again = ss.replay("x", progress=False)
    np.testing.assert_array_equal(np.array(again.trace.estimates), np.array(trace.estimates))


@pytest.mark.parametrize(
    ("name", "code", "outcome", "estimator"),
    [("SIGTERM", 143, "interrupted", "ekf"), ("SIGINT", 0, "ended by the user", "fading:Fading")],
)
def test_a_signal_stops_the_robot_and_the_record_is_kept(name, code, outcome, estimator, here, _compiled):
    shutil.copy(PARTS / "fading.py", here)  # an estimator of a user's own
    with (
        process("simulate", "rectangle", *TRUTH, program=ODD_ROBOT) as robot,
        process("live", "--out", "x", "--estimator", estimator, *DRIVE) as live,
    ):
        wait_until(lambda: has_record(here / "x.partial"))
        wait_until(lambda: len(np.unique(truth_of(here / "truth.tum")[:, 1:], axis=0)) > 5)
        live.send_signal(getattr(signal, name))
        out, _ = live.communicate(timeout=120)
        assert live.returncode == code and out.endswith("written to x/\n")
        time.sleep(0.5)
        standing = truth_of(here / "truth.tum")[-1, 1:]
        time.sleep(0.5)
        np.testing.assert_array_equal(truth_of(here / "truth.tum")[-1, 1:], standing)
        robot.terminate()
        said, _ = robot.communicate(timeout=60)
        assert robot.returncode == 143 and "collisions: 0" in said
    assert reason_not_a_run(here / "x") == ""
    assert json.loads((here / "x" / "metrics.json").read_text())["outcome"] == outcome
    assert ss.load(here / "x").trace.config.estimator == estimator


def test_a_robot_whose_driver_is_killed_stands_within_its_timeout_and_is_alone(here, _compiled, capsys):
    with process("simulate", "rectangle", *TRUTH), process("live", "--out", "x", *DRIVE) as live:
        wait_until(lambda: len(np.unique(truth_of(here / "truth.tum")[:, 1:], axis=0)) > 5)
        live.kill()
        killed_s = time.time()
        assert main(("simulate", "rectangle", "--domain", DOMAIN)) == 2
        assert "/scan: found another publisher, allowed: one robot" in capsys.readouterr().err
    truth = truth_of(here / "truth.tum")
    moves = np.any(np.diff(truth[:, 1:], axis=0) != 0.0, axis=1)
    assert truth[1:, 0][moves].max() - killed_s < 0.5
