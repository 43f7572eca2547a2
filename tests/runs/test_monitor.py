"""A new log against a policy's own: nothing where nothing has changed, and each change by its name."""

import dataclasses
import json
import shutil

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.data.spec import Box
from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.nets.mlp import MLP
from deadreckon.ope.estimand import Estimand
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy
from deadreckon.policies.kinds import Deterministic
from deadreckon.report.monitored import lead
from deadreckon.runs import compared
from deadreckon.runs.decision_record import saved_at
from deadreckon.runs.monitor import Monitored, _acts, _done, _untested, monitor
from deadreckon.runs.reading import Read
from deadreckon.runs.realised import Realised, finished, realised, returns_of
from deadreckon.runs.run import load
from deadreckon.runs.subject import Subject, estimates_of, subject
from deadreckon.stats.confidence_sequence import confidence_sequence, refuted_at
from tests.recorded import decision

BC = dr.agents.BC(hidden=(4,), batch_size=8)
FRESH = "actions with the policy's greedy ones in the episodes of the reference on which it was not trained"


def table(rows, seed, shift=0.0, worse=0.0):
    """Single decisions; the reward is 1 in two fifths of the rows."""
    rng = np.random.default_rng(seed)
    return pd.DataFrame({
        "age": rng.normal(50 + shift, 10, rows).round(3), "kind": rng.choice(["old", "new"], rows, p=(0.3, 0.7)),
        "action": rng.choice(["call", "mail"], rows), "reward": (rng.random(rows) < 0.4 - worse).astype(int),
    })  # fmt: skip


@pytest.fixture(scope="module")
def place(tmp_path_factory):
    """A run on a table, with estimates that promise exactly what is true."""
    folder = tmp_path_factory.mktemp("monitor")
    table(300, 0).to_csv(folder / "log.csv", index=False)
    table(300, 4).to_csv(folder / "first.csv", index=False)  # of the first weeks in use
    table(250, 1).to_csv(folder / "same.csv", index=False)
    table(250, 2, shift=12.0).to_csv(folder / "older.csv", index=False)
    table(250, 3, worse=0.3).to_csv(folder / "worse.csv", index=False)
    dr.train(BC, folder / "log.csv", steps=2, task=False, out=folder / "run")
    promise(folder, 0.4)
    return folder


def promise(folder, low, **policy):
    told = decision([{"name": "run seed 0"} | policy], [{"value": [0.5, 0.4], "low": [low, 0.3], "high": [0.6, 0.5]}])
    write_json(folder / "estimates.json", told)


def of_reference(place, name, **options):
    return monitor(place / "run", place / name, reference=place / "first.csv", estimates=place, **options)


@pytest.mark.slow
def test_nothing_is_found_where_nothing_has_changed(place):
    found = of_reference(place, "same.csv")
    assert not found.alarm, found
    assert isinstance(found.value, Realised)
    assert found.value.interval.low < 0.4 < found.value.interval.high
    assert found.value.range == (0.0, 1.0)  # rewards of 0 and 1 leave no doubt about it
    assert [each.what.name for each in found.columns] == ["age", "kind", "action"]


def test_all_that_may_be_reported_shares_the_chance_of_a_false_alarm(place, monkeypatch):
    """Changes of observations and of actions, what lies outside, and the value, together."""
    shares = []
    for name, real in (("compared.drifts", compared.drifts), ("compared.outside", compared.outside), ("realised", realised)):

        def spy(*given, real=real):
            shares.append(given[4])
            return real(*given)

        monkeypatch.setattr(f"deadreckon.runs.monitor.{name}", spy)
    found = monitor(place / "run", place / "same.csv", estimates=place, alpha=0.08)
    assert len(shares) == 4
    assert sum(shares) == pytest.approx(0.08)
    # The value's half is that of its lower end, below which alone it is reported: both ends together have the whole.
    sequence = confidence_sequence(pd.read_csv(place / "same.csv")["reward"], (0.0, 1.0), 0.08)
    np.testing.assert_allclose(found.value.sequence, sequence)


@pytest.mark.slow
def test_a_data_frame_is_read_as_the_log_was(place):
    for name in ("same.csv", "older.csv"):
        frame = pd.read_csv(place / name)
        frame.loc[3, "age"] = np.nan  # which the policy's log never misses
        frame.to_csv(place / f"gaps-{name}", index=False)
        found = monitor(place / "run", frame)
        assert found.findings == monitor(place / "run", place / f"gaps-{name}").findings
        assert any(each.about == "outside" for each in found.findings)
    told = dr.explain(place / "run", pd.read_csv(place / "log.csv"))
    assert told.columns == dr.explain(place / "run").columns


