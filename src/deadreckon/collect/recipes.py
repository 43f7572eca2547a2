"""The recipes by name. `collect/domains.py` registers those of all domains."""

import dataclasses
import shutil
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from deadreckon.data.catalogue import cached_path, version_of
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError, unknown
from deadreckon.files import alone
from deadreckon.interrupts import resumable
from deadreckon.progress import Progress
from deadreckon.randomness import check_seed


class Maker(Protocol):
    """What makes a recipe's log; see `collect_maze2d` and `collect_gym`."""

    def __call__(
        self, *, name: str, steps: int, seed: int, threads: int | None, scratch: Path, progress: Progress | None
    ) -> Dataset:
        """Collects `steps` rows; they must not depend on `threads`.

        What takes long keeps what it has in the folder `scratch`, and goes on with what it finds there. The log's columns
        may lie there too.
        """
        ...


@dataclass(frozen=True)
class Recipe:
    """How to make one log.

    Attributes:
        name: the original's name, such as `maze2d-umaze-v1`; the log made is `maze2d-umaze-v1@dr1`.
        task: name of the task whose simulator and reward it uses.
        steps: rows of the full log.
        make: what makes it.
        summary: one line on what acts in it.
    """

    name: str
    task: str
    steps: int
    make: Maker
    summary: str = ""


_RECIPES: dict[str, Recipe] = {}


def recipe(name: str) -> Recipe:
    """The recipe of that name (its version behind it, such as `@dr1`, is allowed).

    Raises:
        UserError: there is none; the message names the nearest.
    """
    try:
        return _RECIPES[name.removesuffix(f"@{version_of(name.partition('@')[0])}")]
    except KeyError:
        raise unknown("recipe", name, _RECIPES) from None


def recipe_names() -> list[str]:
    """All recipes' names, in the order in which they were registered."""
    return list(_RECIPES)


def register(recipe: Recipe) -> None:
    """Adds a recipe."""
    if recipe.name in _RECIPES:
        raise UserError(f"recipe {recipe.name!r} is registered already")
    _RECIPES[recipe.name] = recipe


def generate(
    name: str, *, steps: int | None = None, seed: int = 0, threads: int | None = None, progress: Progress | None = None
) -> Dataset:
    """Makes a log in memory.

    Args:
        name: of the recipe.
        steps: rows; those of the full log if None.
        seed: random seed.
        threads: to simulate with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and the rows in all.
    """
    with tempfile.TemporaryDirectory() as scratch:
        made = _make(recipe(name), steps, seed, threads, Path(scratch), progress)
        return made.loaded()


def _make(
    found: Recipe, steps: int | None, seed: int, threads: int | None, scratch: Path, progress: Progress | None
) -> Dataset:
    steps = found.steps if steps is None else steps
    if steps < 1:
        raise UserError(f"{found.name}: steps must be 1 or more, got {steps}")
    check_seed(seed)
    made = found.make(name=found.name, steps=steps, seed=seed, threads=threads, scratch=scratch, progress=progress)
    return dataclasses.replace(made, name=collected_name(found, steps, seed))


def collect(
    name: str,
    *,
    steps: int | None = None,
    seed: int = 0,
    out: Path | str | None = None,
    threads: int | None = None,
    force: bool = False,
    wait: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Makes a log and writes it as an HDF5 file with D4RL's column names.

    Recipes that take long keep what they have in a hidden folder beside the file, so that after a kill the same command
    goes on where it was.

    Args:
        name: of the recipe, such as `maze2d-umaze-v1`.
        steps: rows; those of the full log if None.
        seed: random seed.
        out: the file; if None, the place in the cache where `deadreckon.load` finds it (see `default_path`).
        threads: to simulate with; all cores if None. The log does not depend on it.
        force: replace a file that is there.
        wait: for another process that collects the same log, and take what it has made, instead of refusing.
        progress: called now and then with the rows done and the rows in all.

    Returns:
        The file's path. It is written whole or not at all. A log that lies in the cache already is not made again.

    Raises:
        BusyError: another process collects it, and `wait` is not set.
        UserError: an unknown recipe, or a file `out` that is there already.
    """
    from deadreckon.data.formats.hdf5 import write_hdf5

    found = recipe(name)
    path = Path(out) if out is not None else default_path(found, steps, seed)
    if path.exists() and not force:
        if out is not None:
            raise UserError(f"{path} exists already; --force (force=True) replaces it")
        return path
    scratch = path.parent / f".{path.name}.part"
    with alone(path, wait=f"collects {name} already" if wait else ""), resumable(scratch):
        if force or not path.exists():  # whoever was waited for has made it
            write_hdf5(_make(found, steps, seed, threads, scratch, progress), path, compress=True)
        shutil.rmtree(scratch, ignore_errors=True)
    return path


def collected_name(found: Recipe, steps: int | None, seed: int) -> str:
    """What a collected log is called. A part or another seed has it in its name: it never passes for the full log."""
    part = f"-{steps}-steps" if steps is not None and steps != found.steps else ""
    other = f"-seed-{seed}" if seed else ""
    return f"{found.name}@{version_of(found.name)}{part}{other}"


def default_path(found: Recipe, steps: int | None, seed: int) -> Path:
    """Where `collect` writes by default."""
    return cached_path(collected_name(found, steps, seed))
