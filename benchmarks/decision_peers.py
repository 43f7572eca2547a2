"""What other packages say of the study's logs: Open Bandit Pipeline of one decision, SCOPE-RL of many.

    python benchmarks/decision_peers.py setup                      # once: .cache/peer-obp and .cache/peer-scope
    python benchmarks/decision_peers.py export --families classes tabular-cut --trials 50 --split confirmatory
    python benchmarks/decision_peers.py judge                      # one JSON, runs/decisions/peers.json, and a table

`export` writes the held-out part of each log with discrete actions and known probabilities as an .npz, and `judge` runs each
peer on those that it can take, in an environment of its own, beside what the study's record has of the same logs.

- OBP 0.5.7 declares Python below 3.11 and exact old versions of its dependencies, of which scikit-learn 1.1.3 and pandas 1.5.2
  have no wheel for newer ones; asked for by name alone, pip goes back to versions that want PyYAML 5, which does not build any
  more. Installed without its dependencies beside NumPy 1.26, pandas 2.2 and scikit-learn 1.5 it works with Python 3.11.
  Judged: doubly robust with rewards by three-fold cross-fitted ridge regression, and self-normalised inverse propensity scores,
  each less the logged reward, with OBP's own bootstrap at the level of all policies at once.
- SCOPE-RL 0.2.1 installs as it is. It wants episodes of one length, so families whose episodes end by chance are left out, and
  its cross-fitted fitted Q evaluation asks for policies that are d3rlpy objects, which ours are not: judged are importance
  sampling per decision, plain and self-normalised, less the log's own return, with its own bootstrap.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent
HOMES = {"obp": ROOT / ".cache" / "peer-obp", "scope": ROOT / ".cache" / "peer-scope"}
TORCH = ["torch==2.13.0"]  # from the index of all packages; the one of CPU builds (download.pytorch.org/whl/cpu) is smaller
STEPS = {
    "obp": [
        [*TORCH, "numpy<2", "pandas<2.3", "scikit-learn<1.6", "pingouin<0.6", "matplotlib", "seaborn", "tqdm", "pyyaml"],
        ["--no-deps", "--ignore-requires-python", "obp==0.5.7"],
    ],
    "scope": [[*TORCH, "scope-rl==0.2.1", "d3rlpy==2.8.1"]],
}
ALPHA, DRAWS, FOLDS = 0.05, 2_000, 3


def setup(base: str) -> None:
    """The environments, made anew."""
    for name, home in HOMES.items():
        steps = [[base, "-m", "venv", "--clear", str(home)]]
        steps += [[str(home / "bin" / "python"), "-m", "pip", "install", *what] for what in STEPS[name]]
        for step in steps:
            print("$", " ".join(step), flush=True)
            subprocess.run(step, check=True)


# ---- our side -------------------------------------------------------------------------------------------------------


def export(families: list[str], split: str, trials: int, out: Path) -> None:
    """The held-out part of logs, what the policies would do there, and the truth."""
    from decision_study import FAMILIES
    from decision_study.trial import prepared, seeds

    from deadreckon.data.spec import Discrete

    out.mkdir(parents=True, exist_ok=True)
    for name in families:
        for seed in seeds(split, trials):
            if (path := out / f"{name}-{seed}.npz").exists():
                continue
            task = prepared(FAMILIES[name], seed)
            log, policies = task.held, list(task.policies.values())
            if not isinstance(log.action_space, Discrete) or not task.problem.known:
                print(f"{name}: left out, the peers here take discrete actions with known probabilities")
                break
            np.savez(
                path, names=list(task.policies), gains=task.truth[0], discount=task.problem.estimand.discount,
                context=log.observations, action=log.actions, reward=log.rewards.astype(float),
                chance=np.exp(log.extras["behavior_log_probs"]), lengths=log.lengths,
                probs=np.stack([policy.probs(log.observations) for policy in policies]),
            )  # fmt: skip


def judge(folder: Path, out: Path, record: Path) -> None:
    """Each peer, in its own environment; all their answers in one file, and a table with ours from `record` beside."""
    found: dict[str, Any] = {}
    for name, home in HOMES.items():
        command = [str(home / "bin" / "python"), str(Path(__file__).resolve()), "worker", name, "--folder", str(folder)]
        answer = subprocess.run(command, stdout=subprocess.PIPE, check=True, text=True).stdout
        for trial, methods in json.loads(answer.splitlines()[-1]).items():
            found.setdefault(trial, {}).update(methods)
    from deadreckon.files import write_json

    write_json(out, found)
    print(table(found, ours(record, set(found))))


def ours(record: Path, trials: set[str]) -> dict[str, dict[str, Any]]:
    """What the package and the oracle said of the same logs, in the peers' form."""
    import lzma

    out: dict[str, dict[str, Any]] = {}
    with lzma.open(record, "rt") as lines:
        for trial in map(json.loads, lines):
            name = f"{trial['family']}-{trial['seed']}"
            if name in trials:
                out[name] = {
                    words: {"choice": said["choice"], "true": true, "holds": _holds(said, np.array(true))}
                    for rule, words in (("new", "deadreckon"), ("oracle", "oracle"))
                    for said in [trial["rules"][rule]]
                    for true in [said.get("true", trial["gains"])]  # its own where it is of policies made by cross-fitting
                }
    return out


