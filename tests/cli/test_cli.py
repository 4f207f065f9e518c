import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from sixthsense import cli
from sixthsense.cli.common import parse_command
from sixthsense.cli.run import Run
from sixthsense.config import Config, load_config, preset

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
FLASER = "FLASER 4 1.0 2.0 3.0 4.0 {x} 0.0 0.0 {x} 0.0 0.0 {stamp} nohost {stamp}\n"
LOG = "".join(FLASER.format(x=0.1 * k, stamp=float(k)) for k in range(5))
SHORT_LOG = ("--laser.beams", "4", "--laser.fov", "1.5")


def entries(folder: Path) -> list[str]:
    return sorted(str(p.relative_to(folder)) for p in folder.rglob("*"))


def complaint(args: list[str], capsys: pytest.CaptureFixture[str], folder: Path) -> str:
    """The one line that a bad command line ends in, with nothing written."""
    before = entries(folder)
    assert cli.main(args) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("sixthsense: ")
    assert "Traceback" not in err
    assert entries(folder) == before
    return err.removeprefix("sixthsense: ").strip()


def run(*args: str) -> int:
    return cli.main(["run", *args])


def metrics(folder: Path) -> dict[str, object]:
    values: dict[str, object] = json.loads((folder / "metrics.json").read_text())
    return values


