import gzip
import pickle
import zipfile

import numpy as np
import pytest
from small_logs import images, same

from deadreckon.data.formats import io, kind
from deadreckon.data.formats.folder import write_folder
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.formats.io import convert, read
from deadreckon.data.schema import Schema
from deadreckon.errors import UserError


@pytest.mark.parametrize("target", ["log.hdf5", "log.h5", "log.parquet", "log.npz", "log", "sub/log/", "minari:mine/maze-v0"])
def test_convert_to_everything_and_back(log, tmp_path, monkeypatch, target):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    write_hdf5(log, "source.hdf5")
    assert convert("source.hdf5", target).fingerprint == log.fingerprint
    assert read(target).fingerprint == log.fingerprint
    with pytest.raises(UserError, match="exists already"):
        convert("source.hdf5", target)
    convert("source.hdf5", target, force=True)
    same(log, convert(target, "back.hdf5"))
    assert read("back.hdf5", mmap=True).fingerprint == log.fingerprint
    assert not list(tmp_path.glob(".*"))


def test_csv_needs_no_header_of_ours(log, tmp_path):
    write_hdf5(log, tmp_path / "a.hdf5")
    convert(tmp_path / "a.hdf5", tmp_path / "a.csv")
    np.testing.assert_array_equal(read(tmp_path / "a.csv").actions, log.actions)


def test_content_decides_not_the_name(log, tmp_path):
    write_hdf5(log, tmp_path / "log.csv")
    assert io.sniff(tmp_path / "log.csv") == "hdf5"
    assert read(tmp_path / "log.csv").fingerprint == log.fingerprint


def test_convert_refuses_what_would_lose_data(log, tmp_path):
    write_hdf5(log, tmp_path / "a.hdf5")
    with pytest.raises(UserError, match="is the source itself"):
        convert(tmp_path / "a.hdf5", tmp_path / "a.hdf5", force=True)
    (tmp_path / "photos").mkdir()
    (tmp_path / "photos" / "cat.jpg").write_text("meow")
    with pytest.raises(UserError, match="holds no log, so it is not replaced"):
        convert(tmp_path / "a.hdf5", tmp_path / "photos", force=True)
    with pytest.raises(UserError, match=r"unknown ending .xlsx; known: .hdf5"):
        convert(tmp_path / "a.hdf5", tmp_path / "a.xlsx")
    write_hdf5(images(), tmp_path / "pictures.hdf5")
    (tmp_path / "b.csv").write_text("old")
    with pytest.raises(UserError, match="do not fit into CSV"):
        convert(tmp_path / "pictures.hdf5", tmp_path / "b.csv", force=True)
    assert (tmp_path / "b.csv").read_text() == "old"


def test_convert_does_not_replace_the_table_that_a_schema_stands_for(tmp_path):
    schema, table = tmp_path / "log.toml", tmp_path / "log.csv"
    table.write_text("x,action,reward\n1.5,0,1\n2.5,1,2\n")
    columns = {"x": {"role": "observation"}, "action": {"role": "action", "kind": "integer"}, "reward": {"role": "reward"}}
    Schema.from_json({"columns": columns, "table": {"path": "log.csv"}}).save(schema)
    with pytest.raises(UserError, match=f"{table} is the table that {schema} stands for; choose another name"):
        convert(schema, table, force=True)
    assert table.read_text() == "x,action,reward\n1.5,0,1\n2.5,1,2\n"
    assert len(convert(schema, tmp_path / "other.csv")) == 2


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no file"),
        (b"", "the file is empty"),
        (b"just a sentence\nand another", "not a log in a format that is read"),
        (bytes(range(256)), "not a log in a format that is read"),
        (b"\x1f\x8b\x08\x00garbage", "cannot be read as gzip"),
        (gzip.compress(b"PAR1", mtime=0), "a gzipped parquet file; unpack it first"),
        (b"\x89HDF\r\n\x1a\n", "cannot be read as hdf5"),
        (b"PAR1", "cannot be read as Parquet"),
        (b"PK\x03\x04", "cannot be read as npz"),
        (b"\x80\x04", "cannot be read as a pickle"),
    ],
)
def test_files_that_are_no_logs(tmp_path, content, words):
    path = tmp_path / "log"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(UserError, match=words) as caught:
        read(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_that_do_not_fit(log, tmp_path):
    with pytest.raises(UserError, match=r"this folder holds no log .*data/metadata.json\)$"):
        read(tmp_path)
    (tmp_path / "parts" / "day=1").mkdir(parents=True)
    (tmp_path / "parts" / "day=1" / "a.parquet").write_bytes(b"PAR1")
    with pytest.raises(UserError, match="data convert .*parts OUT` makes one of its Parquet files"):
        read(tmp_path / "parts")
    write_hdf5(log, tmp_path / "a.hdf5")
    with pytest.raises(UserError, match="action names a column of a table, but this is hdf5"):
        read(tmp_path / "a.hdf5", action="a")
    convert(tmp_path / "a.hdf5", tmp_path / "a.npz")
    with pytest.raises(UserError, match="npz is not stored column by column, so it cannot be memory-mapped"):
        read(tmp_path / "a.npz", mmap=True)


def test_convert_refuses_names_of_columns_before_it_makes_anything(log, tmp_path):
    write_hdf5(log, tmp_path / "a.hdf5")
    with pytest.raises(UserError, match="action names a column of a table"):
        convert(tmp_path / "a.hdf5", tmp_path / "new" / "b.hdf5", action="a")
    assert not (tmp_path / "new").exists()


def test_a_horizon_is_for_files_that_do_not_say(log, tmp_path):
    write_folder(log, tmp_path / "log")
    with pytest.raises(UserError, match="folder says where episodes end"):
        read(tmp_path / "log", horizon=3)


def test_tables_that_begin_as_other_formats_do(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("when|x|action|reward\n2024-01-01 12:30:00|1.5|0|1\n2024-01-01 12:31:01|2.5|1|2\n")
    assert io.sniff(path) == "csv"
    assert read(path, time="when").observations[:, 0].tolist() == [1.5, 2.5]
    path.write_text("1:2:0.5 |x a:1\n2:1:0.25 |x a:2\n")
    assert io.sniff(path) == "vw"
    assert io.sniff(path, "pipe") == "csv"
    for name in ("(dose)", "(load)", "(index)"):
        path.write_text(f"{name},action,reward\n1.5,0,1\n2.5,1,2\n")
        assert read(path).provenance.extra["observation_names"] == [name]


def test_a_table_is_sniffed_once(tmp_path, monkeypatch):
    path, asked = tmp_path / "log.csv", []
    path.write_text("x,action,reward\n1.5,0,1\n2.5,1,2\n")
    known = kind.is_table
    monkeypatch.setattr(kind, "is_table", lambda *given: asked.append(given) or known(*given))
    assert len(read(path)) == 2
    assert len(asked) == 1


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("value", [{"a": 1}, [1], [{"a": [1.5]}]])
def test_pickles_are_known_by_what_they_begin_with(tmp_path, protocol, value):
    path = tmp_path / "log"
    path.write_bytes(pickle.dumps(value, protocol))
    assert io.sniff(path) == "pickle"


def test_a_zipped_table_is_unpacked_first(tmp_path):
    path = tmp_path / "log.zip"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("some/log.csv", "x,action,reward\n1,0,1\n")
    with pytest.raises(UserError, match=f"^{path}: a zip archive that holds some/log.csv; unpack it first"):
        read(path)
    with pytest.raises(UserError, match="unpack it first"):
        read(path, action="action", separator=",")
