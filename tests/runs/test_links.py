"""What is written, removed, copied or published of a run's folder lies in it: links are refused."""

import pytest

import deadreckon as dr
from deadreckon.errors import UserError
from deadreckon.files import copy_folder
from deadreckon.runs import hub
from deadreckon.runs.folder import Folder
from deadreckon.runs.run import Run


@pytest.fixture
def place(tmp_path):
    """A run's folder whose metrics are a link to a folder of somebody's, which holds a file of the name of a part."""
    victim = tmp_path / "victim"
    victim.mkdir()
    (victim / "0000000030.parquet").write_text("mine")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "metrics").symlink_to(victim)
    return tmp_path / "run", victim


def test_nothing_is_written_or_removed_through_a_link(place):
    path, victim = place
    with pytest.raises(UserError, match="metrics is a link, which is not followed in a run's folder; put"):
        Folder(path).drop_after(10)
    with pytest.raises(UserError, match="metrics is a link"):
        Folder(path).write_part("metrics", 10, {"step": [10], "seed": [0]})
    with pytest.raises(UserError, match="metrics is a link"), Folder(path).alone():
        pass
    assert [each.name for each in victim.iterdir()] == ["0000000030.parquet"]


def test_what_a_link_leads_to_is_not_copied(tmp_path):
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "note.txt").symlink_to(tmp_path / "secret")
    with pytest.raises(UserError, match="note.txt is a link"):
        copy_folder(tmp_path / "run", tmp_path / "copy")
    assert not (tmp_path / "copy").exists()


def test_what_a_link_leads_to_is_not_published(tmp_path):
    (tmp_path / "secret").write_text("secret")
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "status.json").symlink_to(tmp_path / "secret")
    with pytest.raises(UserError, match="status.json is a link"):
        dr.push_to_hub(Run(tmp_path / "run", {}, [], [], []), "me/mine")
    assert hub.MANIFEST not in [each.name for each in tmp_path.rglob("*")]


def test_the_links_of_a_tracker_are_left_alone(tmp_path):
    """Weights & Biases keeps one to its own log in the run's folder, which is resumed and copied all the same."""
    (tmp_path / "log").write_text("mine")
    (tmp_path / "run" / "wandb" / "logs").mkdir(parents=True)
    (tmp_path / "run" / "wandb" / "logs" / "core.log").symlink_to(tmp_path / "log")
    (tmp_path / "run" / "status.json").write_text("{}")
    with Folder(tmp_path / "run").alone():
        Folder(tmp_path / "run").drop_after(10)
    Run(tmp_path / "run", {}, [], [], []).save(tmp_path / "copy")
    assert [each.name for each in (tmp_path / "copy").iterdir()] == ["status.json"]
    (tmp_path / "cross").mkdir()
    (tmp_path / "run").rename(tmp_path / "cross" / "fold0")
    (tmp_path / "cross" / "fold0" / "run.json").write_text("{}")
    with Folder(tmp_path / "cross").alone():
        Folder(tmp_path / "cross").drop_after(10)
    (tmp_path / "other" / "metrics" / "wandb").mkdir(parents=True)
    (tmp_path / "other" / "metrics" / "wandb" / "x").symlink_to(tmp_path / "log")
    (tmp_path / "linked").mkdir()
    (tmp_path / "linked" / "wandb").symlink_to(tmp_path / "cross")
    for path in ("other", "linked"):
        with pytest.raises(UserError, match="is a link, which is not followed"):
            Folder(tmp_path / path).drop_after(10)


def test_a_folder_that_is_reached_by_a_link_is_its_users_own(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "other").symlink_to(tmp_path / "run")
    with Folder(tmp_path / "other").alone():
        Folder(tmp_path / "other").write_part("metrics", 10, {"step": [10], "seed": [0]})
    assert Folder(tmp_path / "run").table("metrics")["step"].to_pylist() == [10]


def test_a_part_that_is_called_otherwise_is_one_line(tmp_path):
    (tmp_path / "metrics").mkdir()
    (tmp_path / "metrics" / "abc.parquet").write_text("")
    with pytest.raises(UserError, match=r"abc\.parquet: files of metrics are named after a number of updates"):
        Folder(tmp_path).drop_after(10)
