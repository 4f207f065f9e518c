import os
import signal
from collections.abc import Callable
from pathlib import Path

import hypothesis
import pytest

import sixthsense as ss
from sixthsense.cli import BAD_INPUT, main
from sixthsense.running.warmup import warm_up

# Before NumPy is imported: the matrices of the tests are small, and each worker of xdist has one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# What runs in the background of a shell ignores Ctrl-C.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# The first example of a test may compile a kernel.
hypothesis.settings.register_profile("kernels", deadline=None)
hypothesis.settings.load_profile("kernels")


@pytest.fixture(scope="session")
def explored() -> ss.Run:
    """The exploration of the scene rectangle by a short-sighted robot, one for all tests that only read it."""
    return ss.run("rectangle", seed=1, laser={"max_range": 2.0}, progress=False)


@pytest.fixture(scope="session")
def compiled() -> None:
    """Compile the kernels before a test that looks at times or at what is printed."""
    warm_up()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder to stand in."""
    folder = tmp_path / "here"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def complaint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., str]:
    """What a command says to bad input or a full disk: one line, without the program's name; it writes nothing."""

    def said(*words: object, writes_nothing: bool = True, code: int = BAD_INPUT) -> str:
        before = sorted(tmp_path.rglob("*"))
        capsys.readouterr()
        assert main([str(word) for word in words]) == code
        out, err = capsys.readouterr()
        assert out == "" and err.count("\n") == 1 and err.startswith("sixthsense: ") and "Traceback" not in err
        assert not writes_nothing or sorted(tmp_path.rglob("*")) == before
        return err.removeprefix("sixthsense: ").strip()

    return said


@pytest.fixture
def data_dir() -> Path:
    """The folder of real logs and maps; its licences keep it out of the repository."""
    folder = os.environ.get("SIXTHSENSE_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("needs real data: set SIXTHSENSE_DATA to a folder with intel/, maps/ and scenes_report/")
    return Path(folder)


pytest.register_assert_rewrite("laws", "point_world")
