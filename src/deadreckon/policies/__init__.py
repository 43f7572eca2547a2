"""Policies: the protocol, kinds of policy, files that numpy alone can run, behaviour models, and black boxes.

Names are looked up on first use, so that `deadreckon.policies.portable` can be imported without JAX.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deadreckon.data.step import Step
    from deadreckon.policies.dapg import load_dapg
    from deadreckon.policies.deployed import EnvPolicy
    from deadreckon.policies.dope import load_dope
    from deadreckon.policies.policy import BlackBoxPolicy, Policy
    from deadreckon.policies.store import load, save

_HOMES = {
    "BlackBoxPolicy": "policy", "EnvPolicy": "deployed", "Policy": "policy", "Step": "policy", "load": "store",
    "load_dapg": "dapg", "load_dope": "dope", "save": "store",
}  # fmt: skip
__all__ = ["BlackBoxPolicy", "EnvPolicy", "Policy", "Step", "load", "load_dapg", "load_dope", "save"]


def __dir__() -> list[str]:
    return sorted([*__all__, "portable"])


def __getattr__(name: str):
    import importlib

    if name in _HOMES:
        return getattr(importlib.import_module(f"deadreckon.policies.{_HOMES[name]}"), name)
    if name == "portable":
        return importlib.import_module("deadreckon.policies.portable")
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
