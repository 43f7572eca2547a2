"""What may be asked of a decision beyond a gain, from files to a card and to `estimates.json`."""

import json

import numpy as np
import pytest

from deadreckon.agents.bc import BC
from deadreckon.cli.main import main
from deadreckon.data.formats.npz import write_npz
from deadreckon.runs.train import train
from tests.ope.test_corrected import one_step


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("demands")
    rng = np.random.default_rng(0)
    arm, state = rng.integers(0, 2, 600), rng.integers(0, 2, 600)
    success = 1.0 * (rng.random(600) < 0.3 + 0.3 * arm)
    log = one_step(np.eye(2)[state], arm, success, np.full(600, 0.5), site=rng.integers(0, 3, 600))
    write_npz(log, folder / "log.npz")
    train(BC(hidden=(8,)), log, steps=20, out=folder / "bc")
    return folder


@pytest.mark.slow
def test_all_of_it_on_one_card(made, capsys):
    asked = ["--guarantee", "--return-range", "0", "1", "--confounding", "1.2", "--by-group", "site", "--tail", "0.9"]
    command = ["ope", "--data", str(made / "log.npz"), "--policies", str(made / "bc"), "--select", "--out", str(made / "ope")]
    assert main([*command, "--estimators", "dr-linear,switch", "--steps", "50", "--hidden", "8", *asked]) == 0
    out = capsys.readouterr().out
    told = json.loads((made / "ope" / "estimates.json").read_text())["choice"]
    assert not told["deploy"]
    assert told["guarantee"] < told["gain"][0]
    assert told["confounding"]["gamma"] == 1.2
    assert len(told["confounding"]["bounds"]) == 1
    assert told["groups"]["column"] == "site"
    assert [each["name"] for each in told["groups"]["values"]] == ["0", "1", "2"]
    assert told["tail"]["low"] < told["tail"]["gain"] < told["tail"]["high"]
    for words in (
        "for any number of episodes, not only for many, its gain is at least -", "no check can detect confounding",
        "if the odds of logged actions are wrong by a factor of up to 1.2, its gain is [-",
        "its worst 90 % of episodes return 0.",
        "by site (97.5 %, for all subgroups at once)",
    ):  # fmt: skip
        assert words in out, words


@pytest.mark.slow
def test_what_is_refused_is_no_look(made, capsys):
    command = ["ope", "--data", str(made / "log.npz"), "--policies", str(made / "bc")]
    assert main([*command, "--guarantee"]) == 2
    assert "deadreckon: a guarantee needs the least and the greatest possible return" in capsys.readouterr().err
    assert main([*command, "--confounding", "0.5"]) == 2
    assert "Gamma, a ratio of odds, must be 1 or more, got 0.5" in capsys.readouterr().err
    assert main([*command, "--by-group", "sight"]) == 2
    assert "unknown column 'sight'" in capsys.readouterr().err
