import dataclasses
import math
from pathlib import Path
from typing import Any

import pytest

from sixthsense.config import (
    PRESETS,
    Config,
    ConfigError,
    Section,
    load_config,
    preset,
    save_config,
)


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
def test_a_saved_configuration_is_read_back_as_it_was(name: str, tmp_path: Path) -> None:
    config = dataclasses.replace(preset(name), seed=2**40, goal=(0.1, 1 / 3), start=(1e-300, -2.0, math.pi))
    assert config.preset == name
    save_config(config, tmp_path / "config.toml")
    assert load_config(tmp_path / "config.toml") == config


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


BAD_FIELDS = {
    "laser.beams": ('[laser]\nbeams = "many"', "'many'", "a whole number"),
    "laser.beams ": ("[laser]\nbeams = 1.5", "1.5", "a whole number"),
    "laser.beams  ": ("[laser]\nbeams = 1", "1", "2 to 100000"),
    "laser.beems": ("[laser]\nbeems = 3", "beems", "beams, fov, max_range"),
    "laser": ("laser = 3", "3", "a table"),
    "laser.max_range": ("[laser]\nmax_range = nan", "nan", "a finite number"),
    "laser.max_range  ": ("[laser]\nmax_range = 0", "0", "above 0"),
    "laser.mount": ("[laser]\nmount = [1, 2]", "[1, 2]", "3 numbers"),
    "world.motion.speed": ("[world.motion]\nspeed = -0.1", "-0.1", "0 to 100"),
    "follow.shortcut": ("[follow]\nshortcut = 1", "1", "true or false"),
    "association.match_probability": ("[association]\nmatch_probability = 1.0", "1.0", "above 0"),
    "estimator": ('estimator = "ekff"', "'ekff'", "ekf"),
    "scene": ("scene = 3", "3", "a text"),
    "max_time": (f"max_time = 1{'0' * 400}", "1000", "a finite number"),
    "preset": ('preset = "no"', "'no'", "default, worn, noiseless, report, log"),
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
