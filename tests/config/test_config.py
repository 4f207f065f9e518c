import dataclasses
import math
import re
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from sixthsense.config import (
    PRESETS,
    Config,
    ConfigError,
    LaserConfig,
    Range,
    Section,
    as_table,
    load_config,
    merge,
    preset,
    save_config,
)
from sixthsense.config.field_texts import field_texts
from sixthsense.sources.scene import SceneError, load_scene


def written(folder: Path, text: str | bytes, name: str = "some.toml") -> Path:
    file = folder / name
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    return file


def leaves(section: Section, path: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for f in dataclasses.fields(section):  # type: ignore[arg-type]
        value = getattr(section, f.name)
        out |= leaves(value, f"{path}{f.name}.") if isinstance(value, Section) else {path + f.name: value}
    return out


@pytest.mark.parametrize("name", PRESETS)
def test_every_preset_is_a_valid_configuration_that_knows_its_name(name: str) -> None:
    assert preset(name).preset == name


@pytest.mark.parametrize("name", PRESETS)
def test_a_saved_configuration_is_read_back_as_it_was(name: str, tmp_path: Path) -> None:
    config = dataclasses.replace(preset(name), seed=2**40, goal=(0.1, 1 / 3), start=(1e-300, -2.0, math.pi))
    save_config(config, tmp_path / "config.toml")
    assert load_config(tmp_path / "config.toml") == config


def test_a_saved_configuration_names_the_versions_that_ran_it(tmp_path: Path) -> None:
    save_config(Config(), tmp_path / "config.toml")
    text = (tmp_path / "config.toml").read_text()
    assert "[versions]" in text
    for name in ("sixthsense", "python", "numpy", "scipy", "numba"):
        assert f"\n{name} = " in text


def test_the_report_preset_has_the_reports_numbers() -> None:
    config = preset("report")
    assert config.robot.speed == 0.1
    assert config.robot.turn_rate == 0.5
    assert config.robot.integration_step_s == 0.01
    assert config.robot.control_period_s == pytest.approx(1 / 60, rel=1e-3)
    assert config.laser.period_ticks == 10
    assert config.laser.max_range == 5.0
    assert config.world.motion.distribution == "uniform"
    assert config.world.laser.range_m == 0.01
    assert config.features.lines.ransac_iterations == 1000
    assert config.features.lines.ransac_threshold_m == 0.04
    assert (config.association.match_below, config.association.new_above) == (20.0, 200.0)
    assert (config.association.cull_period, config.association.cull_below) == (25, 3)
    assert config.grid.cell_m == 0.04


def test_the_simulated_noise_is_the_assumed_noise_except_in_presets_with_a_mismatch() -> None:
    for name in ("default", "report"):
        config = preset(name)
        assert config.world.motion == config.assumed.motion, name
        assert config.world.laser == config.assumed.laser, name
    assert preset("worn").world.wheel_scale_error == 0.02
    assert preset("worn").world.drift_rad_per_m == pytest.approx(math.radians(0.5))
    assert preset("worn").assumed == preset("default").assumed


def test_a_file_changes_the_fields_it_names_and_no_other(tmp_path: Path) -> None:
    file = written(tmp_path, "seed = 7\n[laser]\nbeams = 90\n[features.split]\nepsilon_m = 0.5\n")
    changed, before = leaves(load_config(file)), leaves(Config())
    different = {name: value for name, value in changed.items() if value != before[name]}
    assert different == {"seed": 7, "laser.beams": 90, "features.split.epsilon_m": 0.5}


def test_a_file_is_read_over_its_base_or_over_the_preset_it_names_or_over_the_one_for_the_rest(tmp_path: Path) -> None:
    file = written(tmp_path, "seed = 7\n")
    naming = written(tmp_path, 'preset = "worn"\nseed = 7\n', "naming.toml")
    assert load_config(file, preset("report")) == dataclasses.replace(preset("report"), seed=7)
    assert load_config(file, otherwise="noiseless") == dataclasses.replace(preset("noiseless"), seed=7)
    assert load_config(naming, otherwise="noiseless") == dataclasses.replace(preset("worn"), seed=7)
    assert load_config(naming, preset("report")).laser == preset("report").laser


def test_a_file_may_begin_with_a_byte_order_mark(tmp_path: Path) -> None:
    assert load_config(written(tmp_path, b"\xef\xbb\xbfseed = 7\n")).seed == 7


def test_names_may_be_written_with_dashes_as_on_the_command_line() -> None:
    assert merge(Config(), {"max-time": 5}).max_time == 5.0


def test_whole_numbers_are_accepted_for_floats_and_become_floats() -> None:
    config = LaserConfig(max_range=5, mount=(1, 2, 3))
    assert isinstance(config.max_range, float)
    assert all(isinstance(value, float) for value in config.mount)


BAD_FIELDS = {
    "laser.beams": ('[laser]\nbeams = "many"', "'many'", "a whole number"),
    "laser.beams ": ("[laser]\nbeams = 1.5", "1.5", "a whole number"),
    "laser.beams  ": ("[laser]\nbeams = 1", "1", "2 to 100000"),
    "laser.beams   ": ("[laser]\nbeams = true", "True", "a whole number"),
    "laser.beems": ("[laser]\nbeems = 3", "beems", "beams, fov, max_range"),
    "laser": ("laser = 3", "3", "a table"),
    "lasers": ("[lasers]\nbeams = 3", "lasers", "scene, preset, estimator"),
    "laser.max_range": ("[laser]\nmax_range = nan", "nan", "a finite number"),
    "laser.max_range ": ("[laser]\nmax_range = inf", "inf", "a finite number"),
    "laser.max_range  ": ("[laser]\nmax_range = 0", "0", "above 0"),
    "laser.mount": ("[laser]\nmount = [1, 2]", "[1, 2]", "3 numbers"),
    "laser.mount ": ("[laser]\nmount = [1, 2, nan]", "nan", "a finite number"),
    "world.motion.speed": ("[world.motion]\nspeed = -0.1", "-0.1", "0 to 100"),
    "world.motion.distribution": ('[world.motion]\ndistribution = "cauchy"', "'cauchy'", "gaussian, uniform"),
    "follow.shortcut": ("[follow]\nshortcut = 1", "1", "true or false"),
    "association.match_probability": ("[association]\nmatch_probability = 1.0", "1.0", "above 0"),
    "estimator": ('estimator = "ekff"', "'ekff'", "ekf"),
    "estimator ": ("estimator = []", "[]", "ekf"),
    "scene": ("scene = 3", "3", "a text"),
    "goal": ("goal = 3", "3", "2 numbers"),
    "seed": ("seed = -1", "-1", "at least 0"),
    "max_time": (f"max_time = 1{'0' * 400}", "1000", "a finite number"),
    "preset": ('preset = "no"', "'no'", "default, worn, noiseless, report, log"),
    "preset ": ("preset = []", "[]", "default, worn, noiseless, report, log"),
}


@pytest.mark.parametrize("field", BAD_FIELDS)
def test_a_wrong_field_is_one_line_with_file_field_value_and_what_is_allowed(field: str, tmp_path: Path) -> None:
    text, found, allowed = BAD_FIELDS[field]
    file = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    message = str(caught.value)
    assert message.startswith(f"{file}: {field.strip()}: ")
    assert found in message
    assert f"allowed: {allowed}" in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("hello", "is not TOML"),
        ("seed = 1\nseed = 2", "is not TOML"),
        (b"\xff\xfe\x00", "is not UTF-8"),
        ("a = " + "[" * 50_000, "is not TOML"),
        ("seed = " + "1" * 5_000, "is not usable TOML"),
    ],
)
def test_a_file_that_is_no_configuration_is_one_line(text: str | bytes, said: str, tmp_path: Path) -> None:
    file = written(tmp_path, text)
    with pytest.raises(ConfigError) as caught:
        load_config(file)
    assert str(caught.value).startswith(f"{file}: {said}")
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder_are_named_in_the_error(tmp_path: Path) -> None:
    for path in (tmp_path / "missing.toml", tmp_path):
        with pytest.raises(ConfigError, match=r"cannot be read \(") as caught:
            load_config(path)
        assert str(caught.value).startswith(str(path))


