"""Policies judged from a log and checked in the simulator, and what a page shows of it."""

import numpy as np
import pytest

from deadreckon.agents.bc import BC
from deadreckon.collect import generate
from deadreckon.errors import UserError
from deadreckon.files import write_json
from deadreckon.ope import FQE, BehaviorModel, ImportanceSampling
from deadreckon.report import write
from deadreckon.runs.offline import checked, gather, judge, read_estimates
from deadreckon.runs.train import train

SMALL = FQE(members=2, hidden=(8,), steps=100)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("judged")
    log = generate("maze2d-umaze-v1", steps=3000, seed=0)
    train(BC(hidden=(8,)), log, steps=20, seeds=2, episodes=2, task="maze2d-umaze", out=folder / "bc")
    judged = judge(
        [folder / "bc"], log, [SMALL, ImportanceSampling(model=BehaviorModel(hidden=(8,), steps=50))],
        out=folder / "ope", task="maze2d-umaze", episodes=4, model=BehaviorModel(hidden=(8,), steps=50),
    )  # fmt: skip
    return folder, log, judged


def test_what_is_told(made):
    folder, _, (estimates, choice, told) = made
    assert told == read_estimates(folder / "ope")
    assert [each["method"] for each in told["results"]] == ["FQE-L2", "WPDIS"]
    assert [each["name"] for each in told["policies"]] == ["bc seed 0", "bc seed 1"]
    np.testing.assert_allclose(told["results"][0]["value"], estimates[0].value)
    assert len(told["results"][0]["value"]) == 3  # the log's own policy is the last
    assert len(told["truth"]["mean"]) == 2
    assert choice.name in ("bc seed 0", "bc seed 1")


def test_the_check_in_words():
    told = {
        "truth": {"task": "t", "episodes": 4, "mean": [1.0, 4.0, 3.0], "error": [0.1, 0.1, 0.2]},
        "policies": [{"name": name} for name in "abc"], "choice": {"name": "c"},
    }  # fmt: skip
    line = checked(told)
    assert line.startswith("in the simulator c has 3.00 ± 0.20 and is number 2 of 3; the best, b, has 4.00: a regret of 1.00")
    assert line.endswith("33 % of the range of all")
    assert checked(told | {"truth": None}).startswith("not checked")


def test_the_page_shows_it(made):
    folder, *_ = made
    page = write([folder / "bc"], folder / "page.html", estimates=folder / "ope").read_text()
    assert 'id="estimates"' in page
    assert "FQE-L2: estimate against truth" in page
    assert "Checked: in the simulator" in page
    plain = write([folder / "bc"], folder / "plain.html").read_text()
    assert 'id="estimates"' not in plain
    with pytest.raises(UserError, match="no estimates in"):
        write([folder / "bc"], folder / "page.html", estimates=folder)


def test_estimates_from_before_coverage_was_told(made, tmp_path):
    folder, _, (_, _, told) = made
    assert len(told["covered"]) == 2
    write_json(tmp_path / "estimates.json", {name: value for name, value in told.items() if name != "covered"})
    assert read_estimates(tmp_path)["covered"] == [None, None]
    assert "within the log" in write([folder / "bc"], tmp_path / "page.html", estimates=tmp_path).read_text()


def test_where_policies_come_from(made):
    folder, *_ = made
    policies, owners = gather([folder / "bc", folder / "bc" / "policies" / "seed0.npz", "hopper"])
    assert len(policies) == len(owners) == 2 + 1 + 11
    assert owners[0] == ("bc", 0)
    assert owners[2] == ("seed0", None)
    assert owners[-1] == ("hopper snapshot-10", None)
    with pytest.raises(UserError, match="there are no policies of 'nothing'"):
        gather(["nothing"])
    with pytest.raises(UserError, match="no policy to judge"):
        gather([])
