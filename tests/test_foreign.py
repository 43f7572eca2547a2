import json
import os
import pickle
import signal
import socket
import time
import zipfile

import h5py
import numpy as np
import pytest

from deadreckon.data.formats.io import read
from deadreckon.errors import UserError, printable
from deadreckon.files import read_json, read_toml
from deadreckon.foreign import child
from deadreckon.foreign.archive import read_array, read_arrays
from deadreckon.runs.records import RunConfig, read_run
from deadreckon.runs.run import load as load_run
from deadreckon.training.checkpoint import load_arrays
from deadreckon.unpickle import load_pickle
from tests.data.small_logs import make_log

COLUMNS = {"observations": np.zeros((4, 2), np.float32), "actions": np.zeros((4, 1), np.float32), "rewards": np.zeros(4)}


def refused(function, *arguments, words):
    with pytest.raises(UserError, match=words) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "folder"])
@pytest.mark.parametrize("reader", [load_pickle, read_array, read_arrays, read_json, read_toml, load_arrays, read_run])
def test_what_is_no_file_is_refused_and_nobody_waits_for_it(tmp_path, monkeypatch, kind, reader):
    path = tmp_path / "x"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "device":
        path.symlink_to("/dev/zero")
    elif kind == "folder":
        path.mkdir()
    else:
        with socket.socket(socket.AF_UNIX) as server:
            monkeypatch.chdir(tmp_path)  # names of sockets are short
            server.bind("x")
    refused(reader, path, words=f"{path} is a (named pipe|socket|device|folder), and a file is needed")


def test_logs_and_runs_that_are_pipes_are_refused(tmp_path):
    os.mkfifo(tmp_path / "log.hdf5")
    refused(read, tmp_path / "log.hdf5", words="is a named pipe")
    (tmp_path / "batches").mkdir()
    os.mkfifo(tmp_path / "batches" / "output-0.json")
    refused(read, tmp_path / "batches", words="output-0.json is a named pipe")
    os.mkfifo(tmp_path / "run.json")
    refused(load_run, tmp_path, words="is a named pipe")
    (tmp_path / "log").mkdir()
    os.mkfifo(tmp_path / "log" / "log.json")
    refused(read, tmp_path / "log", words="holds no log")


def test_archives_are_measured_before_they_are_unpacked(tmp_path, monkeypatch):
    path = tmp_path / "log.npz"
    np.savez_compressed(path, **COLUMNS | {"goal": np.zeros((4, 200_000), np.float32)})  # 3.2 MB in 4 kB
    assert read(path).extras["goal"].shape == (4, 200_000)
    with monkeypatch.context() as limits:
        limits.setenv("DEADRECKON_MAX_UNPACKED", "1M")
        refused(read, path, words=r"unpacks to 0\.0032 GB, more than the 0\.001 GB .* DEADRECKON_MAX_UNPACKED")
        limits.setenv("DEADRECKON_MAX_UNPACKED", "lots")
        refused(read, path, words="DEADRECKON_MAX_UNPACKED must be a number of bytes above 0")
    monkeypatch.setenv("DEADRECKON_MAX_MEMBERS", "3")
    refused(read, path, words="holds 4 members, more than the 3 members")


def test_members_of_one_name_are_refused(tmp_path):
    path = tmp_path / "log.npz"
    np.savez(path, **COLUMNS)
    with zipfile.ZipFile(path, "a") as archive, pytest.warns(UserWarning, match="Duplicate"):
        archive.writestr("rewards.npy", archive.read("rewards.npy"))
    refused(read, path, words="two of its members are called 'rewards'")


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (2, 1000000000000)}", "is cut short"),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': (-1,)}", "whole numbers of 0 or more"),
        ("{'descr': '|O', 'fortran_order': False, 'shape': (2,)}", "Python objects"),
        ("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,)}", "arrays of numbers"),
        ("{'descr': '<f4', 'fortran_order': False, 'shape': __import__('os').abort()}", "cannot be read|no array's"),
        ("(" * 5_000, "no array's"),
        ("{'descr': '<U0', 'fortran_order': False, 'shape': (1000000000,)}", "texts of no characters"),
        ("{'descr': 'S0', 'fortran_order': False, 'shape': (4611686018427387904,)}", "texts of no characters"),
        ("{'descr': '<f4', 'fortran_order': False", "cannot be read"),
    ],
)
def test_headers_of_arrays_are_looked_at_before_memory_is_taken(tmp_path, header, words):
    path = tmp_path / "x.npy"
    text = header.encode()
    path.write_bytes(b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text + bytes(8))
    refused(read_array, path, words=words)


