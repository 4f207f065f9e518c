"""What other files must agree with; `make docs` builds the site and checks its links."""

import re
import tomllib
from pathlib import Path

from sixthsense.config.version import __version__

ROOT = Path(__file__).parents[2]


def test_every_notebook_is_a_page_of_the_site_under_its_name() -> None:
    listed = re.findall(r"^ +- notebooks/(\w+)\.md$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert listed == sorted(notebook.stem for notebook in (ROOT / "notebooks").glob("*.ipynb"))


def test_the_version_and_the_repository_are_the_same_everywhere() -> None:
    repository = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["urls"]["Homepage"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert f"\nversion: {__version__}\n" in citation and f"repository-code: {repository}\n" in citation
