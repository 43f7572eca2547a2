"""Any Gymnasium environment as a task: by its id, by an object, or by what makes one. Apart because it needs Gymnasium.

A name tells how to open it again: `gymnasium:ID`, with options behind a question mark that go to `gymnasium.make`, such as
`gymnasium:FrozenLake-v1?is_slippery=False&max_episode_steps=50`; or `module:Class`, with options that go to the class.
"""

import copy
import functools
import importlib
import importlib.metadata
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import gymnasium
import numpy as np
from gymnasium.envs.registration import EnvSpec

from deadreckon.data.environments import BOUNDS, SPEC, noted_bounds
from deadreckon.errors import UserError
from deadreckon.imports import imported
from deadreckon.tasks.gymnasium_copies import GymnasiumCopies
from deadreckon.tasks.gymnasium_names import options_of, written
from deadreckon.tasks.gymnasium_spaces import DISCRETE, Spaces
from deadreckon.tasks.simulator_env import SimulatorEnv
from deadreckon.tasks.task import Task, keeping_horizon

PREFIX = "gymnasium:"
LIMIT = "max_episode_steps"  # as `gymnasium.make` calls the horizon

_HORIZON = f"it has no time limit; give one, such as horizon=500 in Python or ?{LIMIT}=500 after its name"


@dataclass(frozen=True, kw_only=True)
class GymnasiumTask(Task):
    """A task whose simulator is copies of a Gymnasium environment. Its scores are raw returns: no reference is known.

    Attributes:
        make: opens one environment more.
        spaces: between the environment and the task.
        packages: versions of Gymnasium and of the package that the environment is from.
    """

    make: Callable[[], Any] = field(repr=False, compare=False)
    spaces: Spaces = field(repr=False, compare=False)
    packages: Mapping[str, str] = field(default_factory=dict, repr=False, compare=False)

    def simulate(self, seeds: Sequence[int], threads: int | None = None) -> GymnasiumCopies:
        """One copy of the environment for each seed, stepped in this thread; see `Task.simulate`."""
        return GymnasiumCopies(self, seeds)

    @property
    def described(self) -> dict[str, Any]:
        """See `Task.described`: how Gymnasium makes the environment, with wrappers that leave texts out and flatten.

        Without it where Gymnasium cannot make it by itself. `action_levels`: what it takes for each discrete action.
        """
        found: dict[str, Any] = {}
        if isinstance(self.spaces.acted, DISCRETE):
            levels = [np.ravel(choice).tolist() for choice in self.spaces.choices]
            if levels != [[i] for i in range(len(levels))]:
                found["action_levels"] = levels
        env = self.make()
        try:
            if self.spaces.left_out and isinstance(self.spaces.observed, gymnasium.spaces.Dict):
                env = gymnasium.wrappers.FilterObservation(env, list(self.spaces.observed.spaces))
            if env.observation_space.shape != self.observation_shape:
                env = gymnasium.wrappers.FlattenObservation(env)
            spec, space = _spec(env), env.observation_space
            if spec is not None and isinstance(space, gymnasium.spaces.Box):
                found |= {SPEC: spec.to_json(), BOUNDS: noted_bounds(space.low, space.high)}
        except (ValueError, TypeError, AssertionError):  # texts further inside, or options that JSON has no words for
            pass
        finally:
            env.close()
        return found

    @property
    def versions(self) -> Mapping[str, str]:
        """See `Task.versions`."""
        return self.packages


def named(name: str, horizon: int | None = None) -> Task | None:
    """The task of a name as above, or of a bare id that Gymnasium knows; None of other names without a colon.

    Raises:
        UserError: nothing has this name, or it is no environment that can be a task.
    """
    path, _, text = name.partition("?")
    options = options_of(name, text)
    if path.startswith("pettingzoo"):
        raise _for_several(name)
    if path.startswith(PREFIX):
        if "+" in path:
            raise UserError(f"task {name}: wrappers cannot be made from a name; give the environment as an object in Python")
        return _of_id(path.removeprefix(PREFIX), options, horizon)
    if ":" in path:
        return _of_module(path, options, horizon)
    importlib.import_module("deadreckon.tasks.envs")  # gives Gymnasium our ids
    return _of_id(path, options, horizon) if path in gymnasium.registry else None


def of(given: Any, horizon: int | None = None) -> Task:
    """The task of an environment, or of a function that makes one more with every call.

    Args:
        given: an environment, of which copies are made by its spec, or as deep copies where it has none; or a callable.
        horizon: steps after which an episode times out; None: the environment's own limit.

    Raises:
        UserError: neither, an environment that cannot be a task, no time limit, or a horizon beyond the environment's own
            `TimeLimit` where that cannot be replaced.
    """
    if isinstance(given, gymnasium.Env) or not callable(given):
        return _of_object(given, horizon)
    return _of_maker(given, _name_of(given), {}, horizon)