@pytest.mark.parametrize(
    ("given", "words"),
    [(None, "monitor needs the new log: a Dataset, a file or a data frame"), (3, "a log is a Dataset, a file or .*, got int"),
     ({"age": [1.0]}, "frame: no column kind, to which the schema gives the role observation: known: age")],
)  # fmt: skip
def test_what_is_no_log(place, given, words):
    with pytest.raises(UserError, match=words):
        monitor(place / "run", given)


def test_a_policy_is_named_by_its_run(place):
    with pytest.raises(UserError, match="a policy is named by its run, its folder or its file, got EnvPolicy"):
        monitor(dr.load_run(place / "run").policy, place / "same.csv")


def test_the_log_of_a_cross_fit_is_known_by_its_runs(place, tmp_path):
    cross = dr.cross_fit(BC, dr.read(place / "log.csv"), out=tmp_path / "cross", folds=2, steps=2, task=False)
    found = monitor(cross.path, place / "same.csv")
    assert found.reference == "log"
    assert [each.what.name for each in found.columns] == ["age", "kind", "action"]


def test_a_column_that_has_changed_is_named_and_no_other(place):
    found = of_reference(place, "older.csv")
    alarms = {(each.about, each.name) for each in found.findings if each.alarm}
    assert ("observation", "age") in alarms
    assert alarms <= {("observation", "age"), ("outside", "age")}
    column = found.columns[0]
    assert column.shift == pytest.approx(1.2, abs=0.2)
    assert column.now - column.before == pytest.approx(12, abs=2)


@pytest.mark.slow
def test_a_value_below_the_estimate_is_an_alarm_and_stays_one(place):
    found = of_reference(place, "worse.csv")
    assert [(each.about, each.name) for each in found.findings if each.alarm] == [("value", "realised")]
    assert isinstance(found.value, Realised)
    assert found.value.below_at is not None
    log = dr.read(place / "worse.csv", action="action", reward="reward")
    options = {"reference": place / "first.csv", "estimates": place}
    before = monitor(place / "run", log.select(np.arange(found.value.below_at - 1)), **options)
    at = monitor(place / "run", log.select(np.arange(found.value.below_at)), **options)
    assert not before.alarm
    assert at.alarm


def test_rewards_that_are_not_known_yet_are_told(place):
    log = table(250, 1)
    log.loc[180:, "reward"] = 0
    found = monitor(place / "run", log, estimates=place)
    [line] = [each for each in found.findings if each.name == "latest"]
    assert not line.alarm
    assert "if their rewards are not known yet, leave these episodes out" in line.text
    assert any(each.alarm for each in found.findings if each.name == "realised")
    for other, made_by in ((log, "reference"), (log[:180], None)):
        found = monitor(place / "run", other, estimates=place, made_by=made_by)
        assert not any(each.name == "latest" for each in found.findings)


@pytest.mark.slow
def test_a_log_of_the_policy_in_use_needs_no_propensities_and_estimates_lie_beside(tmp_path):
    table(300, 0).assign(p=0.5, cost=1.0).to_csv(tmp_path / "log.csv", index=False)
    table(250, 1).to_csv(tmp_path / "same.csv", index=False)
    log = dr.read(tmp_path / "log.csv", action="action", reward="reward", propensity="p", cost="cost")
    dr.train(BC, log, steps=2, task=False, out=tmp_path / "runs" / "run")
    (tmp_path / "runs" / "run-ope").mkdir()
    promise(tmp_path / "runs" / "run-ope", 0.4, file=str(tmp_path / "runs" / "run" / "policies" / "seed0.npz"))
    found = monitor(tmp_path / "runs" / "run", tmp_path / "same.csv", reference=table(300, 4))
    assert not found.alarm
    assert isinstance(found.value, Realised)


def test_a_reference_needs_no_more_columns_than_a_log_of_the_policy_in_use(tmp_path):
    """The first weeks in use have no propensities, and may miss a value that the log has."""
    table(300, 0).assign(p=0.5, cost=1.0).to_csv(tmp_path / "log.csv", index=False)
    log = dr.read(tmp_path / "log.csv", action="action", reward="reward", propensity="p", cost="cost")
    run = dr.train(BC, log, steps=2, task=False, out=tmp_path / "run")
    for name, seed in (("first.csv", 1), ("later.csv", 2)):
        rows = table(60, seed)
        rows.loc[3, "age"] = np.nan
        rows.to_csv(tmp_path / name, index=False)
    found = monitor(run, tmp_path / "later.csv", reference=tmp_path / "first.csv")
    assert found.reference == "first"
    assert found.columns[0].missing == (1 / 60, 1 / 60)
    assert not found.alarm


