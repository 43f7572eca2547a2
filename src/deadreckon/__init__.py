"""Logged data into decisions: learn policies from a fixed log, judge them, show what they are worth.

    import deadreckon as dr

    data = dr.load("maze2d-umaze-v1")
    run = dr.train(dr.agents.BEAR(), data, steps=100_000, seeds=4, task="maze2d-umaze", out="runs/bear")
    print(dr.evaluate(run.policy, "maze2d-umaze", episodes=100))

Names are looked up on first use, so that importing the package, and `deadreckon --help`, load no numerical library.
"""

import importlib
from typing import TYPE_CHECKING

from deadreckon._version import __version__
from deadreckon.errors import UserError
from deadreckon.provided import provide

if TYPE_CHECKING:
    from deadreckon import agents, bench, collect, data, mbo, ope, policies, report, runs, tasks, theory
    from deadreckon.collect.recipes import collect as collect_log
    from deadreckon.data.catalogue import load
    from deadreckon.data.dataset import Dataset
    from deadreckon.data.formats.io import read
    from deadreckon.mbo.designs import Designs
    from deadreckon.policies.library import load_policies
    from deadreckon.policies.loaded import load_policy
    from deadreckon.report.recommended import recommend
    from deadreckon.runs.callback import StopTraining
    from deadreckon.runs.crossfit import cross_fit, load_cross_fit
    from deadreckon.runs.dope import dope
    from deadreckon.runs.evaluate import evaluate
    from deadreckon.runs.explain import explain
    from deadreckon.runs.export import export
    from deadreckon.runs.hub import from_hub, push_to_hub
    from deadreckon.runs.monitor import monitor
    from deadreckon.runs.online import train_online
    from deadreckon.runs.run import Run
    from deadreckon.runs.run import load as load_run
    from deadreckon.runs.train import train, train_together
    from deadreckon.tasks.registry import task

_HOMES = {
    "Dataset": ("data.dataset", "Dataset"),
    "Designs": ("mbo.designs", "Designs"),
    "Run": ("runs.run", "Run"),
    "StopTraining": ("runs.callback", "StopTraining"),
    "collect_log": ("collect.recipes", "collect"),
    "cross_fit": ("runs.crossfit", "cross_fit"),
    "dope": ("runs.dope", "dope"),
    "evaluate": ("runs.evaluate", "evaluate"),
    "explain": ("runs.explain", "explain"),
    "export": ("runs.export", "export"),
    "from_hub": ("runs.hub", "from_hub"),
    "load": ("data.catalogue", "load"),
    "load_cross_fit": ("runs.crossfit", "load_cross_fit"),
    "load_policies": ("policies.library", "load_policies"),
    "load_policy": ("policies.loaded", "load_policy"),
    "load_run": ("runs.run", "load"),
    "monitor": ("runs.monitor", "monitor"),
    "push_to_hub": ("runs.hub", "push_to_hub"),
    "read": ("data.formats.io", "read"),
    "recommend": ("report.recommended", "recommend"),
    "task": ("tasks.registry", "task"),
    "train": ("runs.train", "train"),
    "train_online": ("runs.online", "train_online"),
    "train_together": ("runs.train", "train_together"),
}
# What lower layers ask for by name (`deadreckon.provided`), since they import nothing above them.
_PROVIDED = {"fit": ("runs.fit", "fit"), "notebook": ("report.notebook", "html")}
_PACKAGES = ("agents", "bench", "collect", "data", "mbo", "ope", "policies", "report", "runs", "tasks", "theory")
__all__ = [
    "Dataset", "Designs", "Run", "StopTraining", "UserError", "__version__", "agents", "bench", "collect", "collect_log",
    "cross_fit", "data", "dope", "evaluate", "explain", "export", "from_hub", "load", "load_cross_fit", "load_policies",
    "load_policy", "load_run", "mbo", "monitor", "ope", "policies", "push_to_hub", "read", "recommend", "report", "runs",
    "task", "tasks", "theory", "train", "train_online", "train_together",
]  # fmt: skip


def _found(home: tuple[str, str]):
    """What has a name in a module, both as in `_HOMES`."""
    module, attribute = home
    return getattr(importlib.import_module(f"deadreckon.{module}"), attribute)


for _name, _home in _PROVIDED.items():
    provide(_name, lambda home=_home: _found(home))


def __dir__() -> list[str]:
    return sorted(__all__)


def __getattr__(name: str):
    if name in _HOMES:
        return _found(_HOMES[name])
    if name in _PACKAGES:
        return importlib.import_module(f"deadreckon.{name}")
    raise AttributeError(f"module 'deadreckon' has no attribute {name!r}")