def _of_id(env_id: str, options: dict[str, Any], horizon: int | None) -> Task:
    options = options if horizon is None else options | {LIMIT: horizon}
    importlib.import_module("deadreckon.tasks.envs")  # gives Gymnasium our ids
    name = PREFIX + env_id + written(options)

    def make() -> Any:
        return _made(env_id, options, name)

    return _task(make(), make, name, options.get(LIMIT))


def _made(env_id: str | EnvSpec, options: Mapping[str, Any], name: str) -> Any:
    try:
        # Its checks of every first reset and step change nothing, and print warnings for each copy.
        return gymnasium.make(env_id, disable_env_checker=True, **options)
    except Exception as error:  # of Gymnasium and of whatever package the id is from
        what = " ".join(str(error).split())[:300]
        missing = isinstance(error, gymnasium.error.NameNotFound | gymnasium.error.NamespaceNotFound)
        hint = f" If another package has it, its module stands before the id: {PREFIX}MODULE:ID" if missing else ""
        raise UserError(f"task {name}: Gymnasium cannot make it, {type(error).__name__}: {what}{hint}") from error


def _of_module(path: str, options: dict[str, Any], horizon: int | None) -> Task:
    found = imported(path, "task", "Class")
    module, _, attribute = path.partition(":")
    if isinstance(found, Task):
        if options:
            raise UserError(f"task {path} is a Task, which takes no options; leave {written(options)} out")
        return keeping_horizon(found, horizon)
    if not callable(found):
        raise UserError(f"task {path}: {module} has no {attribute} that is an environment class, or a function that makes one")
    return _of_maker(found, path, options, horizon)


def _of_maker(make: Callable[..., Any], path: str, options: dict[str, Any], horizon: int | None) -> Task:
    """The task of what a class or a function makes with these options, a new environment with every call.

    Raises:
        UserError: it makes something else, or gives the same environment twice, in whatever wrappers.
    """
    options = options if horizon is None else options | {LIMIT: horizon}
    name, limit = path + written(options), options.pop(LIMIT, None)
    made = _called(make, options, name)
    if isinstance(made, Task):
        return keeping_horizon(made, limit)
    found = _task(made, lambda: make(**options), name, limit)  # which closes it: there may be room for a single one
    if isinstance(make, type):
        return found  # a class makes a new one with every call
    other = _called(make, options, name)
    _check(other, name)
    if other.unwrapped is made.unwrapped:
        raise UserError(f"{name} gives the same environment twice; a function that makes a new one with every call is needed")
    other.close()
    return found


def _called(make: Callable[..., Any], options: Mapping[str, Any], name: str) -> Any:
    try:
        return make(**options)
    except Exception as error:  # whatever the user's code raises is the user's to mend
        what = " ".join(str(error).split())[:200]
        raise UserError(f"task {name}: making it raised {type(error).__name__}: {what}") from error


def _of_object(env: Any, horizon: int | None) -> Task:
    _check(env, type(env).__name__)
    spec = _spec(env)
    if spec is None:
        name = type(env.unwrapped).__name__
        try:
            copy.deepcopy(env)
        except Exception as error:  # of whatever it holds: a socket, a lock, a compiled model
            how = "give a function that makes one, or one made by gymnasium.make"
            raise UserError(f"{name} has no spec and cannot be copied ({type(error).__name__}); {how}") from error
        return _task(env, lambda: copy.deepcopy(env), name, horizon, keep=True)
    options = {key: value for key, value in spec.kwargs.items() if key != "render_mode"}
    registered = gymnasium.registry.get(spec.id)
    usual = registered is not None and registered.max_episode_steps == spec.max_episode_steps
    own = {} if registered is None else {k: v for k, v in options.items() if not _same(registered.kwargs.get(k, _NOTHING), v)}
    own |= {} if usual or spec.max_episode_steps is None else {LIMIT: spec.max_episode_steps}
    own |= {} if horizon is None else {LIMIT: horizon}
    wrapped = "".join(f"+{wrapper.name}" for wrapper in spec.additional_wrappers)
    name = PREFIX + spec.id + wrapped + written(own)
    spec.kwargs = options
    known, limit = spec, {} if horizon is None else {LIMIT: horizon}

    def make() -> Any:
        return _made(copy.deepcopy(known), limit, name)

    return _task(make(), make, name, horizon)


_NOTHING = object()


def _same(a: Any, b: Any) -> bool:
    """Whether two options are equal, also where they hold arrays, whose comparison is no truth value."""
    try:
        return bool(a == b)
    except ValueError:
        return isinstance(a, np.ndarray) and isinstance(b, np.ndarray) and np.array_equal(a, b)


