"""What people install is the wheel, not the checkout: it is built, unpacked elsewhere and run there."""

import importlib.util
import os
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "src" / "deadreckon"


def run(*command: object, **options) -> str:
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True, **options)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> Path:
    """Built from the source distribution, as an installation from it would be, so that both are complete."""
    folder = tmp_path_factory.mktemp("wheel")
    run(sys.executable, "-m", "hatchling", "build", "-t", "sdist", "-d", folder, cwd=ROOT)
    (archive,) = folder.glob("*.tar.gz")
    shutil.unpack_archive(archive, folder)
    (source,) = (path for path in folder.iterdir() if path.is_dir())
    run(sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", folder, cwd=source)
    (path,) = folder.glob("*.whl")
    return path


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory) -> Path:
    """The wheel in a folder of its own; dependencies come from the environment that runs the tests."""
    folder = tmp_path_factory.mktemp("site")
    if importlib.util.find_spec("pip"):
        installer = [sys.executable, "-m", "pip", "install", "--no-index"]
    else:  # an environment of uv's
        installer = ["uv", "pip", "install", "--python", sys.executable, "--offline"]
    run(*installer, "--no-deps", "--target", folder, wheel, cwd=folder)
    return folder


@pytest.fixture
def outside(installed, tmp_path):
    """Runs a command with the installed copy before the checkout, in an empty folder."""
    environment = os.environ | {"PYTHONPATH": str(installed)}
    return lambda *command: run(*command, cwd=tmp_path, env=environment)


def test_wheel_has_every_file_of_the_package(wheel):
    names = set(zipfile.ZipFile(wheel).namelist())
    files = {path for path in PACKAGE.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    assert {path.relative_to(PACKAGE.parent).as_posix() for path in files} <= names
    assert "deadreckon/py.typed" in names
    assert any(name.endswith("licenses/LICENSE") for name in names)
    assert not [name for name in names if name.startswith(("tests/", "docs/"))]


def test_wheel_stays_small_enough_for_an_index(wheel):
    assert wheel.stat().st_size < 25_000_000


def test_readme_in_the_wheel_has_no_links_that_need_the_repository(wheel):
    archive = zipfile.ZipFile(wheel)
    [name] = [name for name in archive.namelist() if name.endswith(".dist-info/METADATA")]
    head, _, text = archive.read(name).decode().partition("\n\n")
    assert "Description-Content-Type: text/markdown" in head
    assert "# deadreckon" in text
    assert not re.search(r"\]\((?!https?:|#)", text)


def test_installed_copy_is_the_one_that_runs(outside, installed):
    path = outside(sys.executable, "-c", "import deadreckon; print(deadreckon.__file__)")
    assert Path(path.strip()).is_relative_to(installed)


def test_command_runs_outside_the_checkout(outside, installed):
    command = installed / "bin" / "deadreckon"
    assert "train" in outside(command, "--help")
    assert "maze2d-umaze" in outside(command, "tasks")
