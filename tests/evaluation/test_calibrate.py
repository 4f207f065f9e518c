import dataclasses
import itertools
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import chi2

from sixthsense import cli
from sixthsense.config import Config, load_config, preset
from sixthsense.core.geometry import point_segment_distance, wrap_angle
from sixthsense.core.landmarks import Kind
from sixthsense.evaluation.calibrate import PERIOD_S, Calibration, calibrate, check_output, drive_samples
from sixthsense.evaluation.measure import measure
from sixthsense.evaluation.noise import CalibrationError, LandmarkErrors
from sixthsense.figures.calibration import save_calibration, write_calibration
from sixthsense.loop import run
from sixthsense.running.warmup import warm_up
from sixthsense.sources.scene import load_scene

# Fewer ticks a second than usual, for speed.
COARSE = {"robot": {"control_period_s": 0.05}, "laser": {"period_ticks": 2}}
WORLDS = {
    "default": preset(**COARSE),
    "worn": preset("worn", **COARSE),
    "turns": preset(**COARSE, world={"motion": {"turn_rate": 0.4}}),
    "laser": preset(**COARSE, world={"laser": {"range_m": 0.03}}),
}

# A room in which the robot cannot move.
CUPBOARD = """\
start = [0.0, 0.0, 0.0]
radius = 0.2
[[polygons]]
points = [[-0.2001, -0.2001], [0.2001, -0.2001], [0.2001, 0.2001], [-0.2001, 0.2001]]
"""
# One endless wall: nothing to recognise.
WALL = "start = [0.0, 0.0, 0.0]\nradius = 0.2\nregion = [-9.0, -9.0, 9.0, 9.0]\nwalls = [[-90.0, 3.0, 90.0, 3.0]]\n"


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    warm_up()


@pytest.fixture(scope="module")
def found() -> dict[str, list[Calibration]]:
    return {name: [calibrate(dataclasses.replace(c, seed=s)) for s in range(2)] for name, c in WORLDS.items()}


def driven(config: Config, samples: int = 100):
    rngs = np.random.default_rng(config.seed).spawn(2)
    return drive_samples(config, samples, *rngs)


@pytest.mark.parametrize("name", ["default", "worn", "report"])
@pytest.mark.parametrize("scene", ["apartment", "rectangle", "office"])
def test_the_calibration_drive_turns_left_without_collisions(name: str, scene: str) -> None:
    config = preset(name, scene=scene)
    walls, samples = driven(config)
    radius = load_scene(scene).radius
    assert len(samples) == 100
    assert all(point_segment_distance(s.truth.position, walls).min() > radius for s in samples)
    turns = [wrap_angle(s.odometry[-1].theta - s.odometry[0].theta) for s in samples]
    assert min(turns) >= 0.0
    way = np.array([s.motion.x for s in samples])
    assert way.max() > 0.5 * config.robot.speed * PERIOD_S  # it does not only turn on the spot
    assert {len(s.odometry) - 1 for s in samples} == {round(PERIOD_S / config.robot.control_period_s)}


def test_samples_are_contiguous() -> None:
    _, samples = driven(preset())
    for before, after in itertools.pairwise(samples):
        ahead = before.truth @ after.motion
        np.testing.assert_allclose(ahead.array(), after.truth.array(), atol=1e-9)
        assert before.odometry[-1] == after.odometry[0]


@pytest.mark.parametrize("name", WORLDS)
def test_nees_after_calibration_is_chi_square_distributed(found, name: str) -> None:
    """The likeliest covariance makes the mean NEES the dimension; single samples follow the distribution."""
    for one in found[name]:
        motion, landmarks = one.propagation[1], one.landmarks[1]
        assert motion.nees.mean() == pytest.approx(3.0, abs=0.15)
        assert 0.86 <= np.mean(motion.nees < chi2.ppf(0.95, 3)) <= 1.0
        assert landmarks.mean_nees == pytest.approx(2.0, abs=0.05)
        assert 0.90 <= np.mean(landmarks.nees < chi2.ppf(0.95, 2)) <= 0.99


