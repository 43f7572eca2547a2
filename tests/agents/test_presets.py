"""Published settings by log: data that fits the agents, and finding them."""

import pytest

from deadreckon.agents import agent_class, preset, preset_for, presets
from deadreckon.cli.main import main
from deadreckon.errors import UserError
from tests.agents.worlds import corridor


@pytest.mark.parametrize("agent", presets())
def test_presets_are_settings_that_their_agents_take(agent):
    kind, spec = agent_class(agent), corridor().spec
    for fields in presets()[agent].values():
        made = kind(**fields).resolve(spec, 10)
        assert all(getattr(made, field) == value for field, value in fields.items())


def test_a_log_finds_its_own_preset_before_its_tasks():
    assert preset_for("rebrac", "hopper-medium-v2@dr1-200000-steps") == "hopper-medium"
    assert preset_for("rebrac", "hopper-medium-replay-v2") == "hopper-medium-replay"
    assert preset_for("rebrac", "maze2d-umaze-v1@dr1") == "maze2d"
    assert preset_for("sac-n", "halfcheetah-expert-v2") == "halfcheetah"
    assert preset_for("rebrac", "own.csv") is None
    assert preset_for("bc", "hopper-medium-v2") is None


def test_what_is_no_preset_says_so():
    assert preset("SAC-N", "walker2d") == {"critics": 20}
    with pytest.raises(UserError, match="unknown preset of rebrac 'hopper-medum': did you mean hopper-medium"):
        preset("rebrac", "hopper-medum")
    with pytest.raises(UserError, match="bc has no presets; leave 'hopper' out"):
        preset("bc", "hopper")


def test_the_command_line_begins_from_a_preset_and_fields_win(capsys):
    with pytest.raises(SystemExit):
        main(["train", "--agent", "rebrac", "--preset", "maze2d", "--help"])
    out = capsys.readouterr().out.replace("\n", " ")
    assert "0.003" in out
    assert main(["train", "--agent", "bc", "--preset", "maze2d", "--data", "x"]) == 2
    assert "bc has no presets" in capsys.readouterr().err
