"""By which Gymnasium environment a log's task can be opened, and what it says of observations.

Logs of the package's tasks are known by the task's name. Others say it themselves, by what `collect_in_task` noted: their
environment is then not opened here, because a file must not name code that runs.
"""

import warnings
from typing import Any, NamedTuple

import numpy as np

from deadreckon.data.dataset import Dataset
from deadreckon.data.entries import task_of
from deadreckon.errors import UserError

SPEC, BOUNDS = "env_spec", "observation_bounds"  # in a log's provenance

_MODULE = "deadreckon.tasks.envs:deadreckon/"  # Gymnasium imports what stands before the colon
_MAZES = ("UMaze", "Medium", "Large")
_CONTROL = ("cartpole-swingup", "cheetah-run", "finger-turn-hard", "fish-swim", "humanoid-run", "manipulator-insert-ball",
            "manipulator-insert-peg", "walker-stand", "walker-walk")  # fmt: skip
_WALKED = ("UMaze", "UMaze-Diverse", "Medium-Play", "Medium-Diverse", "Large-Play", "Large-Diverse")
IDS = {
    "inverted-pendulum": "InvertedPendulum-v5", "hopper": "Hopper-v5", "halfcheetah": "HalfCheetah-v5",
    "walker2d": "Walker2d-v5", "ant": f"{_MODULE}Ant-v5", "humanoid": f"{_MODULE}Humanoid-v5",
    "ant-reach": f"{_MODULE}AntReach-v0", "flow-ring": f"{_MODULE}Flow-Ring-v0", "flow-merge": f"{_MODULE}Flow-Merge-v0",
    "battery": f"{_MODULE}Battery-v1", "carla-lane-state": f"{_MODULE}CarlaLaneState-v0",
    "carla-lane": f"{_MODULE}CarlaLane-v0", "carla-town": f"{_MODULE}CarlaTown-v0",
    "carla-town-state": f"{_MODULE}CarlaTownState-v0",
    **{name: f"{_MODULE}Adroit{name.title()}-v1" for name in ("pen", "hammer", "door", "relocate")},
    **{name: f"{_MODULE}{name.title().replace('-', '')}-v0" for name in _CONTROL},
    **{f"kitchen-{name}": f"{_MODULE}Kitchen{name.title()}-v0" for name in ("complete", "partial", "mixed")},
    **{f"maze2d-{e.lower()}{'-' * bool(e)}{maze.lower()}{'-dense' * dense}": f"{_MODULE}Maze2D-{e}{maze}{'Dense' * dense}-v1"
       for e in ("", "Eval") for maze in _MAZES for dense in (False, True)},
    **{f"antmaze-{e.lower()}{'-' * bool(e)}{maze.lower()}": f"{_MODULE}AntMaze{e}{maze.replace('-', '')}-v2"
       for e in ("", "Eval") for maze in _WALKED},
}  # fmt: skip


class Environment(NamedTuple):
    """Of a log.

    Attributes:
        spec: JSON of the `EnvSpec` that Gymnasium makes it by.
        low, high: bounds of its observations, of the log's shape.
    """

    spec: str
    low: np.ndarray
    high: np.ndarray


def environment_of(log: Dataset) -> Environment | None:
    """The environment of a log; None where nobody knows it, or where it shows something else than the log has.

    It warns where the package's own cannot be opened here, for want of another package.
    """
    noted = log.provenance.extra
    if isinstance(noted.get(SPEC), str) and BOUNDS in noted:
        low, high = noted[BOUNDS]
        known = Environment(noted[SPEC], _bound(low, -np.inf), _bound(high, np.inf))
        return known if known.low.shape == log.observations.shape[1:] else None
    name = IDS.get(task_of(log.name) or str(noted.get("task")))
    if name is None:
        return None
    import gymnasium

    try:
        env: Any = gymnasium.make(name, disable_env_checker=True)
    except (UserError, ImportError, gymnasium.error.Error) as error:
        warnings.warn(f"{log.name}: written without its environment, which cannot be opened here: {error}", stacklevel=3)
        return None
    with_spec, space = env.spec, env.observation_space
    env.close()
    if not isinstance(space, gymnasium.spaces.Box) or space.shape != log.observations.shape[1:]:
        return None
    return Environment(with_spec.to_json(), space.low, space.high)


def noted_bounds(low: np.ndarray, high: np.ndarray) -> list[Any]:
    """Bounds as JSON values, None where they are infinite."""
    return [[float(x) if np.isfinite(x) else None for x in side.ravel()] for side in (low, high)]


def _bound(values: Any, infinite: float) -> np.ndarray:
    return np.array([infinite if value is None else value for value in values], np.float32)