def test_the_calibration_recovers_the_noise_of_the_world(found) -> None:
    for one in found["turns"]:
        assert one.assumed.motion.turn_rate == pytest.approx(0.4, rel=0.25)
        assert one.propagation[0].nees.mean() > 5.0
    for one in found["laser"]:
        assert one.assumed.laser.range_m == pytest.approx(0.03, rel=0.15)
        assert one.landmarks[0].mean_nees > 3.0
    for one in found["default"]:
        assert one.assumed.laser.range_m == pytest.approx(0.01, rel=0.1)


def test_only_the_systematic_errors_of_worn_wheels_are_corrected(found) -> None:
    for one in found["worn"]:
        assert one.assumed.wheel_scale_error == pytest.approx(0.02, abs=0.006)
    for name in ("default", "turns", "laser"):
        assert all(one.assumed.wheel_scale_error == one.assumed.drift_rad_per_m == 0.0 for one in found[name])


def test_drift_of_unequal_wheels_is_estimated() -> None:
    one = calibrate(preset(**COARSE, world={"drift_rad_per_m": 0.05}))
    assert one.assumed.drift_rad_per_m == pytest.approx(0.05, abs=0.02)
    assert one.assumed.wheel_scale_error == 0.0


def test_a_calibration_is_reproducible() -> None:
    first, second = (calibrate(preset("worn", seed=5), 40) for _ in range(2))
    assert first.assumed == second.assumed
    np.testing.assert_array_equal(first.propagation[1].nees, second.propagation[1].nees)


@pytest.mark.parametrize("assumed", [{}, {"floor_m": 0.0, "floor_rad": 0.0, "laser": {"range_m": 0.0}}])
def test_a_robot_without_noise_can_be_calibrated(assumed) -> None:
    still = dict.fromkeys(
        (f.name for f in dataclasses.fields(preset().assumed.motion) if f.name != "distribution"), 0.0
    )
    one = calibrate(preset("noiseless", assumed={**assumed, **({"motion": still} if assumed else {})}), 30)
    assert one.assumed.laser.range_m <= 0.002
    assert one.assumed.motion.turn_rate < 0.01


def test_errors_beyond_the_range_noise_go_into_the_landmark_floor() -> None:
    one = calibrate(
        preset(**COARSE, world={"laser": {"bearing_rad": 0.03}}, features={"lines": {"ransac_threshold_m": 0.02}})
    )
    assert one.assumed.laser.range_m == 0.02
    assert one.assumed.landmark_floor_m > 0.0
    assert one.landmarks[1].mean_nees == pytest.approx(2.0, abs=0.2)


def test_a_calibrated_robot_is_consistent(found) -> None:
    for seed, one in enumerate(found["laser"]):
        config = dataclasses.replace(WORLDS["laser"], task="tour", max_time=40.0, seed=seed)
        before = measure(run(config))["pose_nees_world_mean"]
        after = measure(run(dataclasses.replace(config, assumed=one.assumed)))["pose_nees_world_mean"]
        assert after < 0.5 * before
        assert after < 8.0


@pytest.mark.parametrize("name", ["worn", "report"])
def test_the_file_is_a_partial_configuration_with_the_fitted_values(name: str, tmp_path: Path) -> None:
    config = preset(name)
    one = calibrate(config, 30)
    file = tmp_path / "sub" / "noise.toml"
    write_calibration(one, config, file, "a title")
    loaded = load_config(file)
    assert loaded == dataclasses.replace(config, assumed=one.assumed)
    assert set(tomllib.loads(file.read_text())) == {"preset", "assumed"}
    comments = [line for line in file.read_text().splitlines() if line.startswith("#")]
    assert any("30 samples" in line and "before" in line and "after" in line for line in comments)
    assert sorted(p.name for p in file.parent.iterdir()) == ["noise.png", "noise.toml"]


