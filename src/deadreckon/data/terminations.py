"""When episodes end, where observations alone tell: a learned model of the dynamics need not learn that (thesis 5.3).

The rules of the Gym-MuJoCo tasks are Gymnasium's. They are functions of arrays, NumPy's or JAX's, and need no simulator.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from deadreckon.data import stands
from deadreckon.data.entries import task_of
from deadreckon.data.spec import Spec
from deadreckon.errors import UserError

LEARNED = "learned"  # stands where a rule's name could: when episodes end is the model's to say


@dataclass(frozen=True)
class Fallen:
    """Tells of observations (n, size) whether an episode ends there: (n,) bool.

    Attributes:
        healthy: (n, positions + velocities) states to (n,) bool; None: all are.
        ground: leading positions that are not observed, and decide nothing.
        padding: zeros at the end of observations.
    """

    healthy: Callable[[Any], Any] | None
    ground: int = 1
    padding: int = 0

    def __call__(self, observations: Any) -> Any:
        """(n,) bool of (n, size) observations."""
        arrays = observations.__array_namespace__()
        if self.healthy is None:
            return arrays.zeros(len(observations), dtype=bool)
        unseen = arrays.zeros_like(observations[:, : self.ground])
        size = observations.shape[1] - self.padding
        return ~self.healthy(arrays.concat([unseen, observations[:, :size]], axis=1))


@dataclass(frozen=True)
class Termination:
    """The rule of a task.

    Attributes:
        name: of the task.
        observation_shape: of one observation.
        ends: observations (n, *shape), as NumPy or JAX arrays, to (n,) bool.
    """

    name: str
    observation_shape: tuple[int, ...]
    ends: Callable[[Any], Any]


def termination(name: str) -> Termination:
    """The rule of a task by its name.

    Raises:
        UserError: there is none.
    """
    if name not in _KNOWN:
        known = ", ".join(sorted(_KNOWN))
        raise UserError(f"{name}: its observations do not show when an episode ends, unlike those of these tasks: {known}")
    return _KNOWN[name]


def of_spec(spec: Spec) -> Termination | None:
    """The rule for a log of the catalogue, or for a task that is acted in; None where observations do not tell.

    A log that only has a task's name is not known to be of that task.
    """
    if not spec.rows:
        return _KNOWN.get(spec.name)
    return of_log(spec.name)


def of_log(name: str) -> Termination | None:
    """The rule for a log of the catalogue; None where observations do not tell, and for other logs."""
    return _KNOWN.get(task_of(name) or "")


def register(rule: Termination) -> None:
    """Adds the rule of a task, in place of one of that name."""
    _KNOWN[rule.name] = rule


_KNOWN: dict[str, Termination] = {}
for _name, _size, _fallen in (
    ("inverted-pendulum", 4, Fallen(stands.pendulum, ground=0)),
    ("hopper", 11, Fallen(stands.hopper)),
    ("halfcheetah", 17, Fallen(None)),
    ("walker2d", 17, Fallen(stands.walker)),
    ("ant", 111, Fallen(stands.ant, ground=2, padding=84)),
    ("humanoid", 376, Fallen(stands.humanoid, ground=2, padding=84)),
):
    register(Termination(_name, (_size,), _fallen))