def test_a_column_that_is_called_as_a_mark_is_itself():
    rows = {"x": [1.0, 2.0, 3.0], "x_missing": [0.0, 1.0, 0.0], "action": ["a", "b", "a"], "reward": [1.0, 0.0, 1.0]}
    log = dr.Dataset.from_frame(rows, action="action", reward="reward")
    one = Subject("p", None, "p", None, None, Read(log.provenance.extra), {})
    found = one.log({**rows, "x_missing": [None, 1.0, 0.0]}, gaps=True, option="log=")
    np.testing.assert_allclose(found.observations, [[1, 1 / 3], [2, 1], [3, 0]])
    assert found.extras["missing x_missing"].tolist() == [True, False, False]
    with pytest.raises(UserError, match="column x is empty in row 1"):
        one.log({**rows, "x": [1.0, None, 3.0]}, gaps=True, option="log=")


def test_estimates_of_another_policy_of_the_same_name_are_not_taken(place, tmp_path):
    """Such as of a candidate of `recommend`, whose folder of runs lies beside."""
    for name in ("run", "other/run"):
        shutil.copytree(place / "run", tmp_path / "runs" / name)
    mine, other = (tmp_path / "runs" / name / "policies" / "seed0.npz" for name in ("run", "other/run"))
    one = subject(tmp_path / "runs" / "run")
    promise(tmp_path / "runs" / "other", 0.1, file=str(other))
    assert estimates_of(one) is None
    assert estimates_of(one, tmp_path / "runs" / "other") is not None  # whoever names it means it
    (tmp_path / "runs" / "both").mkdir()
    policies = [{"name": "run seed 0", "file": str(other)}, {"name": "run seed 0 again", "file": str(mine)}]
    value = {"value": [0.1, 0.5, 0.4], "low": [0.0, 0.4, 0.3], "high": [0.2, 0.6, 0.5]}
    write_json(tmp_path / "runs" / "both" / "estimates.json", decision(policies, [value]))
    for given in (None, tmp_path / "runs" / "both"):
        assert estimates_of(one, given)[1] == 1
    mine.rename(tmp_path / "moved.npz")
    policies[1]["file"] = str(tmp_path / "moved.npz")
    (tmp_path / "runs" / "run" / "policies" / "seed0.npz").write_bytes((tmp_path / "moved.npz").read_bytes())
    write_json(tmp_path / "runs" / "both" / "estimates.json", decision(policies, [value]))
    with pytest.raises(UserError, match=r"both has no estimates of run seed 0 \(.*runs/run/policies/seed0.npz\)"):
        estimates_of(one, tmp_path / "runs" / "both")


@pytest.mark.slow
def test_what_an_early_look_finds_later_looks_find_too(place):
    """So that one may look daily: drift is tested at fixed numbers of episodes alone, from the same rows."""
    log = dr.read(place / "older.csv", action="action", reward="reward")
    found: dict = {}
    for rows in (45, 90, 170, 250):
        seen = monitor(place / "run", log.select(np.arange(rows)), reference=place / "log.csv", estimates=place)
        now = {each.what.name: each.found for each in seen.columns if each.found is not None}
        assert found.items() <= now.items()
        found = now
    assert "age" in found


@pytest.mark.slow
def test_actions_of_the_policy_are_what_the_new_ones_are_compared_with(place):
    """The log's actions are a coin's; the greedy policy's are not, so a log of coins is not the policy's."""
    found = monitor(place / "run", place / "same.csv", estimates=place)
    assert {each.name for each in found.findings if each.alarm} == {"action"}
    policy = dr.load_run(place / "run")
    rows = table(250, 1)
    rows["action"] = policy.predict(rows[["age", "kind"]])
    rows.to_csv(place / "own.csv", index=False)
    assert not monitor(place / "run", place / "own.csv", estimates=place).alarm


@pytest.mark.slow
def test_a_new_level_is_outside_the_log_and_a_new_action_is_refused(place):
    rows = table(250, 4)
    rows.loc[rows.index % 2 == 0, "kind"] = "unheard of"
    rows.to_csv(place / "levels.csv", index=False)
    found = of_reference(place, "levels.csv")
    assert found.outside.share >= 0.5
    assert any(each.about == "outside" and each.alarm and "level" in each.text for each in found.findings)
    assert sum("'unheard of'" in each.text for each in found.findings) == 2  # outside, and beside the shares of the levels
    gaps = table(250, 5)
    gaps.loc[gaps.index % 3 == 0, "age"] = np.nan
    gaps.to_csv(place / "gaps.csv", index=False)
    found = of_reference(place, "gaps.csv")
    assert ("age", "a missing value", 84, True) in found.outside.columns
    assert found.columns[0].missing == (0.0, 84 / 250)
    assert any("missing in 0.0% of rows before, 33.6% now" in each.text for each in found.findings)
    assert found.outside.share == pytest.approx(84 / 250, abs=0.02)
    assert abs(found.columns[0].now - found.columns[0].before) < 2  # filled with the mean that was there
    rows["action"] = "shout"
    rows.to_csv(place / "actions.csv", index=False)
    with pytest.raises(UserError, match="none of its levels: 'shout'"):
        of_reference(place, "actions.csv")


