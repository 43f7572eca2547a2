"""Functions that all exports of a policy share: rows for their check, the check, and a folder that is complete or absent."""

import contextlib
import shutil
from collections.abc import Iterator, Sequence
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.history import stacked
from deadreckon.data.spec import Box
from deadreckon.errors import UserError, cannot_write
from deadreckon.files import alone
from deadreckon.policies import store
from deadreckon.policies.deployed import history_of
from deadreckon.policies.pure import MEMBER, Pure
from deadreckon.runs.subject import Subject
from deadreckon.temporaries import beside

CLOSE = 1e-5  # largest difference of actions, in halves of an action's range
ROWS = 1_000  # most rows of the log on which an export is checked
PLAYER = ("portable.py", "portable_pictures.py", "table_columns.py", "table_encoder.py", "table_predict.py", "table_rows.py",
          "table_times.py")  # fmt: skip

ENCODER = ("table_columns.py", "table_encoder.py", "table_rows.py")


class Rows(NamedTuple):
    """Rows on which an export is checked.

    Attributes:
        observations: (rows, *shape) float32 as `pure` takes them; histories if the policy acts on these.
        member: (rows,) int32, which member of a mixture acts.
        actions: the policy's actions.
        room: (size,) half of each action's range, at least 1.
    """

    observations: np.ndarray
    member: np.ndarray
    actions: np.ndarray
    room: np.ndarray


@contextlib.contextmanager
def building(out: Path) -> Iterator[Path]:
    """A temporary folder beside `out` that is renamed to it when it is complete.

    Raises:
        UserError: `out` exists, or cannot be written.
    """
    with alone(out, what=str(out)):
        if out.exists():
            raise UserError(f"{out} exists already; choose another --out")
        try:
            with beside(out, folder=True) as folder:
                yield folder
                folder.chmod(0o755)
                folder.rename(out)
        except OSError as error:
            raise cannot_write(out, error) from error


def rows_of(one: Subject, function: Pure, data: Dataset) -> Rows:
    """Rows of a log at regular distances, with the policy's actions."""
    seen = stacked(data, history_of(one.policy))
    at = np.unique(np.linspace(0, len(data) - 1, min(len(data), ROWS)).astype(int))
    observations = np.asarray(seen.observations[at], np.float32)
    member = (np.arange(len(at)) % function.members).astype(np.int32)
    given = (observations, member) if MEMBER in function.inputs else (observations,)
    actions = np.asarray(jax.jit(function.call)(*map(jnp.asarray, given))[0])
    room = np.ones(1)
    if isinstance(data.action_space, Box):
        room = np.maximum(np.subtract(data.action_space.high, data.action_space.low) / 2, 1.0)
    return Rows(observations, member, actions, room)


def check(what: str, rows: Rows, actions: Any) -> None:
    """Refuses actions that are not the policy's.

    Raises:
        UserError: says by how much they differ, and in how many rows.
    """
    actions = np.asarray(actions)
    if actions.shape != rows.actions.shape:
        raise UserError(f"{what} gives actions of shape {actions.shape}, the policy {rows.actions.shape}: it is not kept")
    if rows.actions.dtype.kind in "iu":
        wrong = actions != rows.actions
    else:
        wrong = ~(np.abs(actions - rows.actions) <= CLOSE * rows.room).all(-1)
    if wrong.any():
        most, count = float(np.abs(actions.astype(float) - rows.actions).max()), len(rows.actions)
        text = f"{what} differs from the policy in {int(wrong.sum()):,} of {count:,} rows of the log, by up to {most:.2g}"
        raise UserError(f"{text}: it is not kept")


def put_player(one: Subject, folder: Path, names: Sequence[str] = PLAYER) -> None:
    """Writes the policy's file, and the modules that run it with numpy alone."""
    folder.mkdir(exist_ok=True)
    if one.file is not None:
        shutil.copyfile(one.file, folder / "policy.npz")
    else:  # a cross-fit's policy of one seed of several
        store.save(folder / "policy.npz", one.policy, {"log": dict(one.told)})
    put_modules(folder, names)


def put_modules(folder: Path, names: Sequence[str]) -> None:
    """Copies modules that need numpy alone."""
    for name in names:
        text = resources.files("deadreckon.policies").joinpath(name).read_text(encoding="utf-8")
        (folder / name).write_text(text, encoding="utf-8")


def played(play: Any, rows: Rows) -> np.ndarray:
    """Actions of the numpy player; of a mixture, each member's in its rows."""
    if play.member is not None:
        return played(play.member, rows)
    if play.members:
        parts = np.stack([played(member, rows) for member in play.members])
        return parts[rows.member, np.arange(len(rows.member))]
    return np.asarray(play(rows.observations.astype(np.uint8) if play.rank > 1 else rows.observations))
