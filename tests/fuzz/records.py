"""Small sound files of all that is read beside logs: policies, runs, decisions, suites and schemas.

    python -m tests.fuzz.records FOLDER     # those of runs, which have to be trained
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path

import numpy as np

from tests.fuzz.seeds import Files, tables


def texts(kind: str) -> list[Files]:
    """TOML: suites, claims, schemas."""
    suite = """about = "x"
logs = ["maze2d-umaze-v1", "maze2d-medium-v1"]
seeds = 2
steps = {"maze2d-umaze-v1" = 100, "maze2d-medium-v1" = 200}
evaluations = 2
[methods]
BC = { agent = "bc", fields = { hidden = [16, 16] } }
BEAR = { agent = "bear", preset = true, history = 2 }
[full]
seeds = 3
"""
    schema = """[table]
path = "log.csv"
separator = ","
[columns.patient]
role = "episode"
[columns.age]
role = "observation"
kind = "number"
[columns.ward]
role = "observation"
kind = "category"
levels = ["a", "b"]
[columns.action]
role = "action"
kind = "category"
[columns.reward]
role = "reward"
"""
    design = """minimise = false
constraints = ["a + c <= 1"]
[table]
separator = ","
[columns.a]
role = "input"
kind = "continuous"
low = 0.0
high = 1.0
[columns.c]
role = "input"
kind = "integer"
low = 0
high = 3
[columns.b]
role = "input"
kind = "categorical"
levels = ["x", "y"]
[columns.y]
role = "target"
"""
    claims = """[tuned]
bear = ["maze2d-umaze-v1"]
[[claims]]
id = "one"
says = "BEAR is better than BC"
place = "section 1"
tests = [{ suite = "suite.toml", method = "BEAR", than = ["BC"], on = ["maze2d-medium-v1"], margin = 1.0 }]
"""
    if kind == "claims":
        return [{"claims.toml": claims.encode(), "suite.toml": suite.encode()}]
    if kind == "schema":
        return [{"schema.toml": schema.encode(), "log.csv": tables("csv")[0]["log.csv"]}]
    return [{"suite.toml": suite.encode()}] if kind == "suite" else [{"design.toml": design.encode()}]


def policies() -> list[Files]:
    """Policies of three kinds: of continuous and of discrete actions, and on a history."""
    import jax
    import jax.numpy as jnp

    from deadreckon.nets.mlp import MLP
    from deadreckon.policies import store
    from deadreckon.policies.deployed import EnvPolicy
    from deadreckon.policies.kinds import Deterministic, TanhGaussian

    key, ones = jax.random.key(0), jnp.ones(2)
    of = lambda outputs: MLP.create(3, (4,), outputs, key)  # noqa: E731
    made = [
        EnvPolicy(Deterministic(of(2)), jnp.zeros(3), jnp.ones(3), -ones, ones),
        EnvPolicy(TanhGaussian(of(4)), None, None, -ones, ones),
    ]
    found: list[Files] = []
    with tempfile.TemporaryDirectory() as place:
        for each in made:
            store.save(Path(place, "policy.npz"), each, {"agent": "bc", "log": {}})
            found.append({"policy.npz": Path(place, "policy.npz").read_bytes()})
    return found


def looks() -> list[Files]:
    """A note of looks."""
    return [{"look.json": json.dumps({"episodes": [1, 2**63], "looks": {"abc": [2, 1]}}).encode()}]


def roads() -> list[Files]:
    """A map of roads in OpenDRIVE."""
    from deadreckon.tasks.opendrive_text import to_xodr
    from deadreckon.tasks.road_maps import figure_eight

    return [{"map.xodr": to_xodr(figure_eight()).encode()}]


def cells() -> list[Files]:
    """A cell of a ledger."""
    cell = {
        "agent": "bc", "asked": {"steps": 4}, "cell": "abc", "content": "abd", "curve": [[1, 2.0, 3.0, 0.5]], "data": "maze",
        "failure": "", "finished": "2026-11-24T10:30:14+00:00", "job": "BC-maze-1", "kind": "learn", "method": "BC",
        "more": {"median": 15.5}, "on": "maze", "preset": "", "raw": 10.5, "revisions": {"method": [1, 1]}, "score": 93.4,
        "seconds": 2.0, "seed": 0, "settings": {"lr": 0.1, "hidden": [16]}, "steps": 4, "suite": "x", "versions": {"jax": "1"},
    }  # fmt: skip
    return [{"cells/learn/maze/BC-abc.json": json.dumps(cell).encode()}]


def explained() -> Files:
    """An explanation in the folder of a run."""
    leaf = lambda text: {"text": text, "share": 0.5, "yes": None, "no": None}  # noqa: E731
    tree = {"text": "age <= 50", "share": 1.0, "yes": leaf("low"), "no": leaf("high")}
    told = {
        "name": "run seed 0", "log": "small", "discrete": True, "rows": 16, "depth": 1, "fidelity": 0.9, "low": 0.8,
        "high": 1.0, "constant": 0.5, "explains": True, "tree": tree,
        "columns": [{"column": "age", "change": 0.5, "low": 0.4, "high": 0.6}],
    }  # fmt: skip
    return {"run/explain.json": json.dumps(told).encode()}


def recommended() -> list[Files]:
    """Estimates of `recommend` where nothing was judged."""
    tried = {"name": "bc", "updates": 3, "planned": 9, "state": "learning", "why": "time"}
    choice = {"name": None, "deploy": False, "gain": [None, None, None], "level": None, "reason": "no time",
              "evidence": ["a"], "warnings": [], "objections": []}  # fmt: skip
    mine = {"budget": 60.0, "seconds": 3.0, "rows": 12, "episodes": 3, "candidates": [tried], "late": None, "failed": False}
    told = {"log": "small", "estimand": None, "truth": None, "policies": [], "judged": None, "results": [], "choice": choice}
    return [{"estimates.json": json.dumps(told | {"recommend": mine}).encode()}]


def trained(folder: Path) -> Path:
    """Runs, a cross-fit, estimates and an explanation, made once below `folder`."""
    done = folder / "done"
    if done.exists():
        return folder
    import deadreckon as dr
    from deadreckon.runs.offline import judge

    shutil.rmtree(folder, ignore_errors=True)
    rng = np.random.default_rng(0)
    rows = 80
    ends = np.arange(rows) % 4 == 3
    from deadreckon.data.dataset import Dataset
    from deadreckon.data.spec import Discrete

    many = Dataset.from_arrays(
        observations=rng.normal(size=(rows, 3)).astype(np.float32), actions=rng.integers(0, 3, rows),
        rewards=rng.normal(size=rows), terminals=ends,
        behavior_log_probs=np.full(rows, -np.log(3.0)), action_space=Discrete(3), name="small",
    )  # fmt: skip
    small = {"steps": 4, "seeds": 2}
    dr.train(dr.agents.BC(hidden=(4,), batch_size=8), many, out=folder / "run", **small)
    dr.cross_fit(dr.agents.BC(hidden=(4,), batch_size=8), many, folds=2, out=folder / "cross", **small)
    judge([folder / "run"], many, ["wis"], out=folder / "ope", counted=False)
    done.write_text("")
    return folder


if __name__ == "__main__":
    trained(Path(sys.argv[1]))