BAD_LINES = [
    (
        "rn",
        "command: found 'rn', did you mean run? allowed: run, replay, live, simulate, merge, calibrate, campaign, ",
    ),
    (
        "--versions",
        "command: found '--versions', did you mean --version? allowed: run, replay, live, simulate, merge, calibrate, ",
    ),
    ("scenes extra", "scenes: found 'extra', allowed: no arguments"),
    ("run nowhere", "scene: found 'nowhere', allowed: apartment, block, campus, loop, office, rectangle, or a file"),
    ("run missing.toml", "missing.toml: cannot be read (No such file or directory)"),
    ("run missing.yaml", "missing.yaml: cannot be read (No such file or directory)"),
    ("run apartment office", "scene: found 'apartment' and 'office', allowed: one"),
    ("run --estimator ekff", "--estimator: found 'ekff', did you mean ekf? allowed: ekf"),
    ("run --planner rrt", "--planner: found 'rrt', did you mean rrtstar? allowed: astar, rrtstar"),
    ("run --rrtstar.iterations 0", "--rrtstar.iterations: found 0, allowed: 1 to 1e+07"),
    ("run --rrtstar.iterations 99999999", "--rrtstar.iterations: found 99999999, allowed: 1 to 1e+07"),
    ("run --rrtstar.range-m nan", "--rrtstar.range-m: found nan, allowed: a finite number"),
    ("run --rrtstar.range-m -1", "--rrtstar.range-m: found -1.0, allowed: at least 0"),
    ("run --rrtstar.goal-bias 1.5", "--rrtstar.goal-bias: found 1.5, allowed: above 0 to 1"),
    ("run --rrtstar.goal-bias 0", "--rrtstar.goal-bias: found 0.0, allowed: above 0 to 1"),
    ("run --task fly", "--task: found 'fly', allowed: explore, goal, tour"),
    ("run --preset no", "preset: found 'no', allowed: default, worn, noiseless, report, log"),
    ("run --bogus", "--bogus: no such option, allowed: --config, --out, --overwrite"),
    ("run --relations x", "--relations: no such option, did you mean --region? allowed: --config"),
    ("run -x", "-x: no such option, allowed: --config"),
    (
        "run --laser.beems 3",
        "--laser.beems: no such option, did you mean --laser.beams? allowed: --laser.beams, --laser.fov",
    ),
    ("run --laser 3", "--laser: no such option, allowed: --laser.beams, --laser.fov"),
    ("run --features.lines.x 3", "--features.lines.x: no such option, allowed: --features.lines.ransac"),
    ("run --laser.beams many", "--laser.beams: found 'many', allowed: a whole number"),
    ("run --laser.beams 1", "--laser.beams: found 1, allowed: 2 to 100000"),
    ("run --laser.max-range nan", "--laser.max-range: found nan, allowed: a finite number"),
    ("run --laser.max_range nan", "--laser.max-range: found nan, allowed: a finite number"),
    ("run --laser.mount 1 2", "--laser.mount: found [1.0, 2.0], allowed: 3 numbers"),
    ("run --robot.speed inf", "--robot.speed: found inf, allowed: a finite number"),
    ("run --robot.speed fast", "--robot.speed: found 'fast', allowed: a finite number"),
    ("run --world.motion.speed -1", "--world.motion.speed: found -1.0, allowed: 0 to 100"),
    ("run --follow.shortcut=maybe", "--follow.shortcut: found 'maybe', allowed: true or false"),
    ("run --overwrite=3", "--overwrite: found '3', allowed: true or false"),
    (
        "run --calibrate-wheels --estimator ekf",
        "--calibrate-wheels: found true with ekf, allowed: with ekf-invariant and isam2",
    ),
    ("run --laser.sweep-s 0.2", "--laser.sweep-s: found 0.2, allowed: at most 0.1, the time between two scans"),
    ("run --safety.probability 0", "--safety.probability: found 0.0, allowed: 0.5 to 0.999999"),
    ("run --safety.probability 1", "--safety.probability: found 1.0, allowed: 0.5 to 0.999999"),
    ("run --robot.deceleration -1", "--robot.deceleration: found -1.0, allowed: above 0"),
    ("run --seed -1", "--seed: found -1, allowed: at least 0"),
    ("run --seed 1.5", "--seed: found '1.5', allowed: a whole number"),
    ("run --seed", "--seed: found nothing, allowed: 1 value"),
    ("run --out", "--out: found nothing, allowed: 1 value"),
    ("run --goal", "--goal: found nothing, allowed: 2 values"),
    ("run --goal 1", "--goal: found [1.0], allowed: 2 numbers"),
    ("run --goal 1 --seed 3", "--goal: found [1.0], allowed: 2 numbers"),
    ("run --goal 1 x", "--goal: found 'x', allowed: a finite number"),
    ("run --goal 1 nan", "--goal: found nan, allowed: a finite number"),
    ("run apartment --goal 1 2 3", "scene: found 'apartment' and '3', allowed: one"),
    ("run --max-time 0", "--max-time: found 0.0, allowed: above 0 to 1e+09"),
    ("run --max-time 1e300", "--max-time: found 1e+300, allowed: above 0 to 1e+09"),
    ("run --goal 100 100", "goal: found (100, 100), outside the region, allowed: x 0 to 14, y 0 to 9"),
    ("run --goal 6.05 3", "goal: found (6.05, 3), 0.05 m from a wall, allowed: at least the robot's radius"),
    ("run --start 6 3 0", "start: found (6, 3), 0 m from a wall, allowed: at least the robot's radius 0.18 m"),
    ("run --region 5 5 1 1", "region: found [5, 5, 1, 1], allowed: x0 < x1 and y0 < y1"),
    ("run --robot.radius 1.5", "start: found (11.6, 0.8), 0.8 m from a wall, allowed: at least the robot's radius"),
    ("run --config missing.toml", "missing.toml: cannot be read (No such file or directory)"),
    ("run --config .", ".: cannot be read (Is a directory)"),
    ("run --out ..", "--out: found '..', allowed: a path that ends in a name"),
    ("run --out .", "--out: found '.', allowed: a path that ends in a name"),
    ("replay", "log: found nothing, allowed: a CARMEN file"),
    ("replay x.log", "x.log: no such file"),
    ("replay x.foo", "x.foo: no such file"),
    ("replay x.log --goal 1", "--goal: found [1.0], allowed: 2 numbers"),
    ("replay x.log --relations missing", "missing: no such file"),
]


