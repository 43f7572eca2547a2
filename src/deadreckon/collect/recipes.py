"""The recipes by name. A domain adds its own with `register`."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

from deadreckon.data.catalogue import VERSION, cached_path, entry
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError, unknown
from deadreckon.tasks import registry
from deadreckon.tasks.maze2d import TASKS, Maze2D

Progress = Callable[[int, int], None]  # rows done, rows in all


class Maker(Protocol):
    """What makes a recipe's log; see `collect_maze2d`."""

    def __call__(self, *, name: str, steps: int, seed: int, threads: int | None, progress: Progress | None) -> Dataset:
        """Collects `steps` rows; they must not depend on `threads`."""
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
    """The recipe of that name (`@dr1` behind it is allowed).

    Raises:
        UserError: there is none; the message names the nearest.
    """
    try:
        return _RECIPES[name.removesuffix(f"@{VERSION}")]
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
        seed: of everything random.
        threads: to simulate with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and the rows in all.
    """
    found = recipe(name)
    steps = found.steps if steps is None else steps
    if steps < 1:
        raise UserError(f"{found.name}: steps must be 1 or more, got {steps}")
    if seed < 0:
        raise UserError(f"{found.name}: seed must be 0 or more, got {seed}")
    return found.make(name=found.name, steps=steps, seed=seed, threads=threads, progress=progress)


def collect(
    name: str,
    *,
    steps: int | None = None,
    seed: int = 0,
    out: Path | str | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Makes a log and writes it as an HDF5 file with D4RL's column names.

    Args:
        name: of the recipe, such as `maze2d-umaze-v1`.
        steps: rows; those of the full log if None.
        seed: of everything random.
        out: the file; if None, the place in the cache where `deadreckon.load` finds it (see `default_path`).
        threads: to simulate with; all cores if None. The log does not depend on it.
        progress: called now and then with the rows done and the rows in all.

    Returns:
        The file's path. It is written whole or not at all.
    """
    from deadreckon.data.hdf5 import write_hdf5

    found = recipe(name)
    path = Path(out) if out is not None else default_path(found, steps, seed)
    write_hdf5(generate(name, steps=steps, seed=seed, threads=threads, progress=progress), path)
    return path


def default_path(found: Recipe, steps: int | None, seed: int) -> Path:
    """Where `collect` writes by default. A part or another seed has it in its name: it never passes for the full log."""
    part = f"-{steps}-steps" if steps is not None and steps != found.steps else ""
    other = f"-seed-{seed}" if seed else ""
    return cached_path(f"{found.name}@{VERSION}{part}{other}")


# ---- Maze2D -----------------------------------------------------------------------------------------------------------


def _maze2d(task: Maze2D) -> Recipe:
    def make(*, name: str, steps: int, seed: int, threads: int | None, progress: Progress | None) -> Dataset:
        from deadreckon.collect.maze2d import collect_maze2d

        return collect_maze2d(task, name=name, steps=steps, seed=seed, threads=threads, progress=progress)

    known = entry(f"{task.name}-v1")
    return Recipe(known.recipe, task.name, known.rows, make, "waypoints of a planner to random targets, PD control")


for _task in TASKS:
    assert registry.task(_task.name) is _task
    register(_maze2d(_task))