def test_gzip_is_unpacked_as_far_as_it_may(tmp_path, monkeypatch):
    import gzip

    path = tmp_path / "log.csv.gz"
    path.write_bytes(gzip.compress(b"observation_0,action_0,reward\n" + b"1.0,2.0,3.0\n" * 200_000))
    monkeypatch.setenv("DEADRECKON_MAX_UNPACKED", "1M")
    refused(read, path, words="unpacks to .* DEADRECKON_MAX_UNPACKED")


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"\x80\x04N\x94r\xff\xff\xff\x1f.", "more memory than a file of its size may take"),  # memo 2 ** 29
        (b"\x80\x04]\x94" + b")" + b"\x85" * 50_000 + b"a.", "nested in 101 levels"),
        (b"\x80\x04}\x94" + b")" + b"\x85" * 50_000 + b"Ns.", "nested in 101 levels"),
        (b"\x80\x04]\x94h\x00a.", "hold themselves|nested in"),
        (b"\x80\x04]\x94" + b"".join(b"]\x94(h" + bytes([i]) + b"h" + bytes([i]) + b"e" for i in range(60)) + b".", ""),
        (b"\x80\x04\x8d\xff\xff\xff\xff\xff\xff\x00\x00.", "cannot be read as a pickle"),  # a text of 2 ** 48 bytes
    ],
    ids=["memo", "tuples", "keys", "itself", "laughs", "text"],
)  # fmt: skip
def test_pickles_cannot_ask_for_time_or_memory(tmp_path, data, words):
    path, began = tmp_path / "x.pkl", time.monotonic()
    path.write_bytes(data)
    if words:
        refused(load_pickle, path, words=words)
    else:
        load_pickle(path)  # what is shared stays so: 2 ** 60 values are 60 lists
    assert time.monotonic() - began < 10


def test_what_a_pickle_holds_comes_over_as_it_is(tmp_path):
    shared = [1.5] * 20
    value = {
        "big": 2**90, "none": None, "bytes": b"\x00\xff", "halves": "\ud800", "set": {1, "a"}, "tuple": (1, (2,)),
        "floats": shared, "again": shared, "ints": list(range(30)), 3: "three", "scalar": np.float32(0.1), "nan": float("nan"),
        "matrix": np.arange(6.0).reshape(2, 3).T, "empty": np.zeros((0, 3)), "flags": np.array([True, False]),
        "frozen": frozenset([1]),
    }  # fmt: skip
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps(value))
    found = load_pickle(path)
    for key in ("matrix", "empty", "flags"):
        np.testing.assert_array_equal(found.pop(key), value.pop(key))
    assert found.pop("set") == value.pop("set")  # whose order may be another
    assert repr(found) == repr(value)
    assert found["floats"] is found["again"]


def _linked(kind, file, folder):
    if kind == "link":
        file["infos/x"] = h5py.ExternalLink(str(folder / "secret.hdf5"), "/x")
    elif kind == "deep link":
        file["metadata/a/b"] = h5py.ExternalLink(str(folder / "secret.hdf5"), "/x")
    elif kind == "virtual":
        layout = h5py.VirtualLayout((13,), "<f4")
        layout[:] = h5py.VirtualSource(str(folder / "secret.hdf5"), "x", (13,))
        file.create_virtual_dataset("infos/x", layout)
    elif kind == "external":
        file.create_dataset("infos/x", (13,), "<f4", external=[(str(folder / "secret.bin"), 0, 52)])
    else:  # through a link within the file
        file["metadata/there"] = h5py.ExternalLink(str(folder / "secret.hdf5"), "/")
        file["infos/x"] = h5py.SoftLink("/metadata/there/x")