def test_exit_codes_and_the_page(place, capsys):
    ask = ["monitor", str(place / "run"), "--reference", str(place / "first.csv"), "--estimates", str(place)]
    assert main([*ask[:2], str(place / "same.csv"), *ask[2:], "--html", str(place / "page.html")]) == 0
    page = (place / "page.html").read_text()
    assert all(text in page for text in ("No alarm.", "Realised value", "lower end of the estimate", "age"))
    assert main([*ask[:2], str(place / "worse.csv"), *ask[2:]]) == 1
    assert "! value realised" in capsys.readouterr().out
    assert main([*ask[:2], str(place / "nothing.csv"), *ask[2:]]) == 2
    assert "no file" in capsys.readouterr().err


def test_where_episodes_have_several_steps_a_new_policy_is_compared_at_their_first_ones(tmp_path):
    def log(n, seed, later):
        rng = np.random.default_rng(seed)
        x = rng.normal(size=(n, 5, 2))
        x[:, 1:] += later
        ends = np.zeros((n, 5), bool)
        ends[:, -1] = True
        return dr.Dataset.from_arrays(
            observations=x.reshape(-1, 2), actions=np.zeros((5 * n, 1)), rewards=rng.normal(size=5 * n), terminals=ends.ravel(),
            action_space=dr.data.spec.Box((-1.0,), (1.0,)),
        )  # fmt: skip

    old, moved = log(60, 0, 0.0), log(60, 1, 3.0)
    inner = Deterministic(MLP((jnp.zeros((2, 1)),), (jnp.zeros(1),)))  # does what the logs' actions are
    store.save(run := tmp_path / "p.npz", EnvPolicy(inner, None, None, jnp.array([-1.0]), jnp.array([1.0])))
    names = lambda found: {each.name for each in found.findings if each.alarm and each.about == "observation"}  # noqa: E731
    assert names(monitor(run, moved, reference=old, made_by="policy")) == set()
    assert names(monitor(run, moved, reference=old)) == {"observation 0", "observation 1"}


def test_an_episode_that_may_go_on_is_left_out_and_returns_are_those_of_the_estimand():
    log = dr.Dataset.from_arrays(
        observations=np.zeros((7, 1)), actions=np.zeros((7, 1)), rewards=np.array([1.0, 1, 1, 2, 2, 2, 5]),
        terminals=np.array([0, 0, 1, 0, 0, 1, 0], bool),
    )  # fmt: skip
    done = finished(log, log)
    assert done.episodes == 2
    np.testing.assert_allclose(returns_of(done, Estimand(0.5, None)), [1.75, 3.5])
    np.testing.assert_allclose(returns_of(done, Estimand(0.5, 2)), [1.5, 3.0])
    with pytest.raises(UserError, match="may not be finished"):
        finished(log.select([2]), log)


def test_episodes_that_go_on_side_by_side_are_named():
    """A horizon would not help where the reference has ends that the new log lacks yet."""

    def log(ended, steps=10):
        ends = np.tile(np.arange(steps) == steps - 1, len(ended))
        return dr.Dataset.from_arrays(
            observations=np.zeros((len(ends), 1)), actions=np.zeros((len(ends), 1)), rewards=np.ones(len(ends)), name="beds",
            terminals=ends & np.repeat(ended, steps), timeouts=ends & ~np.repeat(ended, steps),
        )  # fmt: skip

    told = decision([{"name": "run seed 0"}], [{"value": [5, 5], "low": [4, 4], "high": [6, 6]}],
                    estimand={"discount": 0.9, "horizon": None})  # fmt: skip
    whole, some = log([True] * 12), log([True] * 8 + [False] * 3, 4)
    said = realised(some, whole, (told, 0), None, 0.05)
    assert "3 of 11 episodes of beds end without a terminal, after 4 steps or more: if these are not finished" in said
    assert "horizon" not in said
    assert "estimate with a horizon" in realised(whole, log([False] * 12), (told, 0), None, 0.05)


