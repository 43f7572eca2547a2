"""What `tune` says of the episodes that it has chosen by."""

import numpy as np
import pytest

from deadreckon.bench.tuned import Trial, Tuned
from deadreckon.cli.main import main
from deadreckon.cli.tune import _told


@pytest.mark.parametrize("by", ["ope", "simulator"])
def test_episodes_that_chose_settings_are_not_to_judge_them(capsys, by):
    score, values = (np.nan, np.arange(2.0)) if by == "ope" else (50.0, np.zeros(0))
    best = Trial({"beta": 3.0}, np.full((1, 2), score), values)
    tuned = Tuned("iql", by, (best,), best, None, None)
    _told(tuned, {}, ["hopper-medium-v2"])
    told = capsys.readouterr().out
    assert ("trained and estimated on all episodes of hopper-medium-v2" in told) == (by == "ope")
    assert "default hold-out" not in told
    _told(tuned, {}, ["mine.csv"])
    told = capsys.readouterr().out
    assert "chosen: --agent.beta 3.0\n" in told
    advice = "train with the default hold-out of the same log, without --holdout, --holdout-by, --cross-fit, --horizon"
    assert (advice in told) == (by == "ope")


def test_fields_that_are_left_to_the_agent_are_no_options(capsys):
    best = Trial({"hidden": (64, 64), "beta": None}, np.full((1, 2), 50.0), np.zeros(0))
    _told(Tuned("iql", "simulator", (best,), best, None, None), {"name": "two words"}, [])
    options = "--agent.hidden 64 64 --agent.name 'two words'"
    assert f"chosen: {options}\n" in capsys.readouterr().out


def test_help_says_that_the_default_alone_is_spared(capsys):
    with pytest.raises(SystemExit):
        main(["tune", "--help"])
    told = " ".join(capsys.readouterr().out.replace("\N{BOX DRAWINGS LIGHT VERTICAL}", " ").split())
    assert "holds out by default are not used; what it holds out with --holdout, --holdout-by or --cross-fit may be" in told
