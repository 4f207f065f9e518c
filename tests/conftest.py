import os
from pathlib import Path

import pytest


@pytest.fixture
def data_dir() -> Path:
    """The folder of real logs and maps; its licences keep it out of the repository."""
    folder = os.environ.get("SIXTHSENSE_DATA")
    if not folder or not Path(folder).is_dir():
        pytest.skip("needs real data: set SIXTHSENSE_DATA to a folder with intel/, maps/ and scenes_report/")
    return Path(folder)


pytest.register_assert_rewrite(
    "sixthsense.testing.contract", "sixthsense.testing.edges", "sixthsense.testing.estimation"
)
