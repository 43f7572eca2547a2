"""Published settings by log: data that fits the agents, and finding them."""

from typing import Any

import pytest

import deadreckon as dr
from deadreckon.agents import agent_class, preset, preset_for, presets
from deadreckon.cli.main import main
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.spec import Box, Spec
from deadreckon.errors import UserError
from deadreckon.runs.lanes import agents_of
from tests.agents.worlds import corridor


@pytest.mark.parametrize("agent", presets())
def test_presets_are_settings_that_their_agents_take(agent):
    kind, spec = agent_class(agent), corridor().spec
    if not kind.offline:
        spec = Spec.empty((11,), Box((-1.0,) * 3, (1.0,) * 3), "hopper")
    for name, own in presets()[agent].items():
        fields = preset(agent, name)
        assert own.items() <= {field: list(v) if isinstance(v, tuple) else v for field, v in fields.items()}.items()
        if agent == "mobile":  # the corridor has no rewards above its floor
            fields["min_target"] = None
        made = kind(**fields).resolve(spec, 10)
        for what in ("normalized_return_range", "standardise_rewards"):  # which become a scale and a shift
            fields.pop(what, None)
        assert all(getattr(made, field) == value for field, value in fields.items())


def test_a_log_finds_its_own_preset_before_its_tasks():
    assert preset_for("rebrac", "hopper-medium-v2@dr1-200000-steps") == "hopper-medium"
    assert preset_for("rebrac", "hopper-medium-replay-v2") == "hopper-medium-replay"
    assert preset_for("rebrac", "maze2d-umaze-v1@dr1") == "maze2d"
    assert preset_for("sac-n", "halfcheetah-expert-v2") == "halfcheetah"
    assert preset_for("rebrac", "own.csv") is None
    assert preset_for("bc", "hopper-medium-v2") is None


def test_a_logs_preset_has_what_its_domain_has_and_its_own_wins():
    assert preset("rebrac", "antmaze-umaze")["reward_scale"] == preset("rebrac", "antmaze")["reward_scale"] == 100.0
    assert preset("xql", "antmaze-large-play")["loss_temperature"] == 0.6
    assert preset("xql", "antmaze-umaze") | {"loss_temperature": 0.6} == preset("xql", "antmaze") | {
        "max_clip": 7.0, "batch_size": 256,
    }  # fmt: skip
    assert preset("cql", "antmaze")["critic_hidden"] == (256,) * 5


def test_what_is_no_preset_says_so():
    assert preset("SAC-N", "walker2d") == {"critics": 20}
    with pytest.raises(UserError, match="unknown preset of rebrac 'hopper-medum': did you mean hopper-medium"):
        preset("rebrac", "hopper-medum")
    with pytest.raises(UserError, match="bc has no presets; leave 'hopper' out"):
        preset("bc", "hopper")


@pytest.mark.slow
def test_the_command_line_begins_from_a_preset_and_fields_win(capsys, tmp_path):
    with pytest.raises(SystemExit):
        main(["train", "--agent", "rebrac", "--preset", "maze2d", "--help"])
    out = capsys.readouterr().out
    assert "(default: 0.003)" in out
    log = str(tmp_path / "log.hdf5")
    write_hdf5(corridor(400), log)
    words = ["train", "--agent", "rebrac", "--preset", "maze2d", "--data", log, "--steps", "2", "--out", str(tmp_path / "run")]
    assert main([*words, "--agent.actor-penalty", "0.5", "--agent.hidden", "8"]) == 0
    agent: Any = agents_of(dr.load_run(tmp_path / "run").config)[0]
    assert (agent.actor_penalty, agent.critic_penalty, agent.batch_size) == (0.5, 0.001, 256)
    assert main(["train", "--agent", "bc", "--preset", "maze2d", "--data", "x"]) == 2
    assert "bc has no presets" in capsys.readouterr().err