@pytest.mark.parametrize(("options", "words"), [
    ({"alpha": 0.0}, "alpha must be between 0 and 1"), ({"made_by": "somebody"}, "made_by is policy or reference"),
    ({"return_range": (1.0, 1.0)}, "least and greatest return"),
])  # fmt: skip
def test_what_it_needs_is_said(place, options, words):
    with pytest.raises(UserError, match=words):
        of_reference(place, "same.csv", **options)


def test_a_log_that_is_gone_or_has_changed_is_not_compared_with(place, tmp_path):
    config = json.loads((place / "run" / "run.json").read_text())
    assert config["data"]["provenance"]["path"].endswith("log.csv")
    table(300, 9).to_csv(tmp_path / "log.csv", index=False)
    run = dr.train(BC, tmp_path / "log.csv", steps=1, task=False, out=tmp_path / "run")
    table(300, 8).to_csv(tmp_path / "log.csv", index=False)
    with pytest.raises(UserError, match="has changed .* name a copy of it with --reference"):
        monitor(run, place / "same.csv")
    log = dr.Dataset.from_frame(table(60, 1), action="action", reward="reward")
    unnamed = dr.train(BC, log, steps=1, task=False, out=tmp_path / "unnamed")
    with pytest.raises(UserError, match="cannot be read again, so name it with --reference"):
        monitor(unnamed, place / "same.csv")
    assert monitor(unnamed, place / "same.csv", reference=log).compared.startswith("compared: all rows; actions with the pol")
    (tmp_path / "log.csv").unlink()
    with pytest.raises(UserError, match="is not at .* any more; name it with --reference"):
        monitor(run, place / "same.csv")


@pytest.mark.parametrize("kind", ["secret", "long", "control", "unknown"])
def test_a_run_from_elsewhere_cannot_have_any_file_quoted(place, tmp_path, kind):
    config = json.loads((place / "run" / "run.json").read_text())
    lines = (place / "log.csv").read_text().splitlines()
    cells = ",".join("swordfish" for _ in lines[0].split(","))
    (tmp_path / "secret.csv").write_text("\n".join([*lines[:9], cells]) + "\n")
    path = {"long": "x" * 5_000, "control": "a\n\x1b[31m\0"}.get(kind, str(tmp_path / "secret.csv"))
    config["data"]["provenance"]["path"] = path
    if kind == "unknown":
        del config["data"]["fingerprint"]
    shutil.copytree(place / "run", tmp_path / "run")
    (tmp_path / "run" / "run.json").write_text(json.dumps(config))
    again = "cannot be read again.*name it with --reference"
    words = {"secret": again, "unknown": "data lacks fingerprint"}.get(kind, "is not at .* any more; name it with --reference")
    with pytest.raises(UserError, match=words) as caught:
        monitor(tmp_path / "run", place / "same.csv")
    assert caught.value.__suppress_context__ or caught.value.__context__ is None  # nor in what a traceback shows
    assert not any(word in str(caught.value) for word in ("swordfish", "\n", "\x1b"))


def test_the_log_that_the_policy_learned_from_was_not_made_by_it(place, tmp_path):
    """Wherever it lies: what is named because it is not where it was is no log of the policy in use."""
    moved = shutil.copy(place / "log.csv", tmp_path / "moved.csv")
    said = [monitor(place / "run", place / "same.csv", reference=each, estimates=place).compared for each in (None, moved)]
    assert said[0] == said[1]
    assert said[0] == f"compared: all rows; {FRESH}"
    assert of_reference(place, "same.csv").compared == "compared: all rows and logged actions"
    by_another = of_reference(place, "worse.csv", made_by="reference")
    assert by_another.value == "not compared: the new log was not made by the policy of the run"
    assert not by_another.alarm


def test_episodes_of_one_user_are_no_independent_ones():
    """A hundred episodes of two poor patients say little of all patients."""
    columns = {"x": np.zeros(100), "patient": np.repeat([0, 1], 50), "action": np.arange(100) % 2, "reward": np.zeros(100)}
    log = dr.Dataset.from_frame(columns, action="action", reward="reward", group="patient")
    told = decision([{"name": "a"}], [{"value": [0.5, 0.4], "low": [0.4, 0.3], "high": [0.6, 0.5]}])
    found = realised(log, log, (told, 0), (0.0, 1.0), 0.025)
    assert found == (
        "not compared: the 100 episodes come from 2 values of patient, and the interval needs independent ones; give one "
        "episode of each"
    )


