"""Parts of a user's own, one file in a folder: in a call, on the command line, in a campaign, replayed, compared."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import sixthsense as ss
from sixthsense import cli, testing
from sixthsense.config.errors import PartError

PAGES = Path(__file__).parents[2] / "docs" / "howto" / "parts"
EXAMPLES = [file for file in PAGES.glob("*.py") if file.name != "ros_node.py"]
"""all but the node, which is a robot's own program and no part"""
SHORT = {"task": "tour", "max_time": 2.0, "progress": False}
PROGRAM = "import sys; from sixthsense.cli import main; sys.exit(main())"


@pytest.fixture
def lab(tmp_path, monkeypatch):
    """A folder with the example files as modules, which is the working folder."""
    for file in PAGES.glob("*.py"):
        (tmp_path / file.name).write_text(file.read_text())
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    yield tmp_path
    for file in PAGES.glob("*.py"):
        sys.modules.pop(file.stem, None)


def sixthsense(*words):
    done = subprocess.run([sys.executable, "-c", PROGRAM, *words], capture_output=True, text=True, check=False)
    return done.returncode, done.stdout, done.stderr


def test_an_estimator_of_one_file_is_checked_run_replayed_compared_and_sent_to_the_workers_of_a_campaign(lab):
    from fading import Fading

    assert testing.check_estimator(Fading).kept
    run = ss.run("rectangle", estimator=Fading, estimator_options=Fading.Options(gain=1.5), out="called", **SHORT)
    assert run.trace.config.estimator == "fading:Fading" and run.trace.config.estimator_options == {"gain": 1.5}
    words = ("--estimator", "fading:Fading", "--estimator-options.gain", "1.5", "--task", "tour", "--max-time", "2")
    code, _, err = sixthsense("run", "rectangle", *words, "--out", "said")
    assert code == cli.DONE, err
    Path("own.toml").write_text('estimator = "fading:Fading"\n[estimator_options]\ngain = 1.5\n')
    assert cli.main(["run", "rectangle", "--config", "own.toml", *words[4:], "--out", "read"]) == cli.DONE
    for folder in ("said", "read"):
        assert (lab / folder / "estimate.tum").read_bytes() == (lab / "called" / "estimate.tum").read_bytes()
        assert ss.load(folder).trace.config == run.trace.config
    assert cli.main(["replay", "called", "--out", "again"]) == cli.DONE
    assert (lab / "again" / "estimate.tum").read_bytes() == (lab / "called" / "estimate.tum").read_bytes()
    fields = {"estimator": [Fading, "ekf"], "estimator_options": {"gain": 1.5}, "task": "tour", "max_time": 1.0}
    done = ss.campaign("rectangle", seeds=range(2), workers=1, out="many", progress=False, **fields)
    frame = done.frame()
    assert len(frame) == 4 and (frame["outcome"] == "tour ended").all(), frame["outcome"].unique()
    assert {sample.config.estimator for sample in ss.compare(done).samples} == {"fading:Fading", "ekf"}
    assert set(frame["estimator"]) == {"fading:Fading", "ekf"} and "fading:Fading" in str(done)


BREACHES = {
    "estimator": ("from sixthsense.slam.estimators.ekf import EKF\n\n\nclass Bad(EKF):\n"
                  "    def trajectory(self): t = super().trajectory(); return t if len(t) < 4 else t[:, :2]\n",
                  {"task": "tour"}, r"trajectory\(\) has shape \(\d, 2\), allowed \(None, 3\)"),
    "planner": ("import numpy as np, sixthsense as ss\n\n\nclass Bad:\n    def __init__(self, rng): pass\n"
                "    def plan(self, space, start, goal): return ss.Plan('found', np.ones((2, 3)), 0.0, 0, 0.0)\n",
                {"task": "goal", "goal": (1.4, 0.5)}, r"plan: path_world has shape \(2, 3\)"),
    "explorer": ("class Bad:\n    def __init__(self, rng): pass\n"
                 "    def next_target(self, view): return view.pose\n",
                 {"laser": {"max_range": 2.0}}, "next_target: found a Pose, allowed: a Target"),
    "front_end": ("from sixthsense.core.motion import STANDSTILL\n\n\nclass Bad:\n"
                  "    def __init__(self, setup): self.pose, self.since = setup.start, STANDSTILL\n"
                  "    def take(self, evidence): return evidence.scan.ranges[3]\n"
                  "    def finish(self): pass\n",
                  {"task": "tour"}, "take: found a float32, allowed: a Keyframe"),
}  # fmt: skip
"""of each kind one that breaks its contract, a run, and what is said of it"""


