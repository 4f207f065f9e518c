import subprocess
import sys

import pytest

import sixthsense as ss


def test_every_public_name_is_there():
    assert "run" in ss.__all__ and len(ss.__all__) > 25
    for name in ss.__all__:
        assert getattr(ss, name) is not None
    assert set(ss.__all__) <= set(dir(ss))


def test_importing_the_package_imports_nothing_heavy():
    code = "import sys, sixthsense; assert not {'numpy', 'numba', 'scipy', 'matplotlib'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_run_is_a_function_whoever_imported_the_loop_first():
    code = "import sixthsense.loop.run, sixthsense as ss; assert callable(ss.run) and callable(ss.replay)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_five_lines_are_enough(tmp_path):
    run = ss.run(ss.preset("worn", scene="rectangle", task="tour", max_time=20.0, seed=3))
    assert run.outcome == "tour ended" and run.metrics["ate_rmse_m"] < 0.05
    ss.save_map(run, tmp_path / "map.png")
    assert (tmp_path / "map.png").is_file()


def test_changes_over_a_preset_may_be_nested_and_are_checked():
    config = ss.preset("report", laser={"beams": 90}, seed=7)
    assert (config.laser.beams, config.laser.max_range, config.seed) == (90, 5.0, 7)
    with pytest.raises(ss.InputError, match=r"laser\.beam: no such field"):
        ss.preset(laser={"beam": 90})
