"""Tables: outcome and exit code; command, preset and base configuration; option and field; what beats what."""

import shlex
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from settings import TOGETHER, changed, flat, nested, words

import sixthsense as ss
from sixthsense import cli
from sixthsense.cli.common import Common, show_end
from sixthsense.config import PRESETS, Config, load_config, merge, preset, save_config
from sixthsense.config.errors import InputError

pytestmark = pytest.mark.usefixtures("here")

OUTCOMES = {
    "goal reached": 0, "tour ended": 0, "explored": 0, "explored in part": 0, "log ended": 0, "time is up": 0,
    "ended by the user": 0, "interrupted": 130, "collided": 1, "lost": 1, "stuck": 1, "goal unreachable": 1,
    "out of time": 0, "anything else": 1,
}  # fmt: skip


def ended(outcome: str, level: str | None = None) -> Any:
    verdict = None if level is None else SimpleNamespace(level=level)
    metrics, trace = {"outcome": outcome, "scans": 3, "keyframes": 2}, SimpleNamespace(left=[], config=Config())
    found = {"metrics": metrics, "trace": trace, "folder": Path("a b"), "verdict": verdict}
    return SimpleNamespace(outcome=outcome, summary={"outcome": outcome}, **found)


@pytest.mark.parametrize("outcome", OUTCOMES)
def test_the_exit_code_follows_from_the_outcome(outcome: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert show_end(ended(outcome), Common()) == OUTCOMES[outcome]
    out = capsys.readouterr().out
    assert out.startswith(f"outcome      {outcome}") and out.endswith("written to a b/\n")
    assert "sixthsense report 'a b' writes" in out


@pytest.mark.parametrize(("level", "code"), [("good", 0), ("doubtful", 3), ("broken", 4)])
def test_a_good_end_with_a_doubtful_or_broken_map_has_an_exit_code_of_its_own_only_where_that_is_asked_for(
    level: str, code: int
) -> None:
    assert show_end(ended("tour ended", level), Common(strict=True)) == code
    assert show_end(ended("tour ended", level), Common()) == 0
    assert show_end(ended("stuck", level), Common(strict=True)) == 1


def test_a_field_that_a_summary_names_is_printed_as_an_option(capsys: pytest.CaptureFixture[str]) -> None:
    show_end(ended("if so set `laser.max_range` 3"), Common())
    assert "if so set --laser.max-range 3\n" in capsys.readouterr().out


class CaughtError(InputError):
    """Ends a command where it would begin to work."""


@pytest.fixture
def settings(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Config]:
    """The configuration with which a command line begins to work."""
    import sixthsense.api  # they take the functions before these are replaced
    import sixthsense.running.merging  # noqa: F401

    for name, first in (("a.log", "ODOM "), ("a.graph", "VERTEX2 "), ("a.bag", "#ROSBAG V2.0")):
        Path(name).write_text(f"{first}\n")
    found: list[Config] = []

    def catch(*args: Any, **_: Any) -> None:
        found.append(next(one for one in args if isinstance(one, Config)))
        raise CaughtError("settings", "caught")

    for name in (
        "api.simulate", "logs.replay_input.open_recorded", "live.session.Session",
        "live.simulated.SimulatedRobot", "evaluation.calibrate.calibrate", "running.merging.open_merged",
    ):  # fmt: skip
        monkeypatch.setattr(f"sixthsense.{name}", catch)

    def of(*args: str) -> Config:
        found.clear()
        cli.main([word for arg in args for word in shlex.split(arg)])
        (config,) = found
        return config

    return of


def saved(name: str, config: Config, replayed: Mapping[str, str] | None = None) -> Config:
    """Save a configuration as the folder of a run has it."""
    Path(name).mkdir()
    save_config(config, Path(name) / "config.toml", replayed)
    return config


LIVE = {"scans": {"final_pass": False}}
DRIVEN = LIVE | {"estimator": "ekf-invariant", "front_end": "landmarks", "association": {"proposed_by": "estimate"}}
DRIVE, REGION = "live --drive --region -1 -2 3 4", {"region": (-1.0, -2.0, 3.0, 4.0)}
BASES: dict[str, Config] = {
    "run": preset(),
    "simulate": preset(),
    "replay a.log": preset("log"),
    "replay a.bag": preset("log"),
    "replay a.graph": preset("victoria"),
    "replay robots": preset("mrclam"),
    "replay first": preset("report", seed=3),
    "merge first second": preset("report", seed=3),
    "live": preset("log", **LIVE),
    "live --drive=false": preset("log", **LIVE),
    DRIVE: merge(preset("log"), DRIVEN | REGION),
}


@pytest.mark.parametrize("line", BASES)
def test_each_command_begins_with_its_base(line: str, settings: Callable[..., Config]) -> None:
    saved("first", preset("report", seed=3))
    saved("second", preset("worn", seed=4))
    Path("robots").mkdir()
    Path("robots/Robot1_Odometry.dat").touch()
    assert settings(line) == BASES[line]
    assert settings(line, "--association.cull-below 7") == merge(BASES[line], {"association": {"cull_below": 7}})
    for name in () if "first" in line else ("default", "report") if line == DRIVE else PRESETS:
        assert settings(line, "--preset", name) == merge(preset(name), REGION if line == DRIVE else {}), name


def test_flags_beat_the_file_which_beats_the_preset_which_beats_the_defaults(settings: Callable[..., Config]) -> None:
    Path("part.toml").write_text("seed = 5\nmax_time = 50\n[laser]\nmax_range = 3.0\n")
    Path("named.toml").write_text("preset = 'report'\nseed = 5\n")
    file, laser = "--config part.toml", {"laser": {"max_range": 3.0}}
    assert settings("run", file) == preset(seed=5, max_time=50.0, **laser)  # type: ignore[arg-type]
    assert settings("run --seed 9", file, "--preset report") == preset("report", seed=9, max_time=50.0, **laser)  # type: ignore[arg-type]
    assert settings("replay a.log", file) == preset("log", seed=5, max_time=50.0, **laser)  # type: ignore[arg-type]
    driven = merge(preset("log"), {**DRIVEN, **REGION, "seed": 5, "max_time": 50.0, **laser})
    assert settings(DRIVE, file) == driven
    for line in ("run", "replay a.log", "run --preset report", "live"):
        assert settings(line, "--config named.toml") == preset("report", seed=5)


def test_what_follows_from_an_option_is_said_in_a_line(settings: Callable[..., Config], capsys: Any) -> None:
    assert settings("run --front-end scan-matching").estimator == "isam2"
    said = "note: estimator is isam2 in place of ekf-invariant, which does not go with front_end\n"
    assert said in capsys.readouterr().err
    settings("run --front-end scan-matching --estimator isam2")
    assert "note:" not in capsys.readouterr().err


def test_every_field_is_an_option_a_field_of_the_call_and_one_of_the_file() -> None:
    values = {name: value for name, value in {**changed(), **TOGETHER}.items() if value is not None}
    assert cli.main(["run", *words(values), "--out", "flags"]) == cli.DONE
    Path("all.toml").write_bytes((Path("flags") / "config.toml").read_bytes().replace(b"[versions]", b"[other]"))
    assert {name: value for name, value in flat(load_config("flags/config.toml")).items() if name in values} == values
    given = nested({name: value for name, value in values.items() if name != "scene"})
    run = ss.run(values["scene"], out="call", progress=False, **given)
    assert run.trace.config == load_config("call/config.toml") == load_config("flags/config.toml")
    one = {"goal": (1.25, -0.75), "explore.loop_closure": False, "grid.walls": False, "laser.mount": (0.1, -0.2, 0.3)}
    line = "run rectangle --goal 1.25 -0.75 --explore.no-loop-closure --grid.walls=false --laser.mount 0.1 -0.2 0.3"
    assert cli.main([*line.split(), "--max-time", "0.1", "--out", "goal"]) == cli.DONE
    expected = merge(preset(), nested({**one, "scene": "rectangle", "task": "goal", "max_time": 0.1}))
    assert load_config("goal/config.toml") == expected


@pytest.mark.parametrize("switch", ["--features.no-deskew", "--features.deskew=false", "--features.deskew false"])
def test_a_switch_is_turned_off_by_its_negative_or_by_a_value(switch: str, settings: Callable[..., Config]) -> None:
    assert not settings(f"run rectangle {switch}").features.deskew
