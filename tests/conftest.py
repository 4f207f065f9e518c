import os
from pathlib import Path

import hypothesis
import pytest

import sixthsense as ss
from sixthsense.running.warmup import warm_up

# Before NumPy is imported: the matrices of the tests are small, and each worker of xdist has one core.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


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
def data_dir() -> Path:
    """The folder of real logs and maps; its licences keep it out of the repository."""
    folder = os.environ.get("SIXTHSENSE_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("needs real data: set SIXTHSENSE_DATA to a folder with intel/, maps/ and scenes_report/")
    return Path(folder)


pytest.register_assert_rewrite(
    "sixthsense.testing.contract",
    "sixthsense.testing.edges",
    "sixthsense.testing.estimation",
    "sixthsense.testing.posterior",
    "sixthsense.testing.walls",
    "laws",
)