def test_the_figure_is_drawn_without_observations_of_a_kind(tmp_path: Path) -> None:
    one = calibrate(preset(**COARSE, features={"points": {"ends": False}}), 30)
    assert len(one.landmarks[1].of(Kind.END)) == 0
    save_calibration(one, tmp_path / "noise.png", "no free ends")
    assert (tmp_path / "noise.png").is_file()


def test_the_mean_nees_without_observations_in_the_gate_is_infinite() -> None:
    errors = LandmarkErrors(np.zeros(1), np.ones((1, 2)), 1e-4 * np.eye(2)[None], 0)
    assert errors.mean_nees == np.inf and errors.outside == 1


@pytest.mark.parametrize(
    ("text", "field"), [(CUPBOARD, "start: the robot touched a wall"), (WALL, "scene: found 0 observations")]
)
def test_an_invalid_start_is_named(text: str, field: str, tmp_path: Path) -> None:
    file = tmp_path / "place.toml"
    file.write_text(text)
    with pytest.raises(CalibrationError, match=field):
        calibrate(preset(scene=str(file)), 20)


def complaint(args: list[str], capsys) -> str:
    assert cli.main(["calibrate", *args]) == cli.BAD_INPUT
    out, err = capsys.readouterr()
    assert out == "" and err.count("\n") == 1 and err.startswith("sixthsense: ")
    return err


@pytest.mark.parametrize(
    ("args", "part"),
    [
        (["rectangle"], "--out: found nothing"),
        (["rectangle", "--out", "noise.png"], "--out: found 'noise.png'"),
        (["rectangle", "--out", "."], "--out: found '.'"),
        (["rectangle", "--out", "a.toml", "--samples", "many"], "--samples: found 'many'"),
        (["rectangle", "--out", "a.toml", "--samples", "3"], "samples: found 3, allowed: at least 20"),
        (["castle", "--out", "a.toml"], "'castle'"),
        (["rectangle", "--out", "a.toml", "--preset", "brass"], "'brass'"),
        (["rectangle", "office", "--out", "a.toml"], "'office'"),
        (["rectangle", "--out", "a.toml", "--start", "9", "9", "0", "--samples", "20"], "a.toml"),
        (["rectangle", "--out", "/dev/null/noise.toml", "--samples", "20"], "/dev/null"),
    ],
)  # fmt: skip
def test_invalid_input_gives_one_line(args: list[str], part: str, capsys, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    if part == "a.toml":
        Path("a.toml").mkdir()
    assert part in complaint(args, capsys)
    assert not any(p.is_file() for p in tmp_path.rglob("*"))


@pytest.mark.parametrize("there", ["noise.toml", "noise.png"])
def test_existing_files_are_kept_unless_overwriting_is_allowed(there: str, capsys, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path(there).write_text("precious")
    args = ["rectangle", "--samples", "20", "--out", "noise.toml"]
    assert f"{there} exists" in complaint(args, capsys)
    assert Path(there).read_text() == "precious" and len(list(tmp_path.iterdir())) == 1
    check_output(Path("noise.toml"), overwrite=True)
    assert cli.main(["calibrate", *args, "--overwrite"]) == cli.DONE
    assert "precious" not in Path("noise.toml").read_text()


def test_run_accepts_the_file_of_a_calibration(capsys, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["calibrate", "rectangle", "--preset", "worn", "--samples", "40", "--out", "noise.toml"]
    assert cli.main(words) == cli.DONE
    out = capsys.readouterr().out
    assert "mean NEES" in out and "written to noise.toml and noise.png" in out
    short = ["--task", "tour", "--max-time", "2"]
    assert cli.main(["run", "rectangle", "--config", "noise.toml", "--out", "run", *short]) == cli.DONE
    used, found = load_config("run/config.toml"), load_config("noise.toml")
    assert used.assumed == found.assumed and used.preset == "worn"
