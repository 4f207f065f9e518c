"""`--prior-map`, `--pose` and `--pose-sigma`: what works, and what ends in one line."""

import tomllib
from pathlib import Path

import pytest

import sixthsense as ss
from sixthsense import cli

pytestmark = pytest.mark.usefixtures("compiled", "here")

SHORT = ("--task", "tour", "--max-time", "6")


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short tour of the rectangle."""
    folder = tmp_path_factory.mktemp("earlier") / "first"
    ss.run("rectangle", task="tour", max_time=12.0, seed=1, progress=False, out=folder)
    return folder


def test_a_run_begins_with_the_map_and_the_next_with_its_map(first, here, capsys):
    rough = ("--pose", "-1.38", "-0.41", "0.01", "--pose-sigma", "0.02", "0.02", "0.01")
    assert cli.main(["run", "rectangle", *SHORT, "--prior-map", str(first), *rough, "--out", "second"]) == cli.DONE
    assert cli.main(["run", "rectangle", *SHORT, "--prior-map", "second", "--out", "third"]) == cli.DONE
    capsys.readouterr()
    note = tomllib.loads((here / "second" / "config.toml").read_text())["prior_map"]
    assert note["name"] == "first" and len(note["digest"]) == 64
    assert note["pose"] == [-1.38, -0.41, 0.01] and note["pose_sigma"] == [0.02, 0.02, 0.01]
    for name in ("config.toml", "record.mcap", "metrics.json"):
        assert str(first.parent).encode() not in (here / "second" / name).read_bytes()
    third = ss.load("third")
    assert third.trace.prior_map["name"] == "second" and "pose" not in third.trace.prior_map
    ids = [ss.load(folder).trace.final.ids.tolist() for folder in (first, here / "third")]
    assert set(ids[0]) <= set(ids[1])


def test_a_configuration_of_a_run_with_a_map_is_repeated_with_one(first, here, complaint):
    assert cli.main(["run", "rectangle", *SHORT, "--prior-map", str(first), "--out", "second"]) == cli.DONE
    line = complaint("run", "--config", "second/config.toml")
    assert line.startswith("--config: second/config.toml is of a run with a prior map, allowed: with --prior-map")
    assert cli.main(["run", "--config", "second/config.toml", "--prior-map", str(first), "--out", "one"]) == cli.DONE
    for file in ("estimate.tum", "landmarks.csv"):
        assert (here / "one" / file).read_bytes() == (here / "second" / file).read_bytes()
