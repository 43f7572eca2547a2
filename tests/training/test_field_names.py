"""Hyperparameters under other names: older ones of files, and those of publications."""

import json
import re
from dataclasses import fields

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.agents import AGENTS, agent_class
from deadreckon.bench import suite
from deadreckon.bench.plan import plan
from deadreckon.bench.tune import candidates
from deadreckon.cli.main import main
from deadreckon.collect.gym import _fields
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.errors import UserError
from deadreckon.mbo import DESIGNERS, designer
from deadreckon.ope.registry import ESTIMATORS, estimator
from deadreckon.policies import library
from deadreckon.report import write
from deadreckon.runs.lanes import agents_of
from deadreckon.training.field_names import meant, with_field_names
from tests.agents.worlds import corridor

MADE = {
    **{f"agent {name}": agent_class(name) for name in AGENTS},
    **{f"designer {name}": type(designer(name)) for name in DESIGNERS},
    **{f"estimator {name}": type(estimator(name)) for name in ESTIMATORS},
}
SMALL = {"hidden": (8,), "batch_size": 8}


@pytest.mark.parametrize("name", MADE)
def test_other_names_are_no_fields_and_mean_some(name):
    kind = MADE[name]
    known = {field.name for field in fields(kind)}
    for base in kind.__mro__:
        for other, field in vars(base).get("other_names", {}).items():
            assert other == field or field in {f.name for f in fields(base)}
            assert other in known or meant(kind, other) == [field]


def test_what_is_meant():
    iql, cql, td3 = map(agent_class, ("iql", "cql", "td3"))
    assert with_field_names(iql, {"sharpness": 1, "target_rate": 2, "gamma": 3}) == {"beta": 1, "tau": 2, "discount": 3}
    assert meant(cql, "conservatism") == ["cql_weight"]
    assert meant(cql, "alpha") == ["cql_weight", "temperature"]  # either, so neither is taken
    assert with_field_names(cql, {"alpha": 1}) == {"alpha": 1}
    assert meant(td3, "learning_rate") == ["actor_lr", "critic_lr"]
    assert meant(agent_class("td3_bc"), "alpha") == ["alpha"]  # a field comes first
    assert meant(agent_class("xql"), "temperature") == ["loss_temperature"]
    assert meant(agent_class("xql"), "sharpness") == ["beta"]  # of its base class
    assert meant(iql, "nonsense") == []
    with pytest.raises(UserError, match="IQL: sharpness and beta are one setting"):
        with_field_names(iql, {"sharpness": 1, "beta": 2})


@pytest.mark.slow
def test_a_run_folder_with_old_names_is_read_reported_and_gone_on_with(tmp_path):
    log, agent = corridor(200), dr.agents.IQL(beta=2.0, tau=0.1, actor_decay_steps=0.0, **SMALL)
    path = dr.train(agent, log, steps=4, out=tmp_path / "run").path
    config = json.loads((path / "run.json").read_text())
    now = config["agent"]["fields"]
    old = {"beta": "sharpness", "tau": "target_rate"}
    config["agent"]["fields"] = {old.get(name, name): value for name, value in now.items()}
    (path / "run.json").write_text(json.dumps(config))

    run = dr.load_run(path)
    assert run.config["agent"]["fields"] == now
    assert agents_of(run.config) == [agent.resolve(log.spec, 4)]
    text = write(path, tmp_path / "report.html").read_text()
    assert "beta = 2.0" in text
    assert "sharpness" not in text
    assert dr.train(agent, log, steps=8, out=path, resume=True).config["agent"]["fields"] == now
    with pytest.raises(UserError, match=r"agent.fields.beta was 2.0, now 3.0"):
        dr.train(agent.replace(beta=3.0), log, steps=8, out=path, resume=True)


def test_suites_and_tune_take_old_names(tmp_path):
    file = tmp_path / "old.toml"
    text = 'seeds = 1\nsteps = 10\nlogs = ["maze2d-umaze-v1"]\n[methods]\nIQL = { agent = "iql", fields = %s }\n'
    jobs = {}
    for fields_ in ("{ sharpness = 2.0 }", "{ beta = 2.0 }"):
        file.write_text(text % fields_)
        jobs[fields_] = plan(suite.read(file))
    assert jobs["{ sharpness = 2.0 }"] == jobs["{ beta = 2.0 }"]
    assert candidates("iql", {"sharpness": [1.0, 3.0]}) == [{"beta": 3.0}, {"beta": 1.0}]
    assert designer("forward", ascent=3) == designer("forward", ascent_steps=3)
    assert designer("nemo", weight=0.5, ratio=2) == designer("nemo", label_weight=0.5, model_updates=2)
    assert estimator("dr", target_rate=0.5) == estimator("dr", tau=0.5) == estimator("dr", fqe={"target_rate": 0.5})


def test_the_agents_of_the_packages_policies_are_known():
    for task in ("hopper", "ant"):
        written = _fields(library.about(task)["run"]["agent"])
        assert "target_rate" in written
        assert agent_class("sac")(**with_field_names(agent_class("sac"), written)).tau == written["target_rate"]


@pytest.mark.slow
def test_the_command_line_takes_other_names(tmp_path, capsys):
    log = str(tmp_path / "log.hdf5")
    write_hdf5(corridor(200), log)
    words = ["train", "--agent", "iql", "--data", log, "--steps", "2", "--agent.hidden", "8", "--agent.batch-size", "8",
             "--out", str(tmp_path / "run")]  # fmt: skip
    assert main([*words, "--agent.gamma", "0.9", "--agent.sharpness=2", "--agent.polyak", "0.1"]) == 0
    made = dr.load_run(tmp_path / "run").config["agent"]["fields"]
    np.testing.assert_allclose((made["discount"], made["beta"], made["tau"]), (0.9, 2.0, 0.1))
    assert main([*words, "--agent.beta", "1", "--agent.sharpness", "2"]) == 2
    assert "--agent.beta and --agent.sharpness are one setting" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("words", "suggested"), [
    (["train", "--agent", "cql", "--data", "x", "--agent.alpha", "1"], "--agent.cql-weight or --agent.temperature"),
    (["train", "--agent", "td3", "--data", "x", "--agent.lr", "1"], "--agent.actor-lr or --agent.critic-lr"),
    (["train", "--agent", "iql", "--data", "x", "--beta", "1"], "--agent.beta"),
    (["train", "--agent", "iql", "--data", "x", "--gamma", "1"], "--agent.discount"),
    (["ope", "--data", "x", "--policies", "y", "--gamma", "1"], "--discount"),
])  # fmt: skip
def test_what_is_not_clear_is_suggested(words, suggested, capsys):
    assert main(words) == 2
    assert re.search(rf"unknown option --[\w.]+: did you mean {suggested}\?\n", capsys.readouterr().err)
