"""The structure of the package, checked on its syntax trees: rooms, imports, sizes, budget of code lines."""

import ast
import graphlib
import re
import tomllib
from collections import Counter
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "sixthsense"
EXCEPTIONS = "## Exceptions to the limits"
BUDGET = "## Budget of code lines"

MAX_FUNCTION_LINES = 60
MAX_FIELDS = 15
MANY_FIELDS = ("sixthsense.config.*", "sixthsense.record.trace")
"""modules of settings and of the record's columns, which the limit of fields excepts"""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def sources() -> dict[str, str]:
    files = [*PACKAGE.rglob("*.py"), PACKAGE / "config" / "fields.pyi"]
    return {module_name(path): path.read_text() for path in sorted(files)}


@cache
def nodes() -> dict[str, list[ast.AST]]:
    """All nodes of each module's tree."""
    return {module: list(ast.walk(ast.parse(text))) for module, text in sources().items()}


@cache
def contract() -> tuple[list[str], list[str]]:
    """The layers, from the top down, and the imports that the contract of layers ignores."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (layers,) = (found for found in settings["contracts"] if found["type"] == "layers")
    return layers["layers"], layers.get("ignore_imports", [])


@cache
def imports() -> frozenset[tuple[str, str]]:
    """Pairs of modules of the package, importer and imported, wherever in the importer the statement stands."""
    return frozenset((module, target) for module in nodes() for target in targets(module))


def targets(module: str) -> set[str]:
    found = set()
    for node in nodes()[module]:
        if isinstance(node, ast.Import):
            found |= {known(alias.name) for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{module}:{node.lineno}: relative import"
            found |= {known(f"{node.module}.{alias.name}") for alias in node.names}
    return {name for name in found if name is not None and name != module}


def known(name: str) -> str | None:
    """The module of the package that `name` lies in or is, None for a name from elsewhere."""
    if name.split(".")[0] != "sixthsense":
        return None
    while name not in sources():
        name = name.rpartition(".")[0]
    return name


def room(module: str) -> str:
    return ".".join(module.split(".")[:2])


def functions(module: str) -> list[Function]:
    return [node for node in nodes()[module] if isinstance(node, Function)]


def classes(module: str) -> list[ast.ClassDef]:
    return [node for node in nodes()[module] if isinstance(node, ast.ClassDef)]


def line_count(function: Function) -> int:
    assert function.end_lineno is not None
    return function.end_lineno - function.lineno + 1


def field_count(definition: ast.ClassDef) -> int:
    annotated = [one for one in definition.body if isinstance(one, ast.AnnAssign)]
    return len([one for one in annotated if "ClassVar" not in ast.unparse(one.annotation)])


def beyond_limits() -> dict[str, int]:
    """What is larger than allowed, by "name limit", with its size."""
    sizes: dict[tuple[str, str], tuple[int, int]] = {}
    for module in sources():
        for function in functions(module):
            name = f"{module}.{function.name}"
            sizes[name, "lines of a function"] = line_count(function), MAX_FUNCTION_LINES
        if not any(fnmatchcase(module, pattern) for pattern in MANY_FIELDS):
            for definition in classes(module):
                sizes[f"{module}.{definition.name}", "fields"] = field_count(definition), MAX_FIELDS
    return {f"{name}: {limit}": found for (name, limit), (found, allowed) in sizes.items() if found > allowed}


def rows_of_table(heading: str) -> list[tuple[str, ...]]:
    """Cells of the rows of three columns in a section of CONTRIBUTING.md, but for the table's first two lines."""
    _, _, section = (ROOT / "CONTRIBUTING.md").read_text().partition(f"\n{heading}\n")
    return re.findall(r"^\| (.+?) \| (.+?) \| (.+?) \|$", section.partition("\n## ")[0], re.MULTILINE)[2:]


def listed_exceptions() -> dict[str, str]:
    """Reason of each exception by "name: limit"."""
    return {f"{name.strip('`')}: {limit}": reason for name, limit, reason in rows_of_table(EXCEPTIONS)}


