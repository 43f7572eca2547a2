"""Runs that learned in the simulator: no log, nothing to deploy against, environment steps instead of updates."""

import json
import re
import shlex

import pytest
from run_folders import compared, write_run

from deadreckon.cli.options import TrainOnline
from deadreckon.cli.parse import parse
from deadreckon.errors import UserError
from deadreckon.files import read_json, write_json
from deadreckon.online import Online
from deadreckon.report import headline, picture, table
from deadreckon.report.entries import read
from deadreckon.report.page import render
from deadreckon.report.provenance import command

TURNS = {"copies": 4, "explore": 40, "updates_per_step": 0.5, "block": 20}  # 10 updates after every 20 steps


def online(path, fields=None, **options):
    """A run; with `fields`, in a task whose name does not tell these."""
    run = write_run(path, "sac", 90.0, task="halfcheetah", online=TURNS, promised=70.0, **options)
    if fields is not None:
        write_json(run / "run.json", read_json(run / "run.json") | {"task_fields": fields})
    return run


def shown(text):
    """What a reader sees."""
    return re.sub(r"<[^>]*>", " ", re.sub(r"<(style|script)>.*?</\1>", "", text, flags=re.S))


def test_a_page_of_online_runs_speaks_of_no_log(tmp_path):
    page = read([online(tmp_path / "run", metrics={"critic_loss": 5.0})])
    text = render(page)
    assert re.findall(r'<section id="(\w+)"', text) == ["simulator", "scores", "learning", "values", "training", "provenance"]
    seen = shown(text)
    assert "Policies trained online in halfcheetah" in seen
    assert "In the simulator: SAC online, score" in seen
    for nonsense in ("MMD", "0 rows", "fingerprint", "Offline", "imitation", "trained on a log", "cloning", "None", "nan"):
        assert not re.search(rf"\b{nonsense}\b", seen)
    assert "440 environment steps per seed, the first 40 with uniform actions" in seen
    assert "environment_steps against" not in text  # it is no metric


def test_curves_are_drawn_against_environment_steps(tmp_path):
    entry = read([online(tmp_path / "run")]).entries[0]
    assert entry.curve("score", environment=True)[0].tolist() == [240, 440]
    assert entry.curve("loss", environment=True)[0].tolist() == [140, 240, 340, 440]
    assert entry.environment_steps(0) == 0
    text = render(read([tmp_path / "run"]))
    assert 'data-across="environment steps"' in text
    assert 'data-across="updates"' not in text
    assert 'data-across="environment steps"' in picture(tmp_path / "c.svg", {"all": [tmp_path / "run"]}).read_text()


def test_nothing_is_said_to_be_better_than_a_log_that_is_not_there(tmp_path):
    found = compared(read([online(tmp_path / "run")]))
    assert (found.compared, found.versus_log, found.beaten, found.best.label) == (0, None, [], "SAC online")
    assert "evaluated in its training simulator" in found.caveats[0]
    assert "not finished" in compared(read([online(tmp_path / "now", finished=False)])).caveats[0]
    assert "1 of 2 seeds" in compared(read([online(tmp_path / "seed", failures={0: ("q", 100)})])).caveats[0]
    for part in (tmp_path / "now" / "evaluations").iterdir():
        part.unlink()
    assert compared(read([tmp_path / "now"])) is None
    assert headline([tmp_path / "now"]) == "No evaluation is finished yet."


def test_beside_runs_on_a_log_it_is_shown_and_not_chosen(tmp_path):
    levels = {"bc": 20.0, "sac": 40.0}
    runs = [write_run(tmp_path / agent, agent, levels[agent], task="halfcheetah", seeds=4) for agent in levels]
    runs.append(online(tmp_path / "run"))
    page = read(runs)
    assert [e.label for e in page.entries] == ["BC", "SAC", "SAC online"]
    found = compared(page)
    assert found.best.label == "SAC"
    assert "shown for comparison only: SAC online." in " ".join(found.caveats)
    assert "SAC online" not in " ".join(found.beaten)
    assert headline(runs).startswith("Best in the simulator: SAC,")
    text = render(page)
    assert 'data-across="updates"' in text
    assert 'data-across="environment steps"' not in text
    assert "trained in the simulator" in text


def test_the_table_has_the_columns_that_mean_something(tmp_path, runs):
    one = online(tmp_path / "run")
    both = [one, write_run(tmp_path / "cloned", "bc", task="halfcheetah")]
    heads = [table(given).splitlines()[0].split() for given in ([one], both, runs)]
    assert [("MMD" in head, "outside" in head, "steps" in head) for head in heads] == [
        (False, False, True), (True, True, True), (True, True, False),
    ]  # fmt: skip
    assert "440" in table([one])


@pytest.mark.parametrize("every", [100, None])
def test_the_command_makes_the_run_again(tmp_path, every):
    entry = read([online(tmp_path / "run")]).entries[0]
    if every is None:  # what is recorded where nothing was asked for: a fiftieth, in whole blocks
        entry.config["evaluation"]["every"] = 10
    text = command(entry)
    assert text.startswith("deadreckon train --agent sac --online --task halfcheetah --steps 440 --seeds 2")
    assert ("--evaluate-every" in text) == (every is not None)
    words = [word for word in shlex.split(text)[4:] if word != "--online"]
    given = parse(TrainOnline, words[: words.index("--agent.hidden")], "train --online")
    assert (given.task, given.seeds, given.settings.episodes) == ("halfcheetah", 2, 6)
    turns = Online(given.copies, given.explore, given.updates_per_step, given.block)
    assert (turns, turns.updates(given.steps)) == (Online(**TURNS), 200)
    assert given.settings.evaluate_every == (None if every is None else 200)


def test_no_command_makes_a_run_in_a_task_that_its_name_does_not_find(tmp_path):
    page = read([online(tmp_path / "run", {"horizon": 20})])
    assert command(page.entries[0]).startswith("# no command: it was trained in a task that its name does not find")
    assert page.task is None
    assert "--task halfcheetah" not in render(page)


def test_a_run_on_a_log_and_one_online_in_a_registered_task_are_of_one_task(tmp_path):
    """Online runs alone note the fields of a task that a user has registered."""
    one = online(tmp_path / "run")
    config = json.loads((one / "run.json").read_text())
    (one / "run.json").write_text(json.dumps(config | {"task_registered": {"horizon": 20}}))
    assert len(read([one, write_run(tmp_path / "cloned", "bc", task="halfcheetah")]).entries) == 2


def test_runs_in_tasks_of_one_name_with_different_fields_are_not_shown_as_one_task(tmp_path):
    runs = [online(tmp_path / str(i), fields) for i, fields in enumerate((None, {"horizon": 20}, {"horizon": 30}))]
    told = (
        "1 is halfcheetah with other fields, .*0 is halfcheetah;",
        "2 is halfcheetah with .*1 is halfcheetah with other fields;",
    )
    for pair, words in zip((runs[:2], runs[1:]), told):
        with pytest.raises(UserError, match=f"a report shows runs of one task: .*{words}"):
            read(pair)
    online(tmp_path / "more", {"horizon": 20}, first=2)
    assert len(read([runs[1], tmp_path / "more"]).entries) == 1