def test_values_from_code_are_validated_as_those_of_files() -> None:
    with pytest.raises(ConfigError, match=r"^beams: found 1, allowed: 2 to 100000$"):
        LaserConfig(beams=1)
    with pytest.raises(ConfigError, match=r"^seed: found 0\.5, allowed: a whole number$"):
        dataclasses.replace(Config(), seed=0.5)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"^laser: found 3, allowed: a table of LaserConfig$"):
        Config(laser=3)  # type: ignore[arg-type]


def bounded_angles(section: type[Section], path: str = "") -> Iterator[tuple[str, Range]]:
    """Fields with an upper bound whose names or texts say that they are in radians."""
    texts = field_texts(section)
    for name, hint in typing.get_type_hints(section, include_extras=True).items():
        if isinstance(hint, type) and issubclass(hint, Section):
            yield from bounded_angles(hint, f"{path}{name}.")
        bounds = next((note for note in getattr(hint, "__metadata__", ()) if isinstance(note, Range)), Range())
        measured = name.partition("_per_")[0]
        in_radians = re.search(r"_rad$|heading", measured) or re.search(r", rad[,.;]", texts.get(name, ""))
        if in_radians and bounds.high < math.inf:
            yield path + name, bounds


def test_a_number_in_degrees_beyond_the_range_of_an_angle_is_converted() -> None:
    angles = dict(bounded_angles(Config))
    assert {"laser.fov", "features.points.min_angle_rad", "world.drift_rad_per_m"} <= set(angles)
    for name, bounds in angles.items():
        degrees = math.degrees(0.75 * bounds.high)
        table: dict[str, Any] = {name.rpartition(".")[2]: degrees}
        for part in reversed(name.split(".")[:-1]):
            table = {part: table}
        with pytest.raises(ConfigError, match=rf"did you mean {0.75 * bounds.high:.4g} rad.*\? allowed: "):
            merge(Config(), table)
    with pytest.raises(ConfigError, match=r"^laser\.fov: found -1\.0, allowed: above 0 to 6\.28319 rad$"):
        merge(Config(), {"laser": {"fov": -1.0}})