def _holds(said: dict[str, Any], true: np.ndarray) -> bool:
    low, high = (np.array([end if x is None else x for x in said[side]]) for side, end in (("low", -np.inf), ("high", np.inf)))
    return bool(((low <= true + 1e-9) & (true - 1e-9 <= high)).all())


def table(theirs: dict[str, Any], own: dict[str, Any]) -> str:
    """By family and method, as Markdown."""
    lines = ["| family | method | logs | deploys | … a policy that is not better | mean gain | all intervals cover |"]
    lines.append("|---|---|--:|--:|--:|--:|--:|")
    for family in sorted({trial.rpartition("-")[0] for trial in theirs}):
        said: dict[str, list[dict[str, Any]]] = {}
        for trial in theirs:
            if trial.rpartition("-")[0] == family:
                for method, one in (own[trial] | theirs[trial]).items():
                    said.setdefault(method, []).append(one)
        for method, each in said.items():
            gains = [0.0 if one["choice"] is None else one["true"][one["choice"]] for one in each]
            wrong = np.mean([one["choice"] is not None and gain <= 1e-9 for one, gain in zip(each, gains)])
            deploys, holds = (np.mean(x) for x in ([one["choice"] is not None for one in each], [one["holds"] for one in each]))
            lines.append(
                f"| {family} | {method} | {len(each)} | {deploys:.0%} | {wrong:.0%} | {np.mean(gains):+.3g} | {holds:.0%} |"
            )
    return "\n".join(lines)


# ---- theirs ---------------------------------------------------------------------------------------------------------


def worker(name: str, folder: Path) -> None:
    """In a peer's environment: answers of all files that it can take, as one line of JSON."""
    found = {}
    for path in sorted(folder.glob("*.npz")):
        with np.load(path) as log:
            columns = dict(log)
        one_step = bool((columns["lengths"] == 1).all())
        even = len(set(columns["lengths"].tolist())) == 1
        if name == "obp" and one_step:
            found[path.stem] = said_by(columns, obp(columns))
        if name == "scope" and even and not one_step:
            found[path.stem] = said_by(columns, scope(columns))
    print(json.dumps(found))


