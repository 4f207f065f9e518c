"""The workflows, which run on GitHub alone, as far as they can be checked here: syntax, rights, targets, files."""

import re
from pathlib import Path

import pytest
import yaml

from sixthsense.config.version import __version__

ROOT = Path(__file__).parents[2]
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))


@pytest.mark.parametrize("file", WORKFLOWS, ids=lambda file: str(file.stem))
def test_a_workflow_may_only_read_and_its_jobs_end_and_its_targets_are_there(file: Path) -> None:
    text = file.read_text(encoding="utf-8")
    workflow = yaml.safe_load(text)
    assert workflow["permissions"] == {"contents": "read"}
    assert all("timeout-minutes" in job and "runs-on" in job for job in workflow["jobs"].values())
    targets = re.findall(r"^(\w[\w-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert {word for line in re.findall(r"run: make (.+)", text) for word in line.split()} <= set(targets)
    needed = {name for job in workflow["jobs"].values() for name in [job.get("needs")] if name}
    assert needed <= set(workflow["jobs"])


def test_a_release_is_made_from_a_tag_that_is_the_version_and_needs_no_secret() -> None:
    text = (ROOT / ".github" / "workflows" / "release.yml").read_text(encoding="utf-8")
    workflow = yaml.safe_load(text)
    assert workflow[True] == {"push": {"tags": ["v*"]}}  # YAML 1.1 reads `on` as true
    assert workflow["jobs"]["publish"]["permissions"] == {"id-token": "write"} and "secrets." not in text
    line = f'__version__ = "{__version__}"'
    assert line in (ROOT / "sixthsense" / "config" / "version.py").read_text(encoding="utf-8").splitlines()


def test_pre_commit_checks_what_make_check_checks() -> None:
    (repository,) = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text(encoding="utf-8"))["repos"]
    commands = " ".join(hook["entry"] for hook in repository["hooks"])
    assert all(f".venv/bin/{tool}" in commands for tool in ("ruff check", "ruff format", "mypy", "lint-imports"))