def budget() -> dict[str, tuple[list[str], int]]:
    """Rooms of each group, and how many code lines they may have together."""
    return {
        group: (re.findall(r"`(.+?)`", rooms), int(lines.replace(",", "")))
        for group, rooms, lines in rows_of_table(BUDGET)
    }


def code_lines(text: str) -> int:
    """Lines of a module that are not blank, a comment or part of a docstring."""
    counted = {n for n, line in enumerate(text.split("\n"), 1) if line.strip() and not line.lstrip().startswith("#")}
    docstrings: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            docstrings.update(range(node.lineno, (node.end_lineno or 0) + 1))
        elif isinstance(node, ast.Constant | ast.JoinedStr):
            counted.update(range(node.lineno, (node.end_lineno or 0) + 1))
    return len(counted - docstrings)


@cache
def code_lines_of_folders() -> dict[str, int]:
    """Code lines by the folder of the package that they lie in, `sixthsense` itself included, and by that beside it."""
    lines: Counter[str] = Counter()
    for top in ("sixthsense", "tests", "benchmarks", "notebooks"):
        for path in (ROOT / top).rglob("*.py"):
            parts = path.relative_to(ROOT).parts[:-1]
            lines["/".join(parts[: 2 if top == "sixthsense" else 1])] += code_lines(path.read_text())
    return dict(lines)


def beyond_budget(lines: dict[str, int]) -> dict[str, int]:
    """By how many lines groups exceed their numbers; by all of its lines each folder that is in no group."""
    groups = budget()
    excess = {name: sum(lines.get(one, 0) for one in rooms) - allowed for name, (rooms, allowed) in groups.items()}
    grouped = {one for rooms, _ in groups.values() for one in rooms}
    return {name: count for name, count in excess.items() if count > 0} | {
        f"{folder}, in no group": count for folder, count in lines.items() if folder not in grouped
    }


def test_two_modules_at_most_lie_beside_the_rooms() -> None:
    beside = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert beside <= {"api", "loop"}


def test_every_room_is_a_layer_and_every_layer_a_room() -> None:
    """None is excepted; `lint-imports` checks that imports run downwards."""
    layers, ignored = contract()
    assert {room(module) for module in sources()} - {"sixthsense"} == {*layers} and ignored == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph: dict[str, set[str]] = {}
    for importer, imported in imports():
        graph.setdefault(importer, set()).add(imported)
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules


def test_what_exceeds_a_limit_is_listed_with_a_reason() -> None:
    assert set(beyond_limits()) == set(listed_exceptions())
    assert all(listed_exceptions().values())


def test_each_group_of_rooms_keeps_its_budget_of_code_lines() -> None:
    assert beyond_budget(code_lines_of_folders()) == {}


def test_a_line_too_many_and_a_room_in_no_group_exceed_the_budget() -> None:
    lines = {room: 0 for rooms, _ in budget().values() for room in rooms}
    lines["sixthsense/core"] = budget()["core"][1]
    assert beyond_budget(lines) == {}
    lines["sixthsense/core"] += 1
    assert beyond_budget(lines | {"sixthsense/attic": 3}) == {"core": 1, "sixthsense/attic, in no group": 3}


def test_code_lines_are_those_without_blank_lines_comments_and_docstrings() -> None:
    text = '"""One\n\ntwo."""\n\nx = 1  # three\n# four\ny = (\n    """five\n    six""",\n)\nx: int\n"""seven"""\n'
    assert code_lines(text) == 6


def test_folders_of_tests_have_the_names_of_rooms() -> None:
    """Or of a folder beside the package, benchmarks or docs; or golden, whose runs go through all rooms."""
    tests = ROOT / "tests"
    for folder in {path.parent.relative_to(tests) for path in tests.rglob("test_*.py")} - {Path(), Path("golden")}:
        assert (PACKAGE / folder).is_dir() or (PACKAGE / folder).with_suffix(".py").exists() or (ROOT / folder).is_dir()