def said_by(log: dict[str, np.ndarray], samples: dict[str, np.ndarray]) -> dict[str, Any]:
    """By method: intervals of the gains for all policies at once, from (policies, episodes) samples by the peer's bootstrap."""
    try:
        from obp.utils import estimate_confidence_interval_by_bootstrap as bootstrap
    except ImportError:
        from scope_rl.utils import estimate_confidence_interval_by_bootstrap as bootstrap
    out = {}
    for method, each in samples.items():
        ends = []
        for sample in each:
            told = bootstrap(sample, alpha=ALPHA / len(each), n_bootstrap_samples=DRAWS, random_state=0)
            ends.append([value for key, value in told.items() if "CI" in key])
        low, high = np.array(ends).T
        best, true = int(np.argmax(low)), log["gains"]
        out[method] = {
            "choice": best if low[best] > 0 else None, "gain": each.mean(1).tolist(), "low": low.tolist(),
            "high": high.tolist(), "true": true.tolist(), "holds": bool(((low <= true + 1e-9) & (true - 1e-9 <= high)).all()),
        }  # fmt: skip
    return out


def obp(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Open Bandit Pipeline's rewards a round, less those that were logged."""
    from obp.ope import DoublyRobust, RegressionModel, SelfNormalizedInverseProbabilityWeighting
    from sklearn.linear_model import Ridge

    actions = log["probs"].shape[2]
    model = RegressionModel(n_actions=actions, base_model=Ridge(1.0))
    shared = {"context": log["context"], "action": log["action"], "reward": log["reward"]}
    fitted = model.fit_predict(**shared, pscore=log["chance"], n_folds=FOLDS, random_state=0)
    out: dict[str, list[np.ndarray]] = {"obp-dr": [], "obp-snips": []}
    for probs in log["probs"]:
        options = {"reward": log["reward"], "action": log["action"], "pscore": log["chance"], "action_dist": probs[:, :, None]}
        robust = DoublyRobust()._estimate_round_rewards(**options, estimated_rewards_by_reg_model=fitted)
        plain = SelfNormalizedInverseProbabilityWeighting()._estimate_round_rewards(**options)
        out["obp-dr"].append(robust - log["reward"])
        out["obp-snips"].append(plain - log["reward"])
    return {name: np.stack(each) for name, each in out.items()}


def scope(log: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """SCOPE-RL's values an episode, less the log's own return."""
    from scope_rl.ope.discrete import PerDecisionImportanceSampling, SelfNormalizedPDIS

    steps, discount = int(log["lengths"][0]), float(log["discount"])
    own = (log["reward"].reshape(-1, steps) * discount ** np.arange(steps)).sum(1)
    out: dict[str, list[np.ndarray]] = {"scope-pdis": [], "scope-snpdis": []}
    for probs in log["probs"]:
        options = {
            "step_per_trajectory": steps, "action": log["action"], "reward": log["reward"], "pscore": log["chance"],
            "evaluation_policy_action_dist": probs, "gamma": discount,
        }  # fmt: skip
        out["scope-pdis"].append(PerDecisionImportanceSampling()._estimate_trajectory_value(**options) - own)
        out["scope-snpdis"].append(SelfNormalizedPDIS()._estimate_trajectory_value(**options) - own)
    return {name: np.stack(each) for name, each in out.items()}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=["setup", "export", "judge", "worker"])
    parser.add_argument("peer", nargs="?", choices=list(HOMES), help="of a worker")
    parser.add_argument("--python", default=sys.executable, help="Python to make the environments from")
    some = ["null-bandit", "classes", "missing", "supported", "null-sequential"]
    parser.add_argument("--families", nargs="*", default=some)
    parser.add_argument("--split", choices=["development", "confirmatory"], default="development")
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--folder", type=Path, default=Path("runs/decisions/npz"))
    parser.add_argument("--out", type=Path, default=Path("runs/decisions/peers.json"))
    record = ROOT / "benchmarks" / "results" / "decisions.jsonl.xz"
    parser.add_argument("--record", type=Path, default=record, help="of the study, whose answers stand beside the peers'")
    options = parser.parse_args()
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    if options.action == "setup":
        setup(options.python)
    elif options.action == "export":
        from decisions import ONE_THREAD

        os.environ |= ONE_THREAD
        export(options.families, options.split, options.trials, options.folder)
    elif options.action == "judge":
        judge(options.folder, options.out, options.record)
    else:
        worker(options.peer, options.folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