def test_the_estimate_of_one_of_many_is_taken_as_that_of_the_chosen():
    """Its interval holds for all of them at once."""
    log = dr.Dataset.from_arrays(
        observations=np.zeros((20, 1)), actions=np.zeros((20, 1)), rewards=np.tile([0.0, 1.0], 10), terminals=np.ones(20, bool)
    )
    result = {"value": [0.5] * 7, "low": [0.4] * 7, "high": [0.6] * 7}
    told = decision([{"name": name} for name in "abcdef"], [result])
    found = realised(log, log, (told, 0), (0.0, 1.0), 0.025)
    assert found.among == 6
    # The quantiles of a normal distribution at 1 - 0.05 / 12 and at 0.975.
    assert found.estimated.low == pytest.approx(0.5 - 0.1 * 2.638257 / 1.959964, abs=1e-6)
    assert found.estimated.high == pytest.approx(0.5 + 0.1 * 2.638257 / 1.959964, abs=1e-6)
    # Of an estimate from 20 episodes, Student's with 19 degrees of freedom.
    few = realised(log, log, ({**told, "judged": {"units": 20}}, 0), (0.0, 1.0), 0.025)
    assert few.estimated.low == pytest.approx(0.5 - 0.1 * 2.943895 / 2.093024, abs=1e-6)


def test_a_return_at_the_end_of_its_range_is_within_it():
    """Ten rewards of 0.1 sum to 1.000000015 in single precision."""
    log = dr.Dataset.from_arrays(
        observations=np.zeros((50, 1)), actions=np.zeros((50, 1)), rewards=np.full(50, 0.1), terminals=np.arange(50) % 10 == 9
    )
    assert returns_of(log, Estimand(1.0)).max() > 1.0
    found = realised(log, log, None, (0.0, 1.0), 0.025)
    assert (found.beyond, found.interval.high) == (0, 1.0)
    assert realised(log, log, None, (0.0, 0.999), 0.025).beyond == 5


def test_an_estimate_above_the_range_of_the_reference_is_refuted():
    """As of a model that is far too sure: returns of 0 to 10, of which an estimate says 40 for certain."""
    rng = np.random.default_rng(0)
    log, new = (
        dr.Dataset.from_arrays(
            observations=np.zeros((200, 1)), actions=np.zeros((200, 1)), rewards=rng.uniform(0, 10, 200), terminals=np.ones(200)
        )
        for _ in range(2)
    )
    told = decision([{"name": "a"}], [{"value": [40.0, 5.0], "low": [38.0, 4.0], "high": [42.0, 6.0]}])
    found = realised(new, log, (told, 0), None, 0.025)
    assert 1 < found.below_at < 20
    assert found.range[1] > 38.0
    assert found.source.endswith("and up to the estimate")
    given = realised(new, log, (told, 0), (0.0, 10.0), 0.025)
    assert given.below_at == 1


def test_copies_of_episodes_are_no_independent_ones():
    rng = np.random.default_rng(0)
    columns = {"x": np.repeat(rng.normal(size=50), 2), "action": np.repeat(np.arange(50) % 2, 2), "reward": np.zeros(100)}
    log = dr.Dataset.from_frame(columns, action="action", reward="reward")
    told = decision([{"name": "a"}], [{"value": [0.5, 0.4], "low": [0.4, 0.3], "high": [0.6, 0.5]}])
    assert realised(log, log, (told, 0), (0.0, 1.0), 0.025).startswith(
        "not compared: the 100 episodes are copies of 50 different ones, and the interval needs independent ones"
    )


def series(seed, rows, shift=0.0, shuffled=False):
    """Temperatures that follow those of the row before, and actions that follow them."""
    rng = np.random.default_rng(seed)
    noise, heat = rng.normal(size=rows), np.zeros(rows)
    for i in range(1, rows):
        heat[i] = 0.9 * heat[i - 1] + noise[i]
    columns = {"heat": heat + shift, "noise": rng.normal(size=rows)}
    columns["action"] = (columns["heat"] + rng.normal(size=rows) > shift).astype(int)
    columns["reward"] = rng.normal(size=rows)
    order = rng.permutation(rows) if shuffled else np.arange(rows)
    return dr.Dataset.from_frame({name: each[order] for name, each in columns.items()}, action="action", reward="reward")


def test_rows_of_a_slowly_changing_system_are_compared_in_parts(tmp_path):
    """Temperatures of neighbouring rows are alike, and so are actions: those of any 320 rows differ from those of others."""
    old = series(0, 1_000)
    run = dr.train(BC, old, steps=2, task=False, out=tmp_path / "run")
    for seed in range(1, 6):
        found = monitor(run, series(seed, 640), reference=old, made_by="reference")
        assert not found.alarm
    depend = "in parts of 50 episodes, as values depend on those of the episodes before"
    assert f"observation heat: no drift {depend}; mean" in str(found)
    assert {each.what.name: each.length for each in found.columns} == {"heat": 50, "noise": None, "action": 50}
    changed = monitor(run, series(1, 640, shift=6.0), reference=old, made_by="reference")
    assert {each.name for each in changed.findings if each.alarm and each.about == "observation"} == {"heat"}
    few = monitor(run, series(1, 160), reference=old, made_by="reference")
    assert "so parts of 50 episodes are compared, and the first test is made after 320 episodes" in str(few)
    assert lead(few).startswith("No alarm. Not tested: heat, action.")