def test_a_goal_and_a_tour_go_not_together_and_the_later_one_replaces_the_other(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"^goal: found beside a tour, allowed: one of the two$"):
        Config(goal=(0.0, 0.0), tour=((1.0, 1.0),))
    tour = merge(Config(), {"tour": [[1, 1]]})
    assert (merge(tour, {"goal": [2, 2]}).goal, merge(tour, {"goal": [2, 2]}).tour) == ((2.0, 2.0), None)
    assert merge(Config(goal=(2.0, 2.0)), {"tour": [[1, 1]]}) == tour
    saved = written(tmp_path, 'task = "tour"\ngoal = [2, 2]\ntour = [[1, 1]]\n[versions]\nsixthsense = "0.1.0"')
    assert load_config(saved).tour == tour.tour  # of a version that took both


def test_a_configuration_cannot_be_changed() -> None:
    with pytest.raises(dataclasses.FrozenInstanceError):
        Config().seed = 3  # type: ignore[misc]


def test_absent_values_are_left_out_of_the_table() -> None:
    assert "goal" not in as_table(Config())
    assert as_table(dataclasses.replace(Config(), goal=(1.0, 2.0)))["goal"] == (1.0, 2.0)


@pytest.mark.parametrize(
    "text", ["a." * 4000 + "a = 1", "[" + '"b" . ' * 4000 + "b]", "x = {" + "a." * 4000 + "a = 1}"]
)
def test_a_key_of_thousands_of_parts_is_refused_at_once(text: str, tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text(text)
    with pytest.raises(ConfigError, match="key of over 20 parts"):
        load_config(tmp_path / "deep.toml")
    with pytest.raises(SceneError, match="key of over 20 parts"):
        load_scene(tmp_path / "deep.toml")
