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


@pytest.mark.parametrize(
    ("call", "said"),
    [
        (lambda: ss.run("rectangle", out=3), "out: found 3, allowed: a path"),
        (lambda: ss.run(["rectangle", "office"]), "scene: found ['rectangle', 'office'], allowed: a path"),
        (lambda: ss.load(["runs/a", "runs/b"]), "folder: found ['runs/a', 'runs/b'], allowed: a path"),
        (lambda: ss.merge_runs("runs/a", ["runs/b"]), "second: found ['runs/b'], allowed: a path"),
        (lambda: ss.replay(["a.clf"]), "log: found ['a.clf'], allowed: a file or folder of a log"),
        (lambda: ss.compare(5), "runs: found 5, allowed: a list of runs or folders"),
        (lambda: ss.Slam("ekf"), "config: found 'ekf', allowed: a Config"),
        (lambda: ss.Slam(start=(0.4, 0.6, 0.1)), "start: expected a Pose(x, y, theta), got (0.4, 0.6, 0.1)"),
        (lambda: moved(0.5), "stamp_ns: found 0.5, allowed: a whole number"),
    ],
)
def test_an_argument_of_another_kind_is_named_in_one_line(call, said):
    with pytest.raises(ValueError) as raised:
        call()
    assert str(raised.value).startswith(said) and "\n" not in str(raised.value)


def moved(stamp_ns):
    """The step of a robot whose wheels say where it is."""
    with ss.Slam() as slam:
        return slam.odometry(stamp_ns, ss.Pose(0.4, 0.6, 0.1))
