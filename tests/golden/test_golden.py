"""What six small runs write is what it was, to the digits that survive; `python tests/golden/rewrite.py` after a change
that is meant."""

from pathlib import Path

import pytest

from golden.cases import CASES
from golden.figures import figures, moved, read

HERE = Path(__file__).parent


@pytest.mark.parametrize("name", CASES)
def test_a_golden_run_writes_the_figures_that_it_wrote(name: str, tmp_path: Path) -> None:
    CASES[name](tmp_path, 0.0)
    changes = moved(read(HERE / f"{name}.txt"), figures(tmp_path / "run"))
    assert not changes, f"{len(changes)} figures of {name} moved:\n" + "\n".join(changes)
