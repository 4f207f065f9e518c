"""Code of the user's: where it is searched, when it is told that it cannot be made, and what `main` leaves behind."""

import errno
import gc
import sys

import pytest

import sixthsense as ss
from sixthsense import cli
from sixthsense.config.errors import PartError

pytestmark = pytest.mark.usefixtures("here")

EVIL = "from pathlib import Path\nPath('ran').touch()\nfrom sixthsense.slam.estimators.ekf import EKF as X\n"


@pytest.fixture
def evil(here):
    """A module in the working folder that leaves a file when it is run, and files that name its part."""
    (here / "evil.py").write_text(EVIL)
    (here / "evil.toml").write_text("estimator = 'evil:X'\n")
    (here / "theirs").mkdir()
    (here / "theirs" / "config.toml").write_text("estimator = 'evil:X'\n[versions]\nsixthsense = '0'\n")
    yield here
    sys.modules.pop("evil", None)


@pytest.mark.parametrize("line", ["run --config evil.toml", "replay theirs", "campaign rectangle --seeds 0:1 --out c "
                                  "--config evil.toml"])  # fmt: skip
def test_a_part_that_only_a_file_names_is_refused_and_not_run(line, evil, complaint):
    assert "evil:X, which cannot be imported" in complaint(*line.split(), writes_nothing=False)
    assert not (evil / "ran").exists() and "evil" not in sys.modules


@pytest.mark.parametrize("words", ["--estimator evil:X", "--config evil.toml --parts ."])
def test_a_part_that_the_command_line_allows_is_run(words, evil):
    assert cli.main(["run", "nowhere", *words.split()]) == cli.BAD_INPUT
    assert (evil / "ran").exists()


@pytest.mark.parametrize(("error", "code"), [(MemoryError(), 71), (OSError(errno.ENOSPC, "no space"), 74),
                                             (OSError(errno.EACCES, "denied"), 2)])  # fmt: skip
def test_memory_and_disk_have_exit_codes_of_their_own_and_the_collector_is_left_as_it_was(error, code, monkeypatch):
    thresholds = gc.get_threshold()

    def fail(*_):
        raise error

    monkeypatch.setattr("sixthsense.cli.listing.Parts.run", fail)
    assert cli.main(["parts"]) == code and gc.get_threshold() == thresholds


UNMADE = {
    "estimator": ("class Own:\n    def __init__(self, start, cov): 1 / 0\n", "it raised ZeroDivisionError"),
    "front_end": ("class Own:\n    def __init__(self, setup): pass\n    def take(self, seen): pass\n", "has no .*pose"),
    "planner": ("class Own:\n    def __init__(self): pass\n", "it raised TypeError"),
}  # fmt: skip


@pytest.mark.parametrize("kind", UNMADE)
def test_a_part_that_cannot_be_made_is_one_line_before_anything_is_written(kind, here, capsys, monkeypatch):
    body, said = UNMADE[kind]
    (here / f"own_{kind}.py").write_text(body)
    monkeypatch.syspath_prepend(here)
    with pytest.raises(PartError, match=said):
        ss.run("rectangle", out="x", progress=False, **{kind: f"own_{kind}:Own"})
    flag = f"--{kind.replace('_', '-')}"
    assert cli.main(["run", "rectangle", flag, f"own_{kind}:Own", "--out", "x"]) == cli.FAILED
    err = capsys.readouterr().err
    assert err.count("\n") == 1 and "Traceback" not in err
    assert {path.name for path in here.iterdir()} <= {f"own_{kind}.py", "__pycache__"}
