"""What tells cells apart: revisions that stand beside the code, and not its source."""

import dataclasses
import inspect

import pytest

from deadreckon.agents import AGENTS, agent_class
from deadreckon.agents.cql import CQL
from deadreckon.agents.sac import SAC
from deadreckon.bench.identity import revisions_of
from deadreckon.bench.plan import plan
from deadreckon.bench.suite import read
from deadreckon.bench.work import perform
from deadreckon.errors import UserError
from deadreckon.files import digest
from deadreckon.mbo import DESIGNERS, designer
from deadreckon.online.experience import experience_of
from deadreckon.ope import ESTIMATORS, FQE, BehaviorModel, DoublyRobust, estimator
from deadreckon.ope.registry import fits_name
from deadreckon.tasks.registry import names, task
from deadreckon.training.hyperparameters import described
from deadreckon.training.revisions import revisions

METHODS = [
    *(agent_class(name) for name in AGENTS), *(type(designer(name)) for name in DESIGNERS), BehaviorModel,
    *(type(estimator(name)) for name in ESTIMATORS), *(type(task(name)) for name in names()),
    *(experience_of(agent_class(name)()) for name in AGENTS),
]  # fmt: skip
SUITES = {
    "learn": 'logs = ["maze2d-umaze-v1"]\nrows = 600\nsteps = 40\nevaluations = 2\n[methods]\nA = { agent = "sac" }\n'
    'B = { agent = "cql" }\nC = { agent = "iql" }\n',
    "online": 'tasks = ["inverted-pendulum"]\nsteps = 20_000\n[methods]\nA = { agent = "sac" }\nB = { agent = "mbpo" }\n',
    "design": 'problems = ["branin"]\n[methods]\nA = { agent = "forward" }\nB = { agent = "best" }\n',
    "ope": 'logs = ["hopper-medium-v2"]\nrows = 2000\n[methods]\nA = { agent = "fqe" }\nB = { agent = "dr" }\n'
    'C = { agent = "is" }\n',
}


@pytest.fixture
def planned(tmp_path):
    def make(kind):
        path = tmp_path / f"{kind}.toml"
        path.write_text(f'kind = "{kind}"\nseeds = 1\n{SUITES[kind]}')
        return {job.method: job for job in plan(read(path))}

    return make


def changed(before, after):
    """Names of the methods whose cells are others."""
    return "".join(name for name in before if before[name].cells != after[name].cells)


CLASSES = {each for kind in METHODS for each in kind.__mro__ if each.__module__.startswith("deadreckon")}


@pytest.mark.parametrize("kind", sorted(CLASSES, key=lambda kind: kind.__name__))
def test_every_class_has_a_revision_of_its_own(kind):
    number = vars(kind).get("revision")
    assert isinstance(number, int), f"{kind.__name__} in {inspect.getsourcefile(kind)} needs `revision: ClassVar[int] = 1`"
    assert number >= 1


@pytest.mark.parametrize(
    ("kind", "what", "whose"),
    [
        ("learn", "agents.agent.Agent.revision", "ABC"), ("learn", "agents.sac.SAC.revision", "AB"),
        ("learn", "agents.cql.CQL.revision", "B"), ("learn", "data.batch.REVISION", "ABC"),
        ("learn", "training.program.REVISION", "ABC"), ("learn", "runs.evaluate.REVISION", "ABC"),
        ("learn", "tasks.maze2d.Maze2D.revision", "ABC"), ("learn", "tasks.flow.Flow.revision", ""),
        ("online", "online.exploration.Exploration.revision", "AB"), ("online", "agents.sac.SAC.revision", "AB"),
        ("online", "online.branched_rollouts.BranchedRollouts.revision", "B"),
        ("online", "tasks.gym_mujoco.GymMujoco.revision", "AB"),
        ("design", "mbo.forward.Forward.revision", "A"), ("design", "mbo.protocol.REVISION", "AB"),
        ("ope", "ope.fqe.FQE.revision", "AB"), ("ope", "ope.behavior_model.BehaviorModel.revision", "BC"),
        ("ope", "ope.dope.REVISION", "ABC"), ("ope", "stats.interval.REVISION", "ABC"),
    ],
)  # fmt: skip
def test_a_raised_revision_changes_the_cells_that_rest_on_it_and_no_others(planned, monkeypatch, kind, what, whose):
    before = planned(kind)
    monkeypatch.setattr(f"deadreckon.{what}", 99)
    assert changed(before, planned(kind)) == whose


