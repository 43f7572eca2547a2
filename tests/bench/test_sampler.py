"""Optuna proposes settings in rounds, by results of the part of the log that chooses, and the same ones again."""

import sys

import numpy as np
import pytest

from deadreckon.bench import sampler as module
from deadreckon.bench import tune
from deadreckon.bench.jobs import Program
from deadreckon.bench.sampler import OptunaSampler, Range, tune_in_rounds
from deadreckon.bench.store import JobResult, Store
from deadreckon.bench.tuned import named
from deadreckon.cli.tune import _values
from deadreckon.data.formats.io import read
from deadreckon.data.split import Holdout
from deadreckon.errors import UserError
from deadreckon.runs.holdout import trial_parts

UMAZE = "maze2d-umaze-v1"
optuna = pytest.importorskip("optuna")


def peak(fields):
    """Highest where alpha is 3."""
    return -abs(np.log(fields["alpha"] / 3.0))


def search(sampler, rounds=10, n=4):
    found = []
    for _ in range(rounds):
        asked = sampler.ask(n)
        sampler.tell({named(each): peak(each) for each in asked})
        found += asked
    return found


def test_the_defaults_come_first_and_proposals_draw_near_to_what_is_best():
    found = search(OptunaSampler("td3_bc", {"alpha": Range(0.01, 1000.0, log=True)}, seed=1))
    assert found[0] == {"alpha": 2.5}
    early, late = (np.median([-peak(each) for each in part]) for part in (found[1:9], found[-12:]))
    assert late < early / 2
    assert found == search(OptunaSampler("td3_bc", {"alpha": Range(0.01, 1000.0, log=True)}, seed=1))
    assert found != search(OptunaSampler("td3_bc", {"alpha": Range(0.01, 1000.0, log=True)}, seed=2))
    assert all(0.01 <= each["alpha"] <= 1000.0 for each in found)


def test_values_may_be_tuples_and_whole_numbers_stay_whole():
    chosen = OptunaSampler("td3_bc", {"hidden": [(16, 16), (32, 32)], "batch_size": Range(16, 64)}).ask(8)
    assert {each["hidden"] for each in chosen} == {(16, 16), (32, 32)}
    assert all(isinstance(each["batch_size"], int) and 16 <= each["batch_size"] <= 64 for each in chosen)


def test_a_value_that_stands_twice_is_one_choice():
    assert OptunaSampler("td3_bc", {"alpha": [1.0, 5.0, 1.0]}).space["alpha"] == [1.0, 5.0]
    with pytest.raises(UserError, match="hidden takes a tuple of numbers"):
        OptunaSampler("td3_bc", {"hidden": [[16, 16], [32, 32]]})


def test_a_setting_that_failed_is_told_as_failed():
    sampler = OptunaSampler("td3_bc", {"alpha": [1.0, 5.0]})
    first, second = sampler.ask(2)
    sampler.tell({named(first): -np.inf, named(second): 1.0} if first != second else {named(first): -np.inf})
    states = [trial.state.name for trial in sampler.study.trials]
    assert states[0] == "FAIL"
    assert "RUNNING" not in states


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"alfa": [1.0]}, "unknown field of td3_bc 'alfa'"),
        ({"alpha": []}, "alpha has no values to try"),
        ({"lr": Range(-1.0, 1.0)}, "lr"),
    ],
)
def test_what_cannot_be_tried_is_refused(given, message):
    with pytest.raises(UserError, match=message):
        OptunaSampler("td3_bc", given)


def test_ranges_are_read_and_checked():
    assert _values("1e-4..1e-2:log") == Range(1e-4, 1e-2, True)
    assert _values("1.5e-4..1e-2:log") == Range(1.5e-4, 1e-2, True)
    assert _values("2.5e-1..0.5") == Range(0.25, 0.5)
    assert _values("-1.5..-0.5") == Range(-1.5, -0.5)
    assert _values("0.5..2") == Range(0.5, 2, False)
    assert _values("16..64") == Range(16, 64)
    assert _values("0.5,2") == [0.5, 2]
    assert _values("../mine,b") == ["../mine", "b"]
    for low, high, log in ((2.0, 1.0, False), (0.0, 1.0, True)):
        with pytest.raises(UserError, match="LOW below HIGH, and above 0 for :log"):
            Range(low, high, log)