@pytest.mark.parametrize("kind", BREACHES)
def test_a_part_that_breaks_its_contract_is_named_in_the_run(kind, lab):
    body, task, said = BREACHES[kind]
    (lab / f"bad_{kind}.py").write_text(body)
    with pytest.raises(PartError) as caught:
        ss.run("rectangle", max_time=5.0, progress=False, **{kind: f"bad_{kind}:Bad"}, **task)
    error = caught.value
    assert error.part == f"{kind} bad_{kind}:Bad" and re.search(said, error.found), error
    assert re.fullmatch(r"after keyframe -?\d, at \d+\.\d\d s", error.when)


OWN = ("--estimator", "fading:Fading")


@pytest.mark.parametrize(("words", "said"), [
    (("--estimator", "fadin:Fading"), "--estimator: found fadin:Fading, which cannot be imported .*'fadin'"),
    (("--estimator", "fading:Fadin"), "--estimator: found fading:Fadin, which cannot be imported .*'Fadin'"),
    (("--estimator-options.gain", "2"), "--estimator-options.gain: no such field"),
    ((*OWN, "--estimator-options.gian", "2"), "--estimator-options.gian: no such field, did you mean gain"),
    ((*OWN, "--estimator-options.gain", "x"), "--estimator-options.gain: found 'x', allowed: a finite number"),
])  # fmt: skip
def test_a_wrong_part_or_option_is_one_line(words, said, lab, capsys):
    assert cli.main(["run", "rectangle", *words, "--out", "no"]) == cli.BAD_INPUT
    err = capsys.readouterr().err
    assert re.search(said, err) and err.count("\n") == 1
    assert not Path("no").exists() and not Path("no.partial").exists()


FAILS = """\
from sixthsense.slam.estimators.ekf import EKF


class Bad(EKF):
    def update(self, observations):
        super().update(observations)
        1 / (len(self.trajectory()) < 4)
"""


def test_a_part_that_fails_is_named_with_keyframe_and_time_and_the_record_is_whole_up_to_there(lab):
    (lab / "fails.py").write_text(FAILS)
    with pytest.raises(PartError) as caught:
        ss.run("rectangle", estimator="fails:Bad", out="bad", task="tour", max_time=20.0, progress=False)
    error = caught.value
    assert error.part == "estimator fails:Bad"
    assert re.search(r"update raised ZeroDivisionError in line \d+ \(division by zero\)", error.found), error
    assert re.fullmatch(r"after keyframe \d, at \d+\.\d\d s", error.when)
    assert error.__notes__ == ["the record so far is in bad.partial"]
    keyframe = int(error.when.split()[2].rstrip(","))
    assert 2 <= keyframe <= 4 and len(ss.load("bad.partial").trace.key_stamps_ns) >= keyframe


def test_the_parts_that_can_be_replaced_are_listed(capsys):
    assert cli.main(["parts"]) == cli.DONE
    said = capsys.readouterr().out
    assert "--estimator (contract: sixthsense.slam.estimators.base:Estimator" in said and "isam2" in said
    assert "  branch-and-bound  sixthsense.slam.scans.place_search:BranchAndBound\n" in said
