"""What holds the parts apart: imports point one way, and heavy ones wait until they are needed."""

import ast
import functools
import graphlib
import importlib
import importlib.util
import os
import re
import subprocess
import sys
import sysconfig
import tomllib
from pathlib import Path

import pytest

from deadreckon._version import __version__
from deadreckon.cli import main

ROOT = Path(__file__).resolve().parent.parent
SCRIPTS = Path(sysconfig.get_path("scripts"))


def python(code: str) -> str:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("JAX_")}
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    return result.stdout


def processor_seconds(*command: object) -> float:
    """User and system time of one run, which other work on the machine does not lengthen as it does the wall time."""
    process = subprocess.Popen(list(map(str, command)), stdout=subprocess.DEVNULL)
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    assert process.returncode == 0, command
    return usage.ru_utime + usage.ru_stime


def test_imports_point_one_way():
    result = subprocess.run([SCRIPTS / "lint-imports", "--no-cache"], cwd=ROOT, capture_output=True, text=True)
    assert result.returncode == 0, result.stdout + result.stderr


def imported(tree: ast.AST, modules: set[str]) -> set[str]:
    """Those of `modules` that a file imports anywhere, within functions too, but not for type checkers alone."""
    found = set()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            continue
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, ast.unparse(node)
            inner = {f"{node.module}.{alias.name}" for alias in node.names}
            found |= inner & modules or {node.module}
        found |= imported(node, modules)
    return found & modules


def test_no_module_imports_itself_through_others():
    """The linter sees layers alone; within a package, an import that waits inside a function could hide a circle."""
    files = {path: path.relative_to(ROOT / "src").with_suffix("").parts for path in (ROOT / "src").rglob("*.py")}
    names = {path: ".".join(parts).removesuffix(".__init__") for path, parts in files.items()}
    modules = set(names.values())
    graph = {name: imported(ast.parse(path.read_text()), modules) - {name} for path, name in names.items()}
    assert {"deadreckon.data.frame", "deadreckon.errors"} <= graph["deadreckon.data.dataset"]  # deferred, and not
    graphlib.TopologicalSorter(graph).prepare()  # a CycleError names the circle


# Modules of commands, which are imported before a command begins; `cli.options` waits for it.
COMMANDS = sorted({f"deadreckon.cli.{module}" for module, _, _ in main.COMMANDS.values()})


@pytest.mark.parametrize("module", ["deadreckon", "deadreckon.cli.main", *COMMANDS])
def test_import_is_light(module):
    heavy = ["jax", "equinox", "optax", "mujoco", "gymnasium", "minari", "h5py", "pyarrow", "pandas", "scipy"]
    loaded = python(f"import sys, {module}; print(*(name for name in {heavy} if name in sys.modules))").split()
    assert loaded == []


def test_import_does_not_touch_the_compilation_cache():
    assert python("import jax, deadreckon.nets.mlp; print(jax.config.jax_compilation_cache_dir)").strip() == "None"


def test_help_answers_in_half_a_second():
    """On a machine on which the interpreter itself is slow, in twenty times what that takes to begin."""
    seconds, bare = [], []
    while len(seconds) < 5 and min(seconds, default=1.0) >= 0.5:
        seconds.append(processor_seconds(SCRIPTS / "deadreckon", "--help"))
        bare.append(processor_seconds(sys.executable, "-c", "pass"))
    assert min(seconds) < max(0.5, 20 * min(bare)), (seconds, bare)


def test_versions_are_said_once():
    """constraints.txt is what uv.lock says, and CITATION.cff and CHANGELOG.md know the version."""
    packages = tomllib.loads((ROOT / "uv.lock").read_text())["package"]
    locked = {(package["name"], package.get("version")) for package in packages}
    lines = [line.partition(";")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines()]
    assert len(lines) > 50
    assert {tuple(line.split("==")) for line in lines} <= locked
    assert f"version: {__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {__version__}" in (ROOT / "CHANGELOG.md").read_text()


def test_lock_and_constraints_name_public_packages_only():
    packages = tomllib.loads((ROOT / "uv.lock").read_text())["package"]
    sources = {str(package["source"]) for package in packages}
    assert sources == {"{'registry': 'https://pypi.org/simple'}", "{'editable': '.'}"}
    assert not {"torch", "mujoco-py", "d4rl"} & {package["name"] for package in packages}


def test_agents_are_short():
    lengths = {path.name: len(path.read_text().splitlines()) for path in (ROOT / "src/deadreckon/agents").glob("*.py")}
    assert lengths
    assert {name: lines for name, lines in lengths.items() if lines > 250} == {}


def test_scripts_and_pages_import_what_the_package_has():
    """Scripts beside the package are not type-checked, and some run for hours before they import all that they need."""
    texts = {path: path.read_text() for folder in ("benchmarks", "evidence", "examples", "tests", "tools")
             for path in sorted((ROOT / folder).rglob("*.py"))}  # fmt: skip
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        texts[path] = "\n".join(re.findall(r"^from deadreckon\S* import [\w ,]+$", path.read_text(), re.MULTILINE))
    wrong = []
    for path, text in texts.items():
        for node in ast.walk(ast.parse(text)):
            asked = []
            if isinstance(node, ast.ImportFrom):
                asked = [f"{node.module}.{alias.name}" for alias in node.names]
            elif isinstance(node, ast.Import):
                asked = [alias.name for alias in node.names]
            wrong += [f"{path}: {name}" for name in asked if name.split(".")[0] == "deadreckon" and not there(name)]
    assert not wrong


@functools.cache
def there(name: str) -> bool:
    """Whether the package has a module of that name, or a module with it."""
    module, _, last = name.rpartition(".")
    try:
        return not module or hasattr(importlib.import_module(module), last) or importlib.util.find_spec(name) is not None
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("deadreckon"):
            raise
        return False
