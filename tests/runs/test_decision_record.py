"""`estimates.json`: which policy it means wherever it lies, and numbers that JSON does not have."""

import json
import math
import os
import shutil
from pathlib import Path

import pytest

from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.runs.decision_record import file_of, read_results, saved_at, write_results
from deadreckon.runs.player import _own_decision, chosen
from deadreckon.versions import differences
from tests.recorded import decision


@pytest.fixture
def may(tmp_path, monkeypatch):
    """A decision of May, whose policy lies in its folder; all paths are from the working directory."""
    monkeypatch.chdir(tmp_path)
    made("recommend", b"PK may")
    return tmp_path


def made(folder, content):
    file = Path(folder, "iql", "policies", "seed0.npz")
    file.parent.mkdir(parents=True)
    file.write_bytes(content)
    write_json(Path(folder, "estimates.json"), decision([{"name": "iql", **saved_at(file, folder)}]))


def test_a_decision_that_was_moved_means_its_own_policy(may):
    """Another decision lies where it was made, with a policy of the same name."""
    (may / "recommend").rename(may / "may")
    made("recommend", b"PK june")
    assert chosen(may / "may").file.read_bytes() == b"PK may"
    assert chosen(may / "recommend").file.read_bytes() == b"PK june"
    shutil.rmtree(may / "may" / "iql")
    with pytest.raises(UserError, match="may: recommend/iql/policies/seed0.npz is not the policy that was evaluated as iql"):
        chosen(may / "may")
    shutil.rmtree(may / "recommend")
    with pytest.raises(UserError, match="the policy to deploy, iql, is not at recommend/iql/policies/seed0.npz; name its run"):
        chosen(may / "may")


def test_a_policy_that_was_trained_further_is_not_the_one_that_was_judged(may):
    (may / "recommend" / "iql" / "policies" / "seed0.npz").write_bytes(b"PK more updates")
    with pytest.raises(UserError, match="is not the policy that was evaluated as iql: it was trained further, or exchanged"):
        chosen(may / "recommend")


def test_records_of_before_know_a_policy_by_its_path(may):
    policy = {"name": "iql", "file": "recommend/iql/policies/seed0.npz"}
    assert file_of(policy, may / "elsewhere") is not None
    assert file_of({"name": "iql", "file": None}, may) is None


@pytest.mark.parametrize(("place", "kind"), [({"file": os.devnull}, "a device"), ({"beside": "iql"}, "a folder")])
def test_a_decision_from_elsewhere_opens_nothing_but_files(may, place, kind):
    """Other devices never end, and pipes wait for whoever writes."""
    write_json(may / "recommend" / "estimates.json", decision([{"name": "iql", "digest": "00", **place}]))
    with pytest.raises(UserError, match=f"is {kind}, and a file is needed"):
        chosen(may / "recommend")


def test_numbers_that_json_does_not_have(tmp_path):
    gains = [[math.nan, -math.inf, math.inf]]
    result = {"value": [math.nan, 1.0], "low": [-math.inf, 0.5], "high": [math.inf, 2.0], "gain": gains}
    told = decision([{"name": "a"}], [result], choice={"gain": gains[0]})
    write_results(tmp_path / "e.json", told)
    strict = json.loads((tmp_path / "e.json").read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert strict["results"][0]["low"] == ["-Infinity", 0.5]
    assert strict["results"][0]["value"] == [None, 1.0]
    again = read_results(tmp_path / "e.json")
    assert again["results"][0]["low"] == [-math.inf, 0.5]
    assert again["results"][0]["high"] == [math.inf, 2.0]
    assert math.isnan(again["results"][0]["value"][0])
    assert again["choice"]["gain"][1:] == again["results"][0]["gain"][0][1:] == [-math.inf, math.inf]


def test_a_runs_own_folder_stands_for_its_policy_where_a_decision_is_of_another(may):
    run = may / "run"
    (run / "policies").mkdir(parents=True)
    (run / "policies" / "seed0.npz").write_bytes(b"PK first")
    policy = {"name": "run seed 0", **saved_at(run / "policies" / "seed0.npz", run)}
    write_json(run / "estimates.json", decision([policy]))
    assert _own_decision(run)[0].decision == run
    (run / "policies" / "seed0.npz").write_bytes(b"PK more")
    found, told = _own_decision(run)
    assert found is None
    assert "evaluated another policy, from before it was trained further" in told
    write_json(run / "estimates.json", decision([policy], choice={"deploy": False}))
    assert _own_decision(run) == (None, f"; {run / 'estimates.json'} says: do not deploy")
    write_json(run / "estimates.json", {"policies": []})  # of another version
    assert _own_decision(run) == (None, "")


def test_notes_of_before_do_not_say_that_a_column_has_no_marks():
    assert differences({"x": {"kind": "number"}}, {"x": {"kind": "number", "marked": False}}) == []
    assert differences({"x": {"marked": True}}, {"x": {"marked": False}}) == ["x.marked was True, now False"]