def test_optuna_is_an_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "optuna", None)
    with pytest.raises(UserError, match=r"install the extra tune"):
        OptunaSampler("td3_bc", {"alpha": [1.0]})


class Here:
    """Runs jobs in this process; a score follows from the setting."""

    lanes, workers, room = 1, 1, True

    def __init__(self, ran):
        self.ran, self.waiting = ran, []

    def begin(self, program: Program):
        self.waiting.append(program)

    def wait(self, seconds):
        from deadreckon.bench.executor import Event

        program = self.waiting.pop(0)
        [job] = program.jobs
        self.ran.append(job.settings["alpha"])
        told = {"raw": 0.0, "steps": 1, "seconds": 1.0, "versions": "{}"}
        told["failure"] = "loss was not finite at update 3" if job.settings["alpha"] > 100 else ""
        rows = [{"seed": seed, "score": 100 * peak(job.settings)} | told for seed in job.seeds]
        return Event("done", program, [JobResult(rows, [])])

    def close(self):
        pass


def test_rounds_choose_the_best_of_all_and_are_not_done_again(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ROUND", 3)
    ran: list[float] = []
    rounds: list[str] = []

    def run():
        sampler = OptunaSampler("td3_bc", {"alpha": Range(0.01, 1000.0, log=True)}, seed=3)
        return tune_in_rounds(
            "td3_bc", [UMAZE], sampler, by="simulator", trials=8, steps=10, seeds=1, store=Store(tmp_path),
            executor=lambda: Here(ran), on_event=lambda event: None, tell=rounds.append,
        )  # fmt: skip

    found = run()
    assert len(ran) == len(found.trials) == 8
    assert [line.split(":")[0] for line in rounds] == [f"settings {span} of 8" for span in ("1 to 3", "4 to 6", "7 to 8")]
    healthy = [trial for trial in found.trials if not trial.failure]
    assert found.best is max(healthy, key=lambda trial: trial.scores.mean())
    assert any(trial.failure for trial in found.trials)
    assert run().best.fields == found.best.fields
    assert len(ran) == 8  # the second call found everything done


def test_no_round_looks_at_what_train_holds_out(tmp_path, monkeypatch):
    """Rounds are told, and the choice is made, by estimates on the part that chooses, and never on the part that judges."""
    rng, rows = np.random.default_rng(0), 120
    path = tmp_path / "mine.npz"
    np.savez(
        path, observations=rng.normal(size=(rows, 3)), actions=rng.uniform(-1, 1, (rows, 2)), rewards=rng.normal(size=rows),
        terminals=np.arange(rows) % 2 == 1,
    )  # fmt: skip
    log, judged = read(path), []

    def estimated(folders, data, estimators, **settings):
        judged.append((set(data.episode_ids.tolist()), settings["counted"], settings["out"]))
        policies = [{"run": folder.name} for folder in folders]
        told = {"value": [1.0] * len(policies), "gain": [[0.0, -1.0, 1.0]] * len(policies)}
        return type("Judged", (), {"results": {"policies": policies, "results": [told]}})

    monkeypatch.setattr(tune, "judge", estimated)
    ran: list[float] = []
    found = tune_in_rounds(
        "td3_bc", [str(path)], OptunaSampler("td3_bc", {"alpha": Range(0.1, 10.0)}), by="ope", trials=6, steps=10, seeds=1,
        store=Store(tmp_path / "out"), executor=lambda: Here(ran), on_event=lambda event: None,
    )  # fmt: skip
    held = set(log.episode_ids[Holdout().parts(log).held].tolist())
    chooses = set(trial_parts(log)[1].episode_ids.tolist())
    assert [each[0] for each in judged] == [chooses] * 2
    assert not held & chooses
    assert [each[1] for each in judged] == [False, False]  # no card rests on these looks
    assert len({each[2] for each in judged}) == 2
    assert [trial.values.tolist() for trial in found.trials] == [[1.0]] * 6