def test_what_is_found_in_few_rows_of_a_slowly_changing_system_stays_found(tmp_path):
    """Also where the reference is too short to tell that it depends on its past."""
    old = series(5, 90)
    run = dr.train(BC, old, steps=2, task=False, out=tmp_path / "run")
    alarms = 0
    for seed in range(12):
        log = series(seed, 200)
        looks = (monitor(run, log.select(np.arange(rows)), reference=old, made_by="reference") for rows in (99, 200))
        early, late = ({each.name for each in look.findings if each.alarm} for look in looks)
        alarms += bool(early)
        assert early <= late
    assert alarms


def test_copies_of_rows_are_in_the_part_of_the_first():
    """A log that was stored twice, and whose rows follow each other, has as many parts as it would have once."""
    once = series(0, 500)
    twice = once.select(np.concatenate([np.arange(500)] * 2))
    rows = compared.sample(twice, np.arange(twice.episodes), False).in_parts(25)
    assert len(rows.starts) == 20
    assert rows.sizes.tolist() == [50] * 20
    np.testing.assert_allclose(np.sort(rows.observations[:50, 0]), np.sort(np.repeat(once.observations[:25, 0], 2)), atol=1e-6)


def test_the_value_of_a_slowly_changing_system_is_that_of_its_parts():
    """Returns that follow each other are not as many samples: one by one, a fifth of such logs or more had a false alarm."""

    def log(seed, rows, less=0.0):
        heat = series(seed, rows).observations[:, 0] / np.sqrt(1 / (1 - 0.81))
        return dr.Dataset.from_arrays(
            observations=heat[:, None], actions=np.arange(rows) % 2, rewards=heat - less, terminals=np.ones(rows, bool)
        )

    told = decision([{"name": "a"}], [{"value": [0.5, 0.4], "low": [0.0, 0.3], "high": [0.6, 0.5]}])
    told["estimand"] |= {"discount": 1.0, "horizon": None}
    old = log(0, 1_000)
    alone = [refuted_at(log(seed, 640).rewards, (-6.0, 6.0), 0.0, 0.025) is not None for seed in range(1, 21)]
    found = [realised(log(seed, 640), old, (told, 0), (-6.0, 6.0), 0.025) for seed in range(1, 21)]
    assert sum(alone) >= 4
    assert [each.below_at for each in found] == [None] * 20
    assert found[0].length == 50
    assert found[0].sequence.counts[-1] == 600
    assert realised(log(1, 2_000, 2.0), old, (told, 0), (-6.0, 6.0), 0.025).below_at % 50 == 0
    few = realised(log(1, 40), old, (told, 0), (-6.0, 6.0), 0.025)
    assert few.endswith("so means of 50 episodes are compared, of which the new log has none")


def test_a_log_whose_rows_were_mixed_says_nothing_of_their_order(tmp_path):
    """Then rows of the new log follow each other, and those of the reference do not."""
    old = series(112, 1_000, shuffled=True)
    run = dr.train(BC, old, steps=2, task=False, out=tmp_path / "run")
    found = monitor(run, series(12, 640), reference=old, made_by="reference")
    assert "observation heat: not tested: in the new log, and not in the reference, values follow those" in str(found)
    assert not [each for each in found.findings if each.alarm and each.name == "heat"]


@pytest.mark.parametrize("late", [lambda x: x + 3, lambda x: 0.1 * x])
def test_a_change_within_the_new_log_is_found_and_stays_found(late, place, tmp_path):
    """Two levels look like rows that follow each other; such a column was not tested, and an earlier alarm was lost."""
    new = table(400, 1)
    new.loc[160:, "age"] = 50 + 10 * late((new["age"][160:] - 50) / 10)
    told = [monitor(place / "run", new[:rows], reference=place / "log.csv", made_by="reference") for rows in (320, 400)]
    for each in told:
        assert {one.what.name for one in each.columns if one.found} == {"age"}