@pytest.mark.parametrize(("line", "said"), BAD_LINES, ids=[line for line, _ in BAD_LINES])
def test_a_bad_command_line_ends_in_one_line_that_names_what_was_found_and_what_is_allowed(
    line: str, said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert said in complaint(line.split(), capsys, here)


BAD_FILES = [
    ("[laser]\nmax_range = nan", "bad.toml: laser.max_range: found nan, allowed: a finite number"),
    ("[laser]\nbeams = 'many'", "bad.toml: laser.beams: found 'many', allowed: a whole number"),
    ("[laser]\nbeems = 3", "bad.toml: laser.beems: no such field, did you mean beams? allowed: beams, fov"),
    (
        "[laser]\nfov = 270",
        "bad.toml: laser.fov: found 270.0, did you mean 4.712 rad (270 degrees)? allowed: above 0 to",
    ),
    ("goal = [0, 0]\ntour = [[1, 1]]", "bad.toml: goal: found beside a tour, allowed: one of the two"),
    ("[features.split]\nepsilon_m = 0", "bad.toml: features.split.epsilon_m: found 0.0, allowed: above 0"),
    ("preset = 'nope'", "bad.toml: preset: found 'nope', allowed: default, worn"),
    ("hello", "bad.toml: is not TOML"),
    (b"\xff\xfe", "bad.toml: is not UTF-8 text"),
]


@pytest.mark.parametrize(("content", "said"), BAD_FILES, ids=[said for _, said in BAD_FILES])
def test_a_bad_configuration_file_ends_in_one_line_that_names_file_and_field(
    content: str | bytes, said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "bad.toml").write_bytes(content if isinstance(content, bytes) else content.encode())
    assert complaint(["run", "rectangle", "--config", "bad.toml"], capsys, here).startswith(said)


def test_a_bad_scene_file_ends_in_one_line(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "room.toml").write_text(CLOSET.replace("radius = 0.15", "radius = nan"))
    said = complaint(["run", "room.toml"], capsys, here)
    assert said.endswith("room.toml: radius: found nan, allowed: a number above 0, metres")


def test_a_scene_without_goals_names_the_tasks_that_are_left(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "room.toml").write_text(CLOSET.replace("goal = [1.4, 1.4]\n", ""))
    said = complaint(["run", "room.toml", "--task", "tour"], capsys, here)
    assert said == "tour: missing, the scene room has none of its own, allowed: x y x y ..."
    said = complaint(["run", "room.toml", "--task", "explore", "--tour", "1", "1"], capsys, here)
    assert said == "--tour: found with --task explore, allowed: with --task tour"
    said = complaint(["run", "room.toml", "--tour", "1", "1", "0.5"], capsys, here)
    assert said == "--tour: found 3 values, allowed: 2 of each entry"
    said = complaint(["run", "room.toml", "--tour", "0.7", "0.7", "9", "0.5"], capsys, here)
    assert "tour, entry 2" in said
    said = complaint(["run", "room.toml", "--task", "goal"], capsys, here)
    assert said == "goal: missing, the scene room has none of its own, allowed: x y"


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        (
            "cut.log",
            LOG[:-30] + "\n" + LOG,
            "cut.log line 5: found FLASER with 4 ranges of 9 fields, allowed: 15 (a CARMEN line cut",
        ),
        ("cut.clf", LOG + "FLAS\n" + LOG, "cut.clf line 6: found 'FLAS', a CARMEN line cut short"),
        ("log.csv", LOG, "log.csv: found no known kind of log, allowed: CARMEN (.log, .clf, .carmen"),
        ("empty.log", "", "empty.log: found no FLASER or ROBOTLASER1 line"),
        (
            "other.log",
            LOG.replace("FLASER 4 1.0", "FLASER 3"),
            "other.log: found scans of 3 beams, allowed: 4 (laser.beams)",
        ),
    ],
)
def test_a_bad_log_ends_in_one_line(
    name: str, content: str, said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / name).write_text(content)
    assert complaint(["replay", name, *SHORT_LOG], capsys, here).startswith(said)


@pytest.mark.parametrize(
    ("relation", "options", "said"),
    [
        ("1 2 0 0 0 0", (), " line 2: found 6 fields, allowed: 8"),
    ],
)
def test_relations_that_cannot_be_used_are_told_before_anything_is_written(
    relation: str, options: tuple[str, ...], said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "some.log").write_text(LOG)
    (here / "some.relations").write_text(f"1 2 0.1 0 0 0 0 0\n{relation}\n")
    told = complaint(["replay", "some.log", "--relations", "some.relations", *SHORT_LOG, *options], capsys, here)
    assert told.startswith("some.relations")
    assert said in told


def test_relations_between_other_stamps_than_those_of_scans_are_counted_and_left_out(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "some.log").write_text(LOG)
    (here / "some.relations").write_text("1 2 0.1 0 0 0 0 0\n1 9 5 0 0 0 0 0\n")
    assert cli.main(["replay", "some.log", "--relations", "some.relations", *SHORT_LOG]) == cli.DONE
    assert "1 of 2 relations" in capsys.readouterr().err
    (here / "some.relations").write_text("1 9 5 0 0 0 0 0\n")
    told = complaint(["replay", "some.log", "--relations", "some.relations", *SHORT_LOG], capsys, here)
    assert told.startswith("some.relations: found no relation between scans of the log")


