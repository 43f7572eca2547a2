"""Run folders: damaged parts are told by their names, and what keeps a run from being made longer is told with its remedy."""

import json
from dataclasses import fields, replace

import pytest

from deadreckon import temporaries
from deadreckon.agents import AGENTS, agent_class
from deadreckon.bench.store import Store
from deadreckon.data.spec import Box, Spec
from deadreckon.errors import UserError
from deadreckon.files import read_json
from deadreckon.runs.folder import Folder
from deadreckon.temporaries import SUFFIX, beside


def test_what_follows_from_the_length_of_a_run_is_told_where_it_is_made_longer(tmp_path):
    def config(steps, **fields):
        fields = {"actor_decay_steps": float(steps), "beta": 3.0} | fields
        evaluation = {"every": 1, "episodes": 1}
        return {"agent": {"name": "iql", "fields": fields}, "seeds": [0], "steps": steps, "evaluation": evaluation,
                "data": {"name": "mine", "fingerprint": "f"}, "task": None, "versions": {}, "revisions": {}}  # fmt: skip

    (tmp_path / "r").mkdir()
    (folder := Folder(tmp_path / "r")).begin(config(3))
    longer = r"actor_decay_steps was 3.0, now 6.0; it follows from the run's length; --agent.actor-decay-steps 3.0 keeps it, or"
    with pytest.raises(UserError, match=longer):
        folder.check(config(6), resume=True)
    assert folder.check(config(6, actor_decay_steps=3.0), resume=True) == []
    status = {"step": 3, "steps": 3, "finished": True, "failures": [None]}
    (tmp_path / "r" / "status.json").write_text(json.dumps(status))
    folder.lengthen(config(3, actor_decay_steps=3.0))
    assert read_json(tmp_path / "r" / "status.json") == status
    for other in (config(6, beta=1.0), config(3, actor_decay_steps=6.0)):
        with pytest.raises(UserError, match=r"actor_decay_steps was 3.0, now 6.0; choose another --out"):
            folder.check(other, resume=True)
    folder.lengthen(config(6, actor_decay_steps=3.0))
    assert read_json(tmp_path / "r" / "status.json") == {"step": 3, "steps": 6, "finished": False}
    assert read_json(tmp_path / "r" / "run.json")["steps"] == 6


def test_what_dead_processes_left_is_forgotten_and_what_others_write_is_not(tmp_path, monkeypatch):
    """Also a folder, such as that of an export into the run's."""
    with beside(tmp_path / "numpy", folder=True) as living:
        monkeypatch.setattr(temporaries, "_cleared", set())  # as in another process
        (tmp_path / "metrics").mkdir()
        (half := tmp_path / f".onnx.x{SUFFIX}").mkdir()
        (half / "part").touch()
        (tmp_path / "metrics" / f".0000000050.parquet.x{SUFFIX}").touch()
        (tmp_path / ".notes.tmp").touch()
        Folder(tmp_path).drop_after(10)
        assert sorted(path.name for path in tmp_path.rglob("*")) == sorted([living.name, ".notes.tmp", "metrics"])


@pytest.mark.parametrize("kind", ["metrics", "evaluations"])
def test_what_is_beyond_the_checkpoint_is_forgotten(kind, tmp_path):
    """Evaluations too: a run that ends sooner after its resume would have one of a policy that is gone as its last."""
    (tmp_path / kind).mkdir()
    for step in (10, 20):
        (tmp_path / kind / f"{step:010d}.parquet").touch()
    Folder(tmp_path).drop_after(10)
    assert [path.name for path in (tmp_path / kind).iterdir()] == [f"{10:010d}.parquet"]


@pytest.mark.parametrize("name", AGENTS)
def test_what_follows_from_the_length_of_a_run_is_named_by_its_agent(name):
    kind = agent_class(name)
    log, rows = Spec.empty((4,), Box((-1.0,), (1.0,)), "any"), 100 if kind.offline else 0
    own = {"min_target": None} if name == "mobile" else {}  # without a log there are no rewards above its floor
    short, long = (kind(**own).resolve(replace(log, rows=rows), steps) for steps in (100, 200))
    assert kind.by_length == tuple(f.name for f in fields(kind) if getattr(short, f.name) != getattr(long, f.name))


def test_a_damaged_part_is_one_line_that_names_it(tmp_path):
    part = Folder(tmp_path).part("metrics", 20)
    part.parent.mkdir()
    part.write_bytes(b"PAR1 cut short")
    with pytest.raises(UserError, match=f"{part}: cannot be read as a table of a run, it is damaged or cut short"):
        Folder(tmp_path).table("metrics")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "job.parquet").write_bytes(b"PAR1 cut short")
    with pytest.raises(UserError, match="job.parquet: cannot be read as a table of results, it is damaged"):
        Store(tmp_path).results()
