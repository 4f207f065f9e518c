import json
import os
import re
from collections.abc import Callable
from pathlib import Path

import pytest

from sixthsense import cli

pytestmark = pytest.mark.usefixtures("compiled", "here")

# A room of 4 x 4 m with a closet of 1 x 1 m that has no door.
CLOSET = """\
start = [-1.0, -1.0, 0.0]
radius = 0.15
goal = [1.4, 1.4]
region = [-2.0, -2.0, 2.0, 2.0]
walls = [[0.9, 0.9, 2.0, 0.9], [0.9, 0.9, 0.9, 2.0]]
[[polygons]]
points = [[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]]
"""


def entries(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def run(*args: str) -> int:
    return cli.main(["run", *args])


def metrics(folder: Path) -> dict[str, object]:
    values: dict[str, object] = json.loads((folder / "metrics.json").read_text())
    return values


BAD_LINES = [
    ("rn", "command: found 'rn', did you mean run? allowed: run, replay, live, simulate, merge, calibrate, campaign, "),
    ("run nowhere", "scene: found 'nowhere', allowed: apartment, block, campus, loop, office, rectangle, or a file"),
    ("run apartment office", "scene: found 'apartment' and 'office', allowed: one"),
    ("run --laser.beems 3", "--laser.beems: no such option, did you mean --laser.beams? allowed: --laser.beams, "),
    ("run --laser.beams 1", "--laser.beams: found 1, allowed: 2 to 100000"),
    ("run --laser.mount 1 2", "--laser.mount: found too few values, allowed: 3 values"),
    ("run --robot.speed fast", "--robot.speed: found 'fast', allowed: a finite number"),
    ("run --overwrite=3", "--overwrite: found '3', allowed: true or false"),
    ("run --seed", "--seed: found too few values, allowed: one value"),
    ("run --goal 6.05 3", "goal: found (6.05, 3), 0.05 m from a wall, allowed: more than the robot's radius"),
    ("replay", "log: found None, allowed: a file or folder of a log"),
    ("export nowhere", "export: found no format, allowed: --bag, --g2o, --gtsam, --tum or --csv"),
    ("replay x.log --relations missing", "x.log: no such file"),
    ("run --out /proc/nowhere/x", "--out: /proc/nowhere/x.partial cannot be written (No such file or directory)"),
]


@pytest.mark.parametrize(("line", "said"), BAD_LINES, ids=[line for line, _ in BAD_LINES])
def test_a_bad_command_line_ends_in_one_line_that_names_what_was_found_and_what_is_allowed(
    line: str, said: str, here: Path, complaint: Callable[..., str]
) -> None:
    assert said in complaint(*line.split())


TIMED = re.compile(r"wall_time_s|realtime_factor|scan_ms_.*|stage_ms_mean\..*")


def test_a_folders_configuration_repeats_its_run_bit_for_bit(here: Path) -> None:
    (here / "closet.toml").write_text(CLOSET.replace("goal = [1.4, 1.4]", "goal = [0, 1]\ntour = [[0, 1], [1, 0]]"))
    options = ("--preset", "worn", "--task", "tour", "--max-time", "12")
    assert run("closet.toml", *options, "--out", "first") == cli.DONE
    (here / "elsewhere").mkdir()
    os.chdir(here / "elsewhere")
    assert run("--config", "../first/config.toml", "--out", "second") == cli.DONE
    first, second = here / "first", here / "elsewhere" / "second"
    assert entries(first) == entries(second)
    for name in ("config.toml", "estimate.tum", "smoothed.tum", "truth.tum", "landmarks.csv", "map.pgm", "map.yaml"):
        assert (first / name).read_bytes() == (second / name).read_bytes(), name
    one, two = (
        {key: value for key, value in metrics(folder).items() if not TIMED.fullmatch(key)} for folder in (first, second)
    )
    assert one == two
    assert len(one) < len(metrics(first))