def test_a_log_cut_in_its_last_line_is_replayed_up_to_it(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "cut.log").write_text(LOG[:-30])
    assert cli.main(["replay", "cut.log", *SHORT_LOG]) == cli.DONE
    assert re.search(r"note: cut.log: .*line 5", capsys.readouterr().err)


def test_a_replay_with_relations_measures_them(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "some.log").write_text(LOG)
    (here / "some.relations").write_text("1 2 0.1 0 0 0 0 0\n1 4 0.3 0 0 0 0 0\n")
    assert cli.main(["replay", "some.log", "--relations", "some.relations", *SHORT_LOG]) == cli.DONE
    out, err = capsys.readouterr()
    assert err == ""
    assert out.endswith("written to runs/some-isam2-1/\n") and out.count("\n") <= 10
    assert re.search(r"\naccuracy +error against the relations \S+ mm and \S+° on average\n", out)
    assert re.search(r"\nscans +5 used, \d of them as keyframes; largest gap 1 s\n", out)
    values = metrics(here / "runs" / "some-isam2-1")
    assert values["outcome"] == "log ended"
    assert values["relations_trans_m_mean"] == pytest.approx(0.0, abs=0.02)
    assert not {"ate_rmse_m", "coverage", "collisions"} & values.keys()
    assert not (here / "runs" / "some-isam2-1" / "truth.tum").exists()


def test_a_replay_that_ends_early_is_measured_by_the_relations_it_has_reached(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "some.log").write_text(LOG)
    (here / "some.relations").write_text("1 2 0.1 0 0 0 0 0\n1 4 99 0 0 0 0 0\n")
    words = ["replay", "some.log", "--relations", "some.relations", "--max-time", "2", *SHORT_LOG]
    assert cli.main(words) == cli.DONE
    values = metrics(here / "runs" / "some-isam2-1")
    assert values["outcome"] == "log ended"
    assert values["relations_trans_m_mean"] == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("option", ["--goal 1 2", "--task tour", "--world.laser.range-m 1", "--scene block"])
def test_an_option_that_a_replay_would_ignore_is_refused(
    option: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "some.log").write_text(LOG)
    said = complaint(["replay", "some.log", *SHORT_LOG, *option.split()], capsys, here)
    assert said.startswith(option.split()[0].split(".")[0] + ": found on replay")


