"""Whether the pages of docs/ are true: their code runs, and they name all that there is to name."""

import json
import os
import re
import subprocess
import sys
import types
from pathlib import Path

import matplotlib
import pytest

import sixthsense as ss
from sixthsense.cli.listing import parser_of
from sixthsense.cli.runs import Run
from sixthsense.config import Section
from sixthsense.logs.runfolder import FILE, read_messages

DOCS = Path(__file__).parents[2] / "docs"
PAGES = ["start.md", "concepts/consistency.md", *sorted(f"howto/{page.name}" for page in DOCS.glob("howto/*.md"))]
NEEDS = {"howto/interop.md": "evo"}
SHORTER_S = {"10": 4, "20": 4, "25": 14, "60": 8, "120": 16}
"""what a drive of so many seconds is cut to, as far as what follows it on its page allows"""

sys.path.insert(0, str(DOCS / "hooks"))
from page_code import script  # noqa: E402


def cut_short(program: str) -> str:
    """With shorter drives: whether the code runs is seen by then."""
    times = rf"(max.time(?:', '|=))({'|'.join(SHORTER_S)})\b"
    return re.sub(times, lambda found: f"{found[1]}{SHORTER_S[found[2]]}", program)


@pytest.mark.parametrize("page", [page for page in PAGES if page not in NEEDS])
def test_the_code_of_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    module = types.ModuleType("page")  # a part of one's own is one that can be imported
    monkeypatch.setitem(sys.modules, "page", module)
    exec(compile(cut_short(script(page, tmp_path)), page, "exec"), module.__dict__)


@pytest.mark.parametrize("page", NEEDS)
def test_the_code_of_a_page_on_other_programs_runs_in_a_process_of_its_own(page, tmp_path):
    """And in a home of its own: evo keeps settings there. It finds the absolute error that the metrics have."""
    pytest.importorskip(NEEDS[page])
    own = {"HOME": str(tmp_path), "MPLCONFIGDIR": matplotlib.get_cachedir(), "MPLBACKEND": "agg"}
    command, env = [sys.executable, "-c", cut_short(script(page, tmp_path))], os.environ | own
    done = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, check=False, timeout=600)
    assert done.returncode == 0, done.stderr
    own = json.loads((tmp_path / "runs/smoother/metrics.json").read_text())["ate_rmse_m"]
    assert own > 1e-4 and own == pytest.approx(float(re.findall(r"^0\.\d+$", done.stdout, re.MULTILINE)[0]), abs=1e-6)


def test_no_two_pages_write_the_same_folder():
    """Whoever reads one after the other is else told that the folder exists."""
    written = {"runs/first": "Makefile"}
    for page in PAGES:
        text = (DOCS / page).read_text(encoding="utf-8")
        for folder in re.findall(r"^\$ sixthsense .* --out (\S+)", text, re.MULTILINE):
            assert written.setdefault(folder, page) == page, folder
    assert len(written) > 20


def test_every_public_name_has_its_place_in_the_reference():
    page, _, _ = (DOCS / "reference" / "api.md").read_text(encoding="utf-8").partition("## Behind these names")
    named = re.findall(r"^::: sixthsense\.(\w+)$", page, re.MULTILINE)
    assert sorted(named) == sorted(ss.__all__)


def test_every_metric_is_explained():
    import reference

    page = reference.metrics()
    run = ss.run("rectangle", goal=(1.4, 0.5))
    assert run.outcome == "goal reached"
    assert all(f"\n| `{key}` |" in page for key in run.metrics)


def test_every_channel_of_a_record_is_on_its_page(tmp_path):
    ss.run("rectangle", max_time=3.0, out=tmp_path / "run", progress=False)
    messages, _ = read_messages(tmp_path / "run" / FILE)
    page = (DOCS / "reference" / "folder.md").read_text(encoding="utf-8")
    channels = {re.sub(r"\d+$", "0", message.channel) for message in messages}
    assert "end" in channels and channels <= {*re.findall(r"`([\w.]+)`", page)}


def test_every_field_of_the_configuration_has_a_row_with_its_meaning():
    import reference

    rows = dict(re.findall(r"^\| `([\w.]+)` \|.* \| (.+?) \|$", reference.configuration(), re.MULTILINE))

    def fields(section, path=""):
        for name, field in section.model_fields.items():
            if isinstance(field.annotation, type) and issubclass(field.annotation, Section):
                yield from fields(field.annotation, f"{path}{name}.")
            else:
                yield path + name

    assert set(fields(ss.Config)) <= set(rows)
    assert all(rows.values())


def test_every_field_that_a_page_names_as_an_option_exists():
    flags = {flag for action in parser_of("run", Run)._actions for flag in action.option_strings}
    sections = {flag.rpartition(".")[0] for flag in flags}
    pages = [DOCS.parent / "README.md", *DOCS.rglob("*.md")]
    named = {
        flag for page in pages for flag in re.findall(r"(?<![\w-])--[a-z0-9]+\.[\w.-]*\w", page.read_text("utf-8"))
    }
    assert len(named) > 20
    assert {flag for flag in named if flag.replace("_", "-").replace(".no-", ".") not in flags | sections} == set()


class Page:
    class file:  # noqa: N801
        src_uri = "some.md"


def test_formulae_become_mathml_and_what_nobody_knows_stops_the_build():
    pytest.importorskip("latex2mathml", reason="needs the extra docs")
    import mathematics
    from mkdocs.exceptions import PluginError

    marked = '<p><span class="arithmatex">\\({}\\)</span></p>'
    made = mathematics.on_page_content(marked.format(r"a &lt; \frac{1}{2}"), Page)
    assert "<math" in made and "<mfrac>" in made and "arithmatex" not in made
    with pytest.raises(PluginError, match=r"some\.md: found .*nonsense"):
        mathematics.on_page_content(marked.format(r"\nonsense{1}"), Page)
