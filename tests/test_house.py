"""The structure of the package, checked on its syntax trees: rooms, imports, sizes."""

import ast
import graphlib
import re
import tomllib
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "sixthsense"
EXCEPTIONS = "## Exceptions to the limits"

MAX_FUNCTION_LINES = 60
MAX_PARAMETERS = 8
MAX_FIELDS = 15
MANY_FIELDS = ("sixthsense.config.*", "sixthsense.record.trace")
"""modules of settings and of the record's columns, which the limit of fields excepts"""

Function = ast.FunctionDef | ast.AsyncFunctionDef


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def sources() -> dict[str, str]:
    return {module_name(path): path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}


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


def excepted(importer: str, imported: str) -> bool:
    pairs = (line.split(" -> ") for line in contract()[1])
    return any(fnmatchcase(importer, left) and fnmatchcase(imported, right) for left, right in pairs)


def functions(module: str) -> list[Function]:
    return [node for node in nodes()[module] if isinstance(node, Function)]


def classes(module: str) -> list[ast.ClassDef]:
    return [node for node in nodes()[module] if isinstance(node, ast.ClassDef)]


def line_count(function: Function) -> int:
    assert function.end_lineno is not None
    return function.end_lineno - function.lineno + 1


def parameter_count(function: Function) -> int:
    found = function.args
    parameters = [*found.posonlyargs, *found.args, found.vararg, *found.kwonlyargs, found.kwarg]
    return len([one for one in parameters if one is not None and one.arg not in ("self", "cls")])


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
            sizes[name, "parameters"] = parameter_count(function), MAX_PARAMETERS
        if not any(fnmatchcase(module, pattern) for pattern in MANY_FIELDS):
            for definition in classes(module):
                sizes[f"{module}.{definition.name}", "fields"] = field_count(definition), MAX_FIELDS
    return {f"{name}: {limit}": found for (name, limit), (found, allowed) in sizes.items() if found > allowed}


def listed_exceptions() -> dict[str, str]:
    """Reason of each exception by "name: limit", from the table in CONTRIBUTING.md."""
    _, _, section = (ROOT / "CONTRIBUTING.md").read_text().partition(f"\n{EXCEPTIONS}\n")
    rows = re.findall(r"^\| `(.+?)` \| (.+?) \| (.+?) \|$", section.partition("\n## ")[0], re.MULTILINE)
    return {f"{name}: {limit}": reason for name, limit, reason in rows}


def test_two_modules_at_most_lie_beside_the_rooms() -> None:
    beside = {path.stem for path in PACKAGE.glob("*.py")} - {"__init__"}
    assert beside <= {"api", "loop"}


def test_every_room_is_a_layer_and_every_layer_a_room() -> None:
    rooms = {room(module) for module in sources()} - {"sixthsense"}
    assert rooms == set(contract()[0])


def test_every_import_between_rooms_runs_downwards() -> None:
    below = {layer: depth for depth, layer in enumerate(contract()[0])}
    upwards = {
        f"{importer} -> {imported}"
        for importer, imported in imports()
        if importer != "sixthsense" and not excepted(importer, imported)
        if below[room(importer)] > below.get(room(imported), -1)
    }
    assert upwards == set()


def test_no_import_is_excepted_from_the_layers() -> None:
    assert contract()[1] == []


def test_no_modules_import_each_other_in_a_circle() -> None:
    graph: dict[str, set[str]] = {}
    for importer, imported in imports():
        if not excepted(importer, imported):
            graph.setdefault(importer, set()).add(imported)
    graphlib.TopologicalSorter(graph).prepare()  # raises CycleError, which names the modules


def test_what_exceeds_a_limit_is_listed_with_a_reason() -> None:
    assert set(beyond_limits()) == set(listed_exceptions())
    assert all(listed_exceptions().values())


def test_folders_of_tests_have_the_names_of_rooms() -> None:
    """Or of a folder beside the package, benchmarks or docs; or golden, whose runs go through all rooms."""
    tests = ROOT / "tests"
    for folder in {path.parent.relative_to(tests) for path in tests.rglob("test_*.py")} - {Path(), Path("golden")}:
        assert (PACKAGE / folder).is_dir() or (PACKAGE / folder).with_suffix(".py").exists() or (ROOT / folder).is_dir()
