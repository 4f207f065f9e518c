"""Live runs with a robot on Fast DDS, in C++ on Debian's libfastrtps-dev: `make interop`, not part of CI."""

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from processes import start

HERE = Path(__file__).parent
FOLDER = HERE.parents[1] / "runs" / "interop"
LACKING = [name for name in ("fastddsgen", "g++") if shutil.which(name) is None]
LACKING += [] if Path("/usr/include/fastrtps").exists() else ["libfastrtps-dev"]
DOMAIN = str(140 + os.getpid() % 40)

pytestmark = pytest.mark.skipif(bool(LACKING), reason=f"not installed: {', '.join(LACKING)}")


@pytest.fixture(scope="module")
def peer() -> Path:
    subprocess.run([str(HERE / "build.sh"), str(FOLDER)], check=True)
    return FOLDER / "peer"


@contextmanager
def robot(peer: Path, *words: str) -> Iterator[subprocess.Popen[str]]:
    started = subprocess.Popen(
        [str(peer), "--domain", DOMAIN, "--seconds", "300", *words], stdout=subprocess.PIPE, text=True
    )
    try:
        yield started
    finally:
        started.kill()
        started.communicate()


def told(robot: subprocess.Popen[str]) -> dict[str, Any]:
    """What the robot has heard."""
    robot.terminate()
    out, _ = robot.communicate(timeout=20)
    return json.loads(out.splitlines()[-1])


def live(folder: Path, *words: str) -> subprocess.Popen[str]:
    return start("live", "--domain", DOMAIN, "--out", "x", *words, cwd=folder)


@pytest.mark.parametrize("words", [(), ("--best-effort", "--beams", "3600", "--hz", "5")])
def test_a_robot_is_mapped_and_hears_its_pose_and_its_map(words, peer, tmp_path):
    with robot(peer, *words) as one:
        run = live(tmp_path, "--max-time", "12")
        _, err = run.communicate(timeout=120)
        heard = told(one)
    assert run.returncode == 0 and "assumed" not in err
    assert heard["/pose"]["count"] > 40 and heard["/tf"]["count"] > 40
    assert heard["/map"]["count"] > 0
    assert heard["obstacles"] > 200 and heard["worst_m"] < 0.1


def test_a_robot_is_driven_to_a_place(peer, tmp_path):
    with robot(peer, "--obey") as one:
        run = live(tmp_path, "--drive", "--goal", "1.3", "0.9", "--max-time", "60")
        run.communicate(timeout=120)
        heard = told(one)
    assert run.returncode == 0 and heard["/cmd_vel"]["count"] > 20 and heard["worst_m"] < 0.1


def test_a_run_whose_scans_are_ahead_of_all_odometry_ends_when_its_time_is_up(peer, tmp_path):
    with robot(peer, "--ahead", "5"):
        run = live(tmp_path, "--max-time", "3")
        out, err = run.communicate(timeout=120)
    assert run.returncode == 2 and not out and not list(tmp_path.glob("x*"))
    assert (
        "scan without odometry" in err and "found no scan with odometry after it, allowed: stamps of one clock" in err
    )