def _spec(env: Any) -> EnvSpec | None:
    """By which Gymnasium makes the same environment again; None where it cannot."""
    try:
        spec = copy.deepcopy(env.spec)
    except (ValueError, TypeError):
        return None
    if spec is None or any(wrapper.kwargs is None for wrapper in spec.additional_wrappers):
        return None  # a wrapper that does not record how it was made
    return spec


def _task(env: Any, make: Callable[[], Any], name: str, horizon: int | None, keep: bool = False) -> GymnasiumTask:
    """The task of the environments that `make` makes, of which `env` is one."""
    _check(env, name)
    own = _limit(env)
    steps = horizon if horizon is not None else own if own is not None else _declared(env)
    if steps is None:
        raise UserError(f"{name}: {_HORIZON}")
    if not isinstance(steps, int) or steps < 1:
        raise UserError(f"{name}: the horizon must be a whole number of steps, 1 or more, got {steps}")
    if own is not None and steps > own:
        raise UserError(f"{name} ends its episodes after {own} steps by itself; the horizon must be {own} or less, got {steps}")
    spaces, spec = Spaces.of(env, name), _spec(env)
    if spaces.left_out:
        warnings.warn(f"{name}: texts are not observed: {', '.join(spaces.left_out)}", stacklevel=4)
    module = type(env.unwrapped).__module__
    if not keep:
        env.close()
    return GymnasiumTask(
        name=name, domain="gymnasium", horizon=steps, observation_shape=spaces.shape, observation_dtype=spaces.dtype,
        action_space=spaces.actions, gym_id="" if spec is None else spec.id, reference=None,
        summary=f"{type(env.unwrapped).__name__} of {module}", make=make, spaces=spaces, packages=_versions(module),
    )  # fmt: skip


def _check(env: Any, name: str) -> None:
    """Refuses what is no single Gymnasium environment."""
    if _from(env, "pettingzoo") or hasattr(env, "possible_agents"):
        raise _for_several(name)
    if isinstance(env, gymnasium.vector.VectorEnv):
        raise UserError(f"{name} is a vector of environments; give a single one, whose copies are made here")
    if _from(env, "gym"):
        raise UserError(f"{name} is an environment of the package gym, which is no longer maintained; Gymnasium's are taken")
    if not isinstance(env, gymnasium.Env):
        what = "a task is a name, a Task, a Gymnasium environment, or a function that makes one"
        raise UserError(f"{name} is no environment but {type(env).__name__}; {what}")
    around = env
    while isinstance(around, gymnasium.Wrapper):
        kind = type(around).__name__
        if isinstance(around, _NORMALISING) and around.update_running_mean:
            how = "leave it out (agents standardise from data themselves), or set its update_running_mean to False"
            raise UserError(f"{name}: {kind} keeps statistics over episodes, so that no episode follows from its seed; {how}")
        around = around.env


_NORMALISING = gymnasium.wrappers.NormalizeObservation, gymnasium.wrappers.NormalizeReward


def _for_several(name: str) -> UserError:
    return UserError(f"{name} is an environment of PettingZoo, for several agents; Gymnasium's, for a single one, are taken")


def _from(thing: Any, package: str) -> bool:
    return any(base.__module__.partition(".")[0] == package for base in type(thing).__mro__)


def _limit(env: Any) -> int | None:
    """Steps after which a wrapper, or one of our simulators inside, cuts an environment's episodes."""
    limits = [env.unwrapped.task.horizon] if isinstance(env.unwrapped, SimulatorEnv) else []
    inner = env
    while isinstance(inner, gymnasium.Wrapper):
        if isinstance(inner, gymnasium.wrappers.TimeLimit):
            limits.append(inner._max_episode_steps)
        inner = inner.env
    return min(limits, default=None)


def _declared(env: Any) -> int | None:
    """The time limit in the spec of an environment that no wrapper cuts."""
    spec = getattr(env.unwrapped, "spec", None)
    return None if spec is None else spec.max_episode_steps


def _name_of(make: Any) -> str:
    module, name = getattr(make, "__module__", ""), getattr(make, "__qualname__", type(make).__name__)
    return name if module in ("", "__main__", None) or "<" in name else f"{module}:{name}"


# It reads what every installed package says, which takes a while.
_packages = functools.cache(importlib.metadata.packages_distributions)


def _versions(module: str) -> dict[str, str]:
    """Of Gymnasium, and of the package that a module is from, if it is installed as one."""
    top = module.partition(".")[0]
    found = {"gymnasium": gymnasium.__version__}
    if top in ("gymnasium", "deadreckon"):
        return found
    for package in _packages().get(top, ()):
        found[package] = importlib.metadata.version(package)
    return found