@pytest.mark.parametrize("mmap", [False, True])
@pytest.mark.parametrize("kind", ["link", "deep link", "virtual", "external", "soft"])
def test_hdf5_files_that_lead_elsewhere_are_refused(tmp_path, kind, mmap):
    with h5py.File(tmp_path / "secret.hdf5", "w") as file:
        file["x"] = np.arange(13, dtype=np.float32)
    (tmp_path / "secret.bin").write_bytes(bytes(52))
    from deadreckon.data.formats.hdf5 import read_hdf5, write_hdf5

    path = tmp_path / "log.hdf5"
    write_hdf5(make_log(), path)
    with h5py.File(path, "a") as file:
        _linked(kind, file, tmp_path)
    with pytest.raises(UserError, match="a link to another file|lies in another file"):
        read_hdf5(path, mmap=mmap)


def test_groups_that_hold_themselves_and_shapes_without_end(tmp_path):
    from deadreckon.data.formats.hdf5 import write_hdf5

    path = tmp_path / "log.hdf5"
    write_hdf5(make_log(goal=np.ones(13, np.float32)), path)
    with h5py.File(path, "a") as file:
        file["infos/loop"] = file["/"]
    assert set(read(path).extras) == {"goal"}
    with h5py.File(path, "a") as file:
        file.create_dataset("infos/huge", (13, 2**40), "<f4", chunks=(1, 1000))
    refused(read, path, words="unpacks to .* DEADRECKON_MAX_UNPACKED")


def test_limits_hold_for_the_next_file_though_the_process_is_an_older_one(tmp_path, monkeypatch):
    from deadreckon.data.formats.hdf5 import write_hdf5

    path = tmp_path / "log.hdf5"
    write_hdf5(make_log(), path)
    with h5py.File(path, "a") as file:
        file.create_dataset("infos/x", data=np.zeros((13, 1000)), compression="gzip")
    assert read(path).extras["x"].shape == (13, 1000)
    with monkeypatch.context() as limits:
        limits.setenv("DEADRECKON_MAX_UNPACKED", "50k")
        refused(read, path, words="unpacks to .* DEADRECKON_MAX_UNPACKED")
    assert read(path).extras["x"].shape == (13, 1000)


def test_a_reader_that_is_silent_or_dies_is_told_and_the_next_file_is_read(tmp_path, monkeypatch):
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps([1]))
    assert load_pickle(path) == [1]
    with monkeypatch.context() as limits:
        limits.setenv("DEADRECKON_MAX_SECONDS", "0.3")
        os.kill(child._child.process.pid, signal.SIGSTOP)
        refused(load_pickle, path, words="has not ended after 0 s.*DEADRECKON_MAX_SECONDS")
    assert load_pickle(path) == [1]
    ends_at_work(signal.SIGSEGV)
    refused(load_pickle, path, words=r"the library that reads it crashed \(-11\)")
    assert load_pickle(path) == [1]


def ends_at_work(number):
    """Has the reading process end by a signal when it is asked next: once the request is sent, and before it can answer."""
    reader, take = child._child, child._child._take
    os.kill(reader.process.pid, signal.SIGSTOP)

    def taken(count, silence):
        for each in (number, signal.SIGCONT):  # in this order
            os.kill(reader.process.pid, each)
        return take(count, silence)

    reader._take = taken


def test_a_reader_that_somebody_killed_is_asked_again_and_told_when_it_happens_twice(tmp_path, monkeypatch):
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps([1]))
    assert load_pickle(path) == [1]
    ends_at_work(signal.SIGKILL)
    assert load_pickle(path) == [1]  # a shortage of memory elsewhere is no damage of this file
    begun = child._Child

    def begin():
        made = begun()
        made.process.kill()
        made.process.wait()
        return made

    child._drop()
    with monkeypatch.context() as killed:
        killed.setattr(child, "_Child", begin)
        refused(load_pickle, path, words=r"the process that reads it was killed twice \(SIGKILL\)")
    assert load_pickle(path) == [1]


