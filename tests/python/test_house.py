"""The house stands: modules import downwards only, and none uses what is private to another."""

import ast
import itertools
import re
from collections import Counter
from pathlib import Path

import pytest

import linkside

ROOT = Path(linkside.__file__).parent

LAYERS = (
    ("errors",),
    ("arrays", "channels", "findings", "mapping", "text"),
    ("arguments",),
    ("statistics", "files"),
    ("figures",),
    ("report",),
    ("robot",),
    ("recording",),
    ("observers", "kalman", "observability", "velocity"),
    ("particle", "scene", "comparison", "consistency", "control"),
    ("tuning", "calibration", "simulation", "learning", "demo"),
    ("papers", "excitation", "fleet"),
    ("linkside", "cli"),
    ("__main__",),
)
"""Packages and modules of `linkside` from the ground up; those of one line do not import each other."""


def modules():
    """Each module's name, its syntax tree, and whether it is a package."""
    for path in sorted(ROOT.rglob("*.py")):
        parts = path.relative_to(ROOT.parent).with_suffix("").parts
        package = parts[-1] == "__init__"
        yield ".".join(parts[:-1] if package else parts), ast.parse(path.read_text()), package


TREES = {name: tree for name, tree, _ in modules()}
PACKAGES = {name for name, _, package in modules() if package}


def imports(name):
    """Modules of the package that a module imports, wherever in its text, with the names taken from each."""
    for node in ast.walk(TREES[name]):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names if alias.name in TREES)
        elif isinstance(node, ast.ImportFrom):
            source = absolute(name, node)
            for alias in node.names if source.partition(".")[0] == "linkside" else ():
                whole = f"{source}.{alias.name}"
                if "linkside._core" not in (source, whole):  # written in Rust, below all of this
                    yield (whole, "") if whole in TREES else (source, alias.name)


def absolute(name, node):
    """The module that ``from … import`` names."""
    if not node.level:
        return node.module or ""
    parts = name.split(".")
    above = parts[: len(parts) - node.level + (name in PACKAGES)]
    return ".".join([*above, node.module] if node.module else above)


def room(name):
    """The package, or single module, directly below `linkside` in which a module is."""
    return name.split(".")[1] if "." in name else name


@pytest.mark.parametrize("level", [lambda name: name, room], ids=["modules", "packages"])
def test_no_import_circle(level):
    graph = {}
    for name in TREES:
        below = {level(other) for other, _ in imports(name)}
        graph.setdefault(level(name), set()).update(below - {level(name)})
    while leaves := [name for name, below in graph.items() if not below & graph.keys()]:
        for name in leaves:
            del graph[name]
    assert not graph, f"these import each other, or what does: {', '.join(sorted(graph))}"


def test_no_import_from_above():
    height = {name: level for level, names in enumerate(LAYERS) for name in names}
    assert {room(name) for name in TREES} == height.keys(), "a package is not in LAYERS, or is no longer there"
    upward = [
        f"{name} imports {other}"
        for name in TREES
        for other, _ in imports(name)
        if room(name) != room(other) and height[room(other)] >= height[room(name)]
    ]
    assert upward == []


def is_private(name):
    return name.startswith("_") and not name.startswith("__")


def test_no_private_name_is_imported():
    assert [f"{name}: {taken}" for name in TREES for _, taken in imports(name) if is_private(taken)] == []


def own_names(tree):
    """Names that a module gives to something of its own."""
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            yield node.name
        elif isinstance(node, ast.Name | ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.id if isinstance(node, ast.Name) else node.attr


def is_foreign(node, own):
    """Whether an attribute is private to an object of a class of another module."""
    if not (isinstance(node, ast.Attribute) and is_private(node.attr)):
        return False
    on_itself = isinstance(node.value, ast.Name) and node.value.id in ("self", "cls", "linkside")
    return not on_itself and node.attr not in own


def test_no_private_attribute_of_another_module_is_used():
    found = []
    for name, tree in TREES.items():
        own = set(own_names(tree))
        found += [f"{name}: {ast.unparse(node)}" for node in ast.walk(tree) if is_foreign(node, own)]
    assert found == []


CORE = Path(__file__).parents[2] / "rust" / "core"
CRATES = [path for path in (Path(__file__).parents[2] / "rust").glob("*/src") if path.is_dir()]


@pytest.mark.parametrize("crate", CRATES, ids=[path.parent.name for path in CRATES])
def test_a_type_of_a_crate_has_a_name_of_its_own(crate):
    defined = re.compile(
        r"^\s*(?:pub(?:\([a-z() ]+\))? )?(?:unsafe )?(?:struct|enum|union|trait|(?<=pub )type) (\w+)", re.M
    )
    assert homonyms(name for path in crate.rglob("*.rs") for name in defined.findall(path.read_text())) == []


def test_the_core_says_what_it_does():
    """Lines of documentation to lines of code, tests apart."""
    code = documentation = 0
    for path in (CORE / "src").rglob("*.rs"):
        text = "" if path.name == "tests.rs" else path.read_text().partition("#[cfg(test)]\nmod tests")[0]
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        said = sum(line.startswith(("///", "//!")) for line in lines)
        documentation += said
        code += sum(not line.startswith("//") for line in lines)
    assert documentation > 0.23 * code


@pytest.mark.parametrize(
    "item",
    [
        "robot/mod.rs: pub struct Robot",
        "estimate/observer/acceleration_observer.rs: pub struct AccelerationObserver",
        "estimate/kalman/filter.rs: pub struct ExtendedKalmanFilter",
        "estimate/kalman/elastic.rs: pub type ElasticModel",
        "estimate/kalman/smoother.rs: pub struct Smoother",
        "estimate/particle/filter.rs: pub struct ParticleFilter",
        "estimate/velocity/observer.rs: pub struct VelocityObserver",
        "estimate/likelihood/density.rs: pub struct Likelihood {",
        "simulate/run.rs: pub fn simulate",
    ],
)
def test_what_a_user_of_the_crate_begins_with_has_an_example(item):
    """Examples run with the tests of the crate; this is for their being there."""
    path, _, start = item.partition(": ")
    above = (CORE / "src" / path).read_text().partition(f"\n{start}")[0].splitlines()
    own = list(itertools.takewhile(lambda line: line.startswith(("///", "#[")), reversed(above)))
    assert own.count("/// ```") == 2, f"{item} has no example"


def test_a_class_has_a_name_of_its_own():
    assert homonyms(n.name for tree in TREES.values() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)) == []


def homonyms(names):
    """What is defined more than once."""
    return sorted(name for name, count in Counter(names).items() if count > 1)


def test_no_library_prints():
    """Standard output and bars are the command line's."""
    speaks = {"print", "echo", "show", "bar", "Progress"}
    called = [
        f"{name}: {ast.unparse(node)}"
        for name, tree in TREES.items()
        for node in ast.walk(tree)
        if isinstance(node, ast.Call) and ast.unparse(node.func).rpartition("click.")[2] in speaks
        if room(name) != "cli"
    ]
    assert called == []


@pytest.mark.parametrize("smoother", [linkside.RauchTungStriebelSmoother, linkside.ElasticJointSmoother])
def test_a_smoother_is_no_filter(smoother):
    """It looks back from the end of a recording: there is no sample by sample, and no piece by piece."""
    assert not issubclass(smoother, linkside.ExtendedKalmanFilter | linkside.ElasticJointFilter)
    assert not {"step", "reset", "covariance", "status", "run_pieces"} & set(dir(smoother))