def test_a_problem_has_a_revision(planned, monkeypatch):
    from deadreckon.mbo import PROBLEMS

    before = planned("design")
    monkeypatch.setitem(PROBLEMS, "branin", PROBLEMS["branin"]._replace(revision=2))
    assert changed(before, planned("design")) == "AB"


def test_revisions_of_a_class_stand_before_those_it_inherits_and_those_it_holds(monkeypatch):
    monkeypatch.setattr(SAC, "revision", 5)
    monkeypatch.setattr(FQE, "revision", 7)
    assert revisions(CQL) == revisions(CQL()) == [1, 1, 5, 1]  # ScaledRewards stands before SAC
    own, base, *held = revisions(estimator("dr"))
    assert (own, base) == (vars(DoublyRobust)["revision"], 1)
    assert held == [7, 1, 1]  # FQE, which is an estimator, and the behaviour model


def test_what_is_planned_at_other_revisions_is_not_run(planned, tmp_path):
    from deadreckon.bench.jobs import Program

    job = planned("learn")["A"]
    other = dataclasses.replace(job, revisions=job.revisions | {"training": 99})
    with pytest.raises(UserError, match=r"planned at revisions .*'training': 99.*, where it would run are .*'training': \d"):
        perform(Program((other,)), tmp_path)
    assert job.revisions == revisions_of(job)


def test_fits_that_estimators_share_are_of_all_their_revisions(monkeypatch):
    before = fits_name()
    assert before == fits_name()
    monkeypatch.setattr(FQE, "revision", 99)
    assert fits_name() != before


def test_a_file_is_judged_in_the_task_of_the_log_that_it_holds(planned, monkeypatch):
    """Under whatever name it lies: its cells have the revisions of the evaluation and of the task."""
    job = planned("learn")["A"]
    held = dataclasses.replace(job, on="mine.hdf5", data="maze2d-umaze-v1 0123456789abcdef")
    assert revisions_of(held) == revisions_of(job)
    assert "task" in revisions_of(held)
    assert "task" not in revisions_of(dataclasses.replace(held, data="anybody 0123456789abcdef"))


# Cells of estimators are known by the settings that are not the defaults: whoever changes a default, also of the FQE or the
# behaviour model inside, raises the revision of its class, as old cells would be taken for new ones, and the digest here.
# The second part is the text that names cells, which another version of Equinox might write otherwise.
DEFAULTS = {
    "fqe": ["e655e21e", "4807ee8a"], "fqe-linear": ["366e529b", "c2a12720"], "fqe-d": ["25ad691b", "6ac6fd28"],
    "is": ["92cd8222", "0309affa"], "pdis": ["575e12dd", "9e524717"], "wis": ["a1f373a3", "6dd9ba22"],
    "dr": ["217848b9", "0465a749"], "plain-dr": ["9bd1d46c", "2ffc3e6a"], "magic": ["97c9269c", "62fb041c"],
    "dr-linear": ["cace75f9", "2054d177"], "drl": ["291a89cf", "9ce22f89"], "switch": ["f6d32c96", "ba1bdcb2"],
    "dros": ["9ede0e53", "0fc49cc7"], "mrdr": ["54939a5c", "b4abfc81"], "smis": ["831769b8", "67bde3a7"],
    "dice": ["9b1d733c", "e0054bc2"], "dual-dice": ["0016f6d3", "977a273e"], "gen-dice": ["3c4c592e", "85f7efb1"],
    "vpm": ["6d7e121d", "33ed2f9d"], "mb-ff": ["725a569e", "f66a3461"], "mb-ar": ["9d9d6481", "be4cc20f"],
}  # fmt: skip


@pytest.mark.parametrize("name", ESTIMATORS)
def test_defaults_of_estimators_are_those_that_cells_rest_on(name):
    made = estimator(name)
    assert [digest(described(made), 4), digest(str(made), 4)] == DEFAULTS[name]