@pytest.mark.parametrize("options", ["--laser.mount 1e300 0 0", "--grid.cell-m 0.001 --grid.clearance-m 9"])
def test_a_grid_that_would_not_fit_ends_in_one_line_and_leaves_nothing(
    options: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "grid: found" in complaint(["run", "rectangle", *options.split()], capsys, here)


def test_no_folder_is_written_below_a_regular_file(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (here / "file").write_text("mine")
    said = complaint(["run", "rectangle", "--out", "file/run"], capsys, here)
    assert said.startswith("--out: file/run.partial cannot be written (Not a directory), allowed: a new folder")


@pytest.mark.parametrize("option", ["--out", "--config"])
def test_a_name_too_long_for_the_file_system_ends_in_one_line(
    option: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "File name too long" in complaint(["run", "rectangle", option, "x" * 300], capsys, here)


def test_no_command_prints_the_usage_and_is_bad_input(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == cli.BAD_INPUT
    assert capsys.readouterr().out.startswith("usage: sixthsense COMMAND")
    assert cli.main(["--help"]) == cli.DONE
    assert capsys.readouterr().out.startswith("usage: sixthsense COMMAND")


def test_the_command_tells_its_version(capsys):
    assert cli.main(["--version"]) == cli.DONE
    assert re.fullmatch(r"sixthsense \d+\.\d+\.\d+\n", capsys.readouterr().out)


@pytest.mark.parametrize("command", ["run", "replay", "scenes"])
@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_every_command_has_a_help(command: str, flag: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([command, flag]) == cli.DONE
    out, err = capsys.readouterr()
    assert out.startswith(f"usage: sixthsense {command}")
    assert err == ""


@pytest.mark.parametrize(("command", "rest"), [("run", ["nowhere"]), ("replay", ["nowhere.log"])])
def test_every_flag_that_the_help_shows_is_understood(
    command: str, rest: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    cli.main([command, "--help", "all"])
    shown = set(re.findall(r"--[a-z][\w.-]*", capsys.readouterr().out)) - {"--help"}
    assert len(shown) > 70
    for flag in shown:
        assert cli.main([command, *rest, flag]) == cli.BAD_INPUT  # for the scene, or a value that is missing
        assert "no such option" not in capsys.readouterr().err, flag


def test_scenes_lists_what_ships(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["scenes"]) == cli.DONE
    rows = capsys.readouterr().out.splitlines()
    assert [row.split()[0] for row in rows] == ["apartment", "block", "campus", "loop", "office", "rectangle"]


def test_help_loads_no_numpy_and_the_command_works_as_a_program(here: Path) -> None:
    code = (
        "import sys; from sixthsense.cli import main; code = main(['--help']); "
        "assert not {'numpy', 'numba', 'scipy', 'matplotlib'} & set(sys.modules), 'heavy'; sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("usage: sixthsense COMMAND")


@pytest.mark.parametrize("line", ["run nowhere", "calibrate nowhere --out n.toml", "run --laser.beams many"])
def test_a_wrong_name_is_told_before_anything_large_is_loaded(line: str, here: Path) -> None:
    code = (
        f"import sys; from sixthsense.cli import main; code = main({line.split()!r}); "
        "assert not {'numpy', 'numba', 'tyro', 'http.server'} & set(sys.modules), 'heavy'; sys.exit(code)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == cli.BAD_INPUT
    assert done.stderr.startswith("sixthsense: ") and done.stderr.count("\n") == 1 and "allowed: " in done.stderr


def test_a_bad_command_line_is_exit_code_2_without_a_traceback_for_the_shell(here: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "sixthsense.cli", "run", "rectangle", "--seed", "x"], capture_output=True, text=True
    )
    assert done.returncode == 2
    assert done.stdout == ""
    assert done.stderr == "sixthsense: --seed: found 'x', allowed: a whole number\n"
    assert entries(here) == []


def test_a_run_as_a_program_prints_its_summary_and_the_folder(here: Path) -> None:
    command = [sys.executable, "-m", "sixthsense.cli", "run", "rectangle", "--out", "some/run"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("outcome      explored: the robot saw all that it could; coverage ")
    assert done.stdout.endswith("written to some/run/\n") and done.stdout.count("\n") <= 10
    assert entries(here / "some") == sorted(["run", *(f"run/{name}" for name in entries(here / "some" / "run"))])


def settings(*args: str, base: str = "default") -> Config:
    options, _ = parse_command(Run, "scene", base, list(args))
    return options.settings


def test_flags_beat_the_file_which_beats_the_preset_which_beats_the_defaults(here: Path) -> None:
    (here / "part.toml").write_text("seed = 5\nmax_time = 50\n[laser]\nmax_range = 3.0\n")
    (here / "named.toml").write_text("preset = 'report'\nseed = 5\n")
    assert settings() == preset()
    assert settings(base="log") == preset("log")
    assert settings("--preset", "report").laser == preset("report").laser
    both = settings("--preset=report", "--config", "part.toml", "--seed", "9")
    assert (both.preset, both.seed, both.max_time) == ("report", 9, 50.0)
    assert (both.laser.max_range, both.laser.beams) == (3.0, preset("report").laser.beams)
    assert settings("--seed", "9", "--config=part.toml").seed == 9
    assert settings("--config", "part.toml", base="log").assumed == preset("log").assumed
    assert settings("--config", "named.toml", base="log").grid == preset("report").grid
    assert settings("--config", "named.toml", "--preset", "worn").world == preset("worn").world


def test_flags_are_read_in_every_spelling_of_the_help() -> None:
    config = settings("--goal", "-1e-3", "-.5", "--laser.max_range=3", "--follow.no-shortcut", "--seed=4")
    assert config.goal == (-1e-3, -0.5)
    assert (config.laser.max_range, config.follow.shortcut, config.seed) == (3.0, False, 4)
    assert settings("--follow.shortcut", "false").follow.shortcut is False
    assert settings("--follow.no-shortcut", "--follow.shortcut").follow.shortcut is True
    assert settings("--goal", "1", "2", "--goal", "None").goal is None


def test_a_robot_that_reaches_its_goal_exits_with_0(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("rectangle", "--seed", "3", "--task", "goal") == cli.DONE
    out, err = capsys.readouterr()
    assert err == ""
    assert re.match(r"outcome +goal reached: the robot reached its goal; it stands \S+ \w+ from it\n", out)
    assert "\nmap          runs/rectangle-ekf-invariant-1/figures/map.png, " in out
    assert "\nreport       sixthsense report runs/rectangle-ekf-invariant-1 writes figures/report.html\n" in out
    assert out.endswith("written to runs/rectangle-ekf-invariant-1/\n")
    assert run("rectangle", "--seed", "3", "--task", "goal") == cli.DONE
    assert capsys.readouterr().out.endswith("written to runs/rectangle-ekf-invariant-2/\n")


def test_verbose_prints_all_metrics_but_only_those_of_the_active_front_end(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run("rectangle", "--task", "tour", "--max-time", "3", "--out", "landmarks", "--verbose") == cli.DONE
    out = capsys.readouterr().out
    assert out.startswith("Outcome\n  outcome") and "\n\noutcome      tour ended: " in out
    assert "\n  stage_ms_mean.extract " in out and "\n  walls_merged " in out
    assert not re.search(r"\n  (loop_closures_|stage_ms_mean.track)", out)
    assert set(re.findall(r"^  (\S+) ", out, re.MULTILINE)) == set(metrics(here / "landmarks"))
    assert cli.main(["replay", "landmarks", "--front-end", "scan-matching", "--out", "scans", "--verbose"]) == cli.DONE
    out = capsys.readouterr().out
    assert "\n  loop_closures_found " in out and "\n  stage_ms_mean.track " in out
    assert not re.search(r"\n  (landmark|walls_|discarded_|stage_ms_mean.(extract|associate))", out)


def test_a_robot_that_runs_out_of_time_exits_with_1_and_leaves_its_folder(here: Path) -> None:
    assert run("rectangle", "--max-time", "2", "--out", "late") == cli.FAILED
    assert metrics(here / "late")["outcome"] == "out of time"
    assert metrics(here / "late")["sim_time_s"] == pytest.approx(2.0, abs=0.1)


def test_a_tour_that_its_time_ends_exits_with_0(here: Path) -> None:
    assert run("rectangle", "--task", "tour", "--max-time", "8", "--out", "tour") == cli.DONE
    assert metrics(here / "tour")["outcome"] == "tour ended"


def test_a_goal_in_a_room_without_a_door_exits_with_1(here: Path) -> None:
    (here / "closet.toml").write_text(CLOSET)
    assert run("closet.toml", "--task", "goal", "--out", "closet") == cli.FAILED
    values = metrics(here / "closet")
    assert values["outcome"] == "goal unreachable"
    assert values["collisions"] == 0


def test_a_robot_that_hits_a_wall_exits_with_1(here: Path) -> None:
    # Its wheels turn it by a radian a metre unnoticed, and its laser sees no wall in time.
    blind = ("--laser.max-range", "0.05", "--world.drift-rad-per-m", "1.0")
    assert run("rectangle", "--task", "goal", *blind, "--out", "blind") == cli.FAILED
    values = metrics(here / "blind")
    assert values["outcome"] == "collided"
    assert values["collisions"] == 1


def test_a_goal_on_the_command_line_means_that_task_and_goes_with_no_other(here: Path) -> None:
    (here / "tour.toml").write_text("task = 'tour'\nmax_time = 3\n")
    goal = ("--goal", "0", "0", "--overwrite", "--out", "run", "--config", "tour.toml")
    assert run("rectangle", *goal) in (cli.DONE, cli.FAILED)
    assert load_config(here / "run" / "config.toml").task == "goal"
    assert run("rectangle", *goal, "--task", "tour") == cli.BAD_INPUT
    assert run("--config", "run/config.toml", "--out", "again") in (cli.DONE, cli.FAILED)
    assert load_config(here / "again" / "config.toml") == load_config(here / "run" / "config.toml")


def test_a_replays_configuration_is_refused_by_run_and_taken_by_replay(
    here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (here / "some.log").write_text(LOG)
    assert cli.main(["replay", "some.log", *SHORT_LOG, "--out", "first"]) == cli.DONE
    assert tomllib.loads((here / "first" / "config.toml").read_text())["replayed"]["log"] == str(here / "some.log")
    assert cli.main(["replay", "some.log", "--config", "first/config.toml", "--out", "second"]) == cli.DONE
    assert (here / "first" / "estimate.tum").read_bytes() == (here / "second" / "estimate.tum").read_bytes()
    capsys.readouterr()
    assert complaint(["run", "--config", "first/config.toml"], capsys, here).startswith(
        "--config: first/config.toml is of"
    )


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("run rectangle --scene block", "--scene: found beside 'rectangle'"),
        ("run rectangle --goal 0 0 --task tour", "--goal: found with --task tour"),
        ("run rectangle --goal 0 0 --tour 1 1", "--goal: found beside a tour, allowed: one of the two"),
        ("run rectangle --grid.min-hits 11", "--grid.min-hits: found 11, allowed: at most max_hits, 10"),
        ("run rectangle --follow.distance-slack-m 0.2", "--follow.distance-slack-m: found 0.2, allowed: at most goal"),
        ("run rectangle --assumed.motion.speed 1e200", "--assumed.motion.speed: found 1e+200, allowed: 0 to 100"),
        ("run rectangle --features.points.min-angle-rad 3", "--features.points.min-angle-rad: found 3.0"),
    ],
)
def test_options_that_do_not_go_together_are_told(
    words: str, said: str, here: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert complaint(words.split(), capsys, here).startswith(said)


def test_a_corridor_too_tight_to_measure_its_coverage_still_leaves_its_folder(here: Path) -> None:
    (here / "tight.toml").write_text(
        "start = [0.5, 0.2125, 0.0]\nradius = 0.2\ngoal = [0.7, 0.2125]\n"
        "[[polygons]]\npoints = [[0, 0], [4, 0], [4, 0.425], [0, 0.425]]\n"
    )
    run("tight.toml", "--out", "tight", "--max-time", "5")
    assert "coverage" not in metrics(here / "tight")


def test_the_preset_that_is_saved_is_the_one_whose_values_ran(here: Path) -> None:
    assert run("rectangle", "--max-time", "1", "--out", "first") == cli.FAILED
    assert run("--config", "first/config.toml", "--preset", "worn", "--out", "second") == cli.FAILED
    assert load_config(here / "second" / "config.toml").preset == "default"


TIMED = re.compile(r"wall_time_s|realtime_factor|scan_ms_.*|stage_ms_mean\..*")


@pytest.mark.parametrize("options", [("--seed", "4"), ("--preset", "worn", "--task", "tour", "--max-time", "12")])
def test_a_folders_configuration_repeats_its_run_bit_for_bit(options: tuple[str, ...], here: Path) -> None:
    (here / "closet.toml").write_text(CLOSET.replace("goal = [1.4, 1.4]", "goal = [0, 1]\ntour = [[0, 1], [1, 0]]"))
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


def test_another_seed_is_another_run(here: Path) -> None:
    for seed in ("1", "2"):
        assert run("rectangle", "--seed", seed, "--out", seed) == cli.DONE
    assert (here / "1" / "truth.tum").read_bytes() != (here / "2" / "truth.tum").read_bytes()


def test_an_existing_folder_stays_unless_it_may_be_overwritten(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run("rectangle", "--max-time", "1", "--out", "mine") == cli.FAILED
    capsys.readouterr()
    before = {p: p.read_bytes() for p in (here / "mine").rglob("*") if p.is_file()}
    said = complaint(["run", "rectangle", "--out", "mine"], capsys, here)
    assert said == "--out: mine exists, allowed: a new folder, or --overwrite"
    assert {p: p.read_bytes() for p in before} == before
    assert run("rectangle", "--out", "mine", "--overwrite") == cli.DONE
    assert metrics(here / "mine")["outcome"] == "explored"
    assert [p.name for p in here.iterdir()] == ["mine"]


def test_a_folder_that_is_no_run_is_never_overwritten(here: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("photos", "photos.partial"):
        (here / name).mkdir()
        (here / name / "holiday.jpg").write_text("dear")
        said = complaint(["run", "rectangle", "--out", "photos", "--overwrite"], capsys, here)
        assert said.startswith(f"--out: {name} is not a run folder")
        (here / name / "holiday.jpg").unlink()
        (here / name).rmdir()


def test_the_saved_configuration_is_plain_toml_that_names_the_scene(here: Path) -> None:
    (here / "closet.toml").write_text(CLOSET)
    run("closet.toml", "--max-time", "1", "--out", "run")
    table = tomllib.loads((here / "run" / "config.toml").read_text())
    assert table["scene"] == str(here / "closet.toml")
    assert table["max_time"] == 1.0
    assert table["laser"]["beams"] == 360