def test_a_reader_that_ends_by_itself_or_a_lack_of_memory_here_is_no_kill(tmp_path, monkeypatch):
    path = tmp_path / "x.pkl"
    path.write_bytes(pickle.dumps([np.zeros(3)]))
    load_pickle(path)

    def lacking(*given, **options):
        raise OSError(12, "Cannot allocate memory")

    with monkeypatch.context() as short:
        short.setattr(child.mmap, "mmap", lacking)
        refused(load_pickle, path, words="cannot be read as .*: Cannot allocate memory")
    assert len(load_pickle(path)) == 1
    ends_at_work(signal.SIGTERM)
    refused(load_pickle, path, words=r"the library that reads it crashed \(-15\)")


def test_relative_paths_are_those_of_this_process(tmp_path, monkeypatch):
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / "x.pkl").write_bytes(pickle.dumps(name))
        monkeypatch.chdir(folder)
        assert load_pickle("x.pkl") == name


RUN = {
    "agent": {"name": "bc", "fields": {}},
    "data": {"name": "x", "fingerprint": "y"},
    "task": None,
    "seeds": [0, 1],
    "steps": 4,
}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"seeds": "0"}, r"run.json: seeds must be a list of whole numbers, got '0'"),
        ({"seeds": [0, 0]}, "seeds must be different whole numbers"),
        ({"steps": 0}, "steps must be 1 or more, got 0"),
        ({"seeds": [0, True]}, r"seeds\[1\] must be a whole number, got True"),
        ({"steps": 2**64}, "steps must be a whole number"),
        ({"agent": {"name": "bc"}}, "agent lacks fields"),
        ({"agent": {"name": None, "fields": {}}}, "agent.name must be a text, got None"),
        ({"data": []}, "data must be an object, got a list of 0"),
        (
            {"data": {"name": "x", "fingerprint": "y", "behavior": {"mean": 1.0, "low": "x", "high": 2}}},
            "data.behavior.low must be a number",
        ),
        ({"task": 3}, "task must be a text or null, got 3"),
        ({"online": {"copies": 8, "more": 1}}, "online: unknown entry 'more'"),
        ({"evaluation": {"every": []}}, "evaluation.every must be a whole number or null, got a list of 0"),
    ],
)
def test_a_wrong_type_names_file_and_field(tmp_path, change, words):
    path = tmp_path / "run.json"
    path.write_text(json.dumps(RUN))
    assert read_json(path, RunConfig) == RUN
    path.write_text(json.dumps(RUN | change))
    refused(read_run, path, words=words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (b"[" * 200_000, "is nested in 200,000 levels, more than the 100 levels"),
        (b'{"a": ' * 101 + b"1" + b"}" * 101, "is nested in 101 levels"),
        (b"9" * 5_000, "is not valid JSON"),
        (b'"\\ud800"', "half of a character"),
        (b"\xff", "is not valid JSON"),
        (b"", "is not valid JSON"),
    ],
)
def test_json_that_no_parser_should_see(tmp_path, text, words):
    path = tmp_path / "x.json"
    path.write_bytes(text)
    refused(read_json, path, words=words)
    assert read_json_of(tmp_path, b'{"a": "' + b"[" * 300 + b'"}') == {"a": "[" * 300}  # in a text it is no depth


def read_json_of(folder, text):
    path = folder / "sound.json"
    path.write_bytes(text)
    return read_json(path)


def test_errors_are_one_line_that_speaks_to_no_terminal():
    assert str(UserError("a\nb\x1b[31mred\x07 \u202eevil ä 木 🙂")) == r"a b\x1b[31mred\x07 \u202eevil ä 木 🙂"
    assert len(printable("x" * 10**6)) < 2_100