def test_where_nothing_can_be_tested_that_is_said():
    """500 episodes of three sites are no 20 independent ones."""

    def log(sites, seed):
        rng, rows = np.random.default_rng(seed), 500
        columns = {"x": rng.normal(size=rows), "site": np.arange(rows) % sites, "action": np.arange(rows) % 2}
        return dr.Dataset.from_frame(columns | {"reward": np.zeros(rows)}, action="action", reward="reward", group="site")

    old, new = log(50, 0), log(3, 1)
    columns, tests = compared.drifts(compared.sample(old, np.arange(500), False), new, compared.whats(old), False, 0.05)
    assert (len(columns), tests) == (2, 0)
    assert _untested(50, new) == "not tested: the new log has 3 episodes or clusters, 5 are needed"
    assert compared.drifts(compared.sample(old, np.arange(500), False), log(40, 1), compared.whats(old), False, 0.05)[1] > 0
    value = "not compared: the 500 episodes come from 3 values of site"
    outside = compared.Outside(0.0, ())
    found = Monitored("a", "old", "new", 500, 500, "compared: all rows", _untested(50, new), 0.05, (), outside, value, ())
    assert lead(found) == (
        "No alarm. Drift was not tested: the new log has 3 episodes or clusters, 5 are needed. The value was not compared: the "
        "500 episodes come from 3 values of site."
    )


def test_what_a_policy_has_memorised_is_no_drift(tmp_path):
    """Actions of noise that a clone has learned by heart are those of the rows that taught it, and smaller in others."""
    rng = np.random.default_rng(0)

    def log(rows):
        return dr.Dataset.from_arrays(
            observations=rng.normal(size=(rows, 8)), actions=rng.choice([-0.9, 0.9], (rows, 1)),
            rewards=np.zeros(rows), terminals=np.ones(rows, bool), action_space=Box((-1.0,), (1.0,)),
        )  # fmt: skip

    old, new = log(160), log(640)
    agent = dr.agents.BC(hidden=(128, 128), lr=1e-2, batch_size=64)
    run = dr.train(agent, old, steps=300, task=False, out=tmp_path / "run")
    new = dataclasses.replace(new, actions=run.policies[0](new.observations))
    found = monitor(tmp_path / "run", new, reference=old)
    assert not found.alarm
    monkey = dataclasses.replace(subject(tmp_path / "run"), taught=np.zeros(0, np.uint64))
    taught = old.select(np.flatnonzero(np.isin(old.episode_ids, run.taught)))
    seen, _ = _acts(monkey, taught, False, lambda seen: compared.acted(taught, _done(monkey, seen, taught, True)))
    which = [what for what in compared.whats(old) if what.about == "action"]
    [learned], _ = compared.drifts(seen, new, which, False, 0.02)
    assert learned.found is not None


def test_the_log_that_a_policys_file_knows_is_recognised_without_its_run(place, tmp_path):
    shutil.copy(place / "run" / "policies" / "seed0.npz", tmp_path / "alone.npz")
    alone, new = tmp_path / "alone.npz", place / "same.csv"
    said = [monitor(alone, new, reference=place / each).compared for each in ("log.csv", "first.csv")]
    assert said[0] == f"compared: all rows; {FRESH}"
    assert said[1] == "compared: all rows and logged actions"


def test_a_value_is_compared_with_that_of_the_actions_in_use(place, tmp_path):
    found = monitor(place / "run", place / "same.csv", estimates=place, greedy=False)
    assert found.value == "not compared: the policy's sampled actions are in use, and its greedy ones were estimated"
    assert not isinstance(monitor(place / "run", place / "same.csv", estimates=place, greedy=True).value, str)
    for option, given in (("--greedy", {"greedy": True}), ("--return-range", {"return_range": (0.0, 1.0)})):
        with pytest.raises(UserError, match=f"{option} is about the policy's actions or value, and --made-by reference"):
            of_reference(place, "same.csv", made_by="reference", **given)


def test_estimates_of_a_policy_that_was_trained_further_are_not_taken(place, tmp_path):
    run = shutil.copytree(place / "run", tmp_path / "run")
    file = run / "policies" / "seed0.npz"
    results = [{"value": [0.5, 0.4], "low": [0.4, 0.3], "high": [0.6, 0.5]}]
    (tmp_path / "judged").mkdir()
    told = decision([{"name": "run seed 0", **saved_at(file, tmp_path / "judged")}], results)
    write_json(tmp_path / "judged" / "estimates.json", told)
    assert estimates_of(subject(run), tmp_path / "judged") is not None
    moved = shutil.copytree(tmp_path, tmp_path.parent / f"{tmp_path.name}-moved")
    shutil.rmtree(run)
    assert estimates_of(subject(moved / "run"), moved / "judged") is not None
    store.save(moved / "run" / "policies" / "seed0.npz", load(moved / "run").policies[0], {"more": 1})
    with pytest.raises(UserError, match="has no estimates of run seed 0 .* as it is now"):
        estimates_of(subject(moved / "run"), moved / "judged")
