import numpy as np
import pytest
from small_logs import make_log

from deadreckon.cli.data import Mapping, data, mapping_options
from deadreckon.data.hdf5 import write_hdf5
from deadreckon.data.io import read
from deadreckon.errors import UserError


@pytest.mark.parametrize("out", ["x.csv", "sub/x.parquet", "x", "x.npz"])
def test_logs_are_collected_into_hdf5_alone(tmp_path, monkeypatch, out):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UserError, match=rf"^--out {out}: .* then `deadreckon data convert (sub/)?x.hdf5 {out}`$"):
        data(["collect", "maze2d-umaze-v1", "--steps", "10", "--out", out])
    assert [path.name for path in tmp_path.iterdir() if path.name != "home"] == []


def test_the_mapping_of_a_table(tmp_path, capsys):
    path = tmp_path / "clicks.csv"
    path.write_text("when,u_0,u_1,id,arm,click\n2026-01-01,1,2,a,x,1\n2026-01-02,3,4,b,y,0\n")
    data(["info", str(path), "--action", "arm", "--reward", "click", "--ignore", "id"])
    shown = capsys.readouterr().out
    assert "observations  (2,)" in shown
    assert "! timestamps are left out of the observations: when" in shown
    data(["info", str(path), "--action", "arm", "--reward", "click", "--observations", "u", "id"])
    assert "observations  (4,)" in capsys.readouterr().out
    assert mapping_options(Mapping(reward="r", ignore=("id",))) == {"reward": "r", "ignore": ("id",)}


def test_a_horizon(tmp_path, capsys):
    log = make_log((12,), terminal=(True,))
    write_hdf5(log, tmp_path / "log.hdf5")
    plain = tmp_path / "plain.npz"
    np.savez(plain, observations=log.observations, actions=log.actions, rewards=log.rewards, terminals=log.terminals)
    data(["info", str(plain)])
    assert "time limits that are not marked would be crossed" in capsys.readouterr().out
    data(["info", str(plain), "--horizon", "4"])
    assert "12 in 3 episodes" in capsys.readouterr().out
    data(["convert", str(plain), str(tmp_path / "cut.hdf5"), "--horizon", "4"])
    assert read(tmp_path / "cut.hdf5").lengths.tolist() == [4, 4, 4]
    assert "2 of 12 rows have no known successor" in capsys.readouterr().err
