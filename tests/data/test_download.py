"""Downloads from a server on this machine that can do everything that a bad network does."""

import base64
import contextlib
import hashlib
import io
import json
import shutil
import socket
import threading
import urllib.request
import warnings
from collections import deque
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace

import gymnasium
import gymnasium_robotics
import h5py
import minari
import numpy as np
import pytest
from small_logs import make_log, same

from deadreckon.cli.data import data
from deadreckon.data import download
from deadreckon.data.catalogue import at_hand, cached_path, entry, load, record_path
from deadreckon.data.connection import Redirects
from deadreckon.data.dataset import Dataset
from deadreckon.data.download import get
from deadreckon.data.entries import ENTRIES
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.formats.minari import write_minari
from deadreckon.data.transfer import RetryPolicy, fetch
from deadreckon.errors import UserError
from deadreckon.tasks import task
from deadreckon.tasks.kitchen import ELEMENTS
from tests.limits import files_up_to

NAME = "hopper-medium-v2"
ORIGINAL = "/d4rl/gym_mujoco_v2/hopper_medium-v2.hdf5"
TWIN = "/hub/mujoco/resolve/main/hopper/medium-v0/data/"
MAKES = "`deadreckon data collect hopper-medium-v2` makes it here"


class Handler(BaseHTTPRequestHandler):
    """Serves `server.files`; what is in `server.next` answers instead, one request each."""

    def log_message(self, format, *args):
        pass

    def do_GET(self):
        self.server.requests.append((self.path, {key.lower(): value for key, value in self.headers.items()}))
        answer = self.server.next.popleft() if self.server.next else serve
        with contextlib.suppress(ConnectionError):
            answer(self)

    def send(self, status, body=b"", length=None, **headers):
        self.send_response(status)
        for key, value in headers.items():
            self.send_header(key.replace("_", "-"), value)
        if length != "none":
            self.send_header("Content-Length", str(len(body) if length is None else length))
        self.end_headers()
        self.server.sent.append(len(body))  # before the client has it all, and looks
        self.wfile.write(body)


def serve(handler, part=None, ranges=True):
    """The file; `part` bytes of it before the connection drops."""
    body, headers = handler.server.files.get(handler.path, (None, {}))
    if body is None:
        return handler.send(404)
    asked = handler.headers.get("Range")
    current = handler.headers.get("If-Range") in (headers.get("ETag"), headers.get("Last_Modified"))
    if asked and current and ranges:
        start = int(asked.removeprefix("bytes=").removesuffix("-"))
        place = f"bytes {start}-{len(body) - 1}/{len(body)}"
        rest = body[start:]
        return handler.send(206, rest[:part], length=len(rest), Content_Range=place, **headers)
    return handler.send(200, body[:part], length=len(body), **headers)


def drops(part, **options):
    return lambda handler: serve(handler, part, **options)


def says(status, body=b"", **headers):
    return lambda handler: handler.send(status, body, **headers)


def redirects(path, **headers):
    return says(302, Location=path, **headers)


@pytest.fixture
def server(monkeypatch):
    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as made:
        made.daemon_threads = True
        made.files, made.next, made.requests, made.sent = {}, deque(), [], []
        thread = threading.Thread(target=made.serve_forever, args=(0.01,))
        thread.start()
        made.root = f"http://127.0.0.1:{made.server_port}"
        monkeypatch.setenv("no_proxy", "127.0.0.1")
        monkeypatch.setenv("DEADRECKON_D4RL_URL", f"{made.root}/d4rl/")
        monkeypatch.setenv("DEADRECKON_MINARI_URL", f"{made.root}/hub")
        yield made
        made.shutdown()
        thread.join()


def d4rl_file(log) -> bytes:
    """In the original's layout: chunked, compressed, with infos and metadata, and no header of ours."""
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        for key in ("observations", "next_observations", "actions", "rewards", "terminals", "timeouts"):
            file.create_dataset(key, data=getattr(log, key), compression="gzip")
        file["infos/qpos"] = np.arange(2.0 * len(log)).reshape(-1, 2)
        file["metadata/algorithm"] = "SAC"
    return buffer.getvalue()


@pytest.fixture
def original(server):
    """What the server has as the original: the log, and its bytes."""
    log = make_log((40, 25, 60), seed=3)
    body = d4rl_file(log)
    server.files[ORIGINAL] = (body, {"ETag": '"one"', "Last_Modified": "Mon, 01 Jun 2020 10:00:00 GMT"})
    return SimpleNamespace(log=log, body=body, sha256=hashlib.sha256(body).hexdigest())


@pytest.fixture(scope="module")
def twin_files(tmp_path_factory):
    """The log of a Minari data set, and its files."""
    log = make_log((30, 20), seed=4, goal=np.ones((50, 2), np.float32), name="theirs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(tmp_path_factory.mktemp("minari")))
        folder = write_minari(log, "mujoco/hopper/medium-v0") / "data"
    about = json.loads((folder / "metadata.json").read_text())
    del about["deadreckon"]  # they know nothing of us
    return log, json.dumps(about).encode(), (folder / "main_data.hdf5").read_bytes()


@pytest.fixture
def twin(server, twin_files):
    log, about, main = twin_files
    server.files[f"{TWIN}metadata.json"] = (about, {"ETag": '"about"'})
    server.files[f"{TWIN}main_data.hdf5"] = (main, {"ETag": '"main"'})
    return SimpleNamespace(log=log, about=json.loads(about), main=main, sha256=hashlib.sha256(main).hexdigest())


@pytest.fixture
def retry():
    """That does not wait; `retry.waits` says how long it would have."""
    waits = []
    made = RetryPolicy(tries=3, timeout=5.0, sleep=waits.append)
    object.__setattr__(made, "waits", waits)
    return made


def cache(home):
    folder = home / "data"
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*")) if folder.exists() else []


def left_alone(home, server, retry, words, name=NAME, source="d4rl", **options):
    """`get` fails in one line with these words and leaves nothing."""
    with pytest.raises(UserError) as caught:
        get(name, source, retry=retry, **options)
    text = str(caught.value)
    assert "\n" not in text
    for word in words:
        assert word in text
    assert cache(home) == []
    assert not (home / "data").exists()


# ---- what works ----------------------------------------------------------------------------------------------------


def test_the_original_is_kept_byte_for_byte(server, original, home):
    told = []
    got = get(NAME, progress=lambda done, total: told.append((done, total)))
    assert got == download.Download(f"{NAME}@d4rl", home / "data" / f"{NAME}@d4rl.hdf5", True, original.sha256, None)
    assert got.path.read_bytes() == original.body
    assert cache(home) == [f"{NAME}@d4rl.hdf5", f"{NAME}@d4rl.json"]
    assert told[0] == (0, len(original.body))
    assert told[-1] == (len(original.body), len(original.body))
    for name in (NAME, f"{NAME}@d4rl"):
        log = load(name)
        assert log.name == f"{NAME}@d4rl"
        assert log.warnings == ()
        about = log.provenance
        assert about.source == "d4rl-hdf5"
        assert about.path == str(got.path)
        assert (about.extra["url"], about.extra["sha256"]) == (server.root + ORIGINAL, original.sha256)
        assert about.extra["vouched"] is None
        assert about.extra["date"].startswith("20")
        assert about.extra["metadata"] == {"algorithm": "SAC"}
    for key in ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations"):
        np.testing.assert_array_equal(getattr(log, key), getattr(original.log, key))
    assert log.extras["qpos"].shape == (125, 2)


def test_ants_twin_is_laid_out_as_the_original(server, tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    seen = rng.normal(size=(12, 105)).astype(np.float32)  # Gymnasium's v5, with contact forces
    log = Dataset.from_arrays(
        observations=seen, actions=rng.uniform(-1, 1, (12, 8)).astype(np.float32), rewards=np.ones(12, np.float32),
        timeouts=np.arange(12) % 6 == 5, final_observations=seen[:2], name="theirs",
    )  # fmt: skip
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    folder = write_minari(log, "mujoco/ant/medium-v0") / "data"
    for name in ("metadata.json", "main_data.hdf5"):
        server.files[TWIN.replace("hopper", "ant") + name] = ((folder / name).read_bytes(), {})
    get("ant-medium-v2", "minari")
    found = load("ant-medium-v2@minari")
    for key in ("observations", "final_observations"):
        np.testing.assert_array_equal(getattr(found, key)[:, :27], getattr(log, key)[:, :27])
        assert getattr(found, key).shape[1] == 111
        assert not getattr(found, key)[:, 27:].any()
    assert found.provenance.extra["observations"] == "columns 0-26 of 105, then 84 constants"


@pytest.mark.slow
def test_the_kitchens_twin_is_laid_out_as_the_original(server, tmp_path, monkeypatch):
    """The environment whose steps Minari has shows dicts and 59 numbers; our tasks show what D4RL's did."""
    gymnasium.register_envs(gymnasium_robotics)
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    todo = ["microwave", "kettle", "bottom burner", "light switch"]
    env = gymnasium.make("FrankaKitchen-v1", tasks_to_complete=todo, max_episode_steps=3)
    collector = minari.DataCollector(env)
    rng = np.random.default_rng(0)
    for seed in range(2):
        collector.reset(seed=seed)
        for _ in range(3):
            collector.step(rng.uniform(-1, 1, 9))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # that there is no author, code link, ...
        made = collector.create_dataset("D4RL/kitchen/mixed-v2")
    theirs = [episode.observations for episode in made.iterate_episodes()]
    collector.close()
    for name in ("metadata.json", "main_data.hdf5"):
        content = (tmp_path / "minari" / "D4RL/kitchen/mixed-v2/data" / name).read_bytes()
        server.files[f"/hub/D4RL/resolve/main/kitchen/mixed-v2/data/{name}"] = (content, {})
    get("kitchen-mixed-v0", "minari")
    found, here = load("kitchen-mixed-v0@minari"), task("kitchen-mixed")
    assert found.spec.observation_shape == here.observation_shape
    assert found.spec.action_size == here.action_space.size
    seen = found.observations.reshape(2, 3, 60)
    for episode, rows, last in zip(theirs, seen, found.final_observations):
        assert episode["observation"].shape == (4, 59)
        rows = np.concatenate([rows, last[None]])
        np.testing.assert_allclose(rows[:, :9], episode["observation"][:, :9], rtol=1e-6)
        for element, (where, wanted) in ELEMENTS.items():
            if element in todo:
                # What was achieved is true, what is seen is read with noise.
                np.testing.assert_allclose(rows[:, where], episode["achieved_goal"][element], atol=0.02)
                np.testing.assert_allclose(episode["desired_goal"][element], np.tile(wanted, (4, 1)))
    np.testing.assert_array_equal(found.observations[:, 30:], np.tile(here.goal.astype(np.float32), (6, 1)))
    assert found.provenance.extra["observations"] == "columns 0-8, 18-38 of 59, then 30 constants"


def test_a_twin_with_other_numbers_is_refused(server, home, tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))
    folder = write_minari(make_log(), "D4RL/kitchen/mixed-v2") / "data"
    for name in ("metadata.json", "main_data.hdf5"):
        server.files[f"/hub/D4RL/resolve/main/kitchen/mixed-v2/data/{name}"] = ((folder / name).read_bytes(), {})
    with pytest.raises(UserError, match=r"main_data.hdf5: it has \d+ numbers .*, but it should have 59; the file was removed"):
        get("kitchen-mixed-v0", "minari")
    assert cache(home) == []


def test_the_twin_becomes_one_file_with_our_columns(server, twin, home):
    got = get(NAME, "minari")
    assert got == download.Download(f"{NAME}@minari", home / "data" / f"{NAME}@minari.hdf5", True, twin.sha256, None)
    assert cache(home) == [f"{NAME}@minari.hdf5"]
    log = load(f"{NAME}@minari")
    same(log, twin.log)
    assert log.name == load(NAME, mmap=True).name == f"{NAME}@minari"
    about = log.provenance
    assert (about.source, about.recipe, about.extra["dataset_id"]) == ("minari", None, "mujoco/hopper/medium-v0")
    assert (about.extra["url"], about.extra["sha256"]) == (f"{server.root}{TWIN}main_data.hdf5", twin.sha256)


def test_both_have_the_columns_that_a_collected_log_has(server, original, twin, home):
    for source in ("d4rl", "minari"):
        get(NAME, source)
    d4rl, minari = load(f"{NAME}@d4rl"), load(f"{NAME}@minari")
    for key in ("observations", "actions", "rewards", "terminals", "timeouts", "final_observations"):
        a, b = getattr(d4rl, key), getattr(minari, key)
        assert (a.dtype, a.shape[1:]) == (b.dtype, b.shape[1:])


def test_which_copy_a_plain_name_means(server, original, twin, home):
    with pytest.raises(UserError, match=f"is not in the cache yet: {MAKES}, or .*data get {NAME} --source d4rl` downloads"):
        load(NAME)
    assert at_hand(entry(NAME)) == []
    for source, kinds in (("minari", ["minari"]), ("d4rl", ["d4rl", "minari"])):
        get(NAME, source)
        assert at_hand(entry(NAME)) == kinds
        assert load(NAME).name == f"{NAME}@{source}"
    write_hdf5(make_log(name=f"{NAME}@dr1"), cached_path(NAME))
    assert at_hand(entry(NAME)) == ["dr1", "d4rl", "minari"]
    assert load(NAME).name == f"{NAME}@dr1"
    assert load(f"{NAME}@d4rl").name == f"{NAME}@d4rl"
    with pytest.raises(UserError, match="stored in chunks or compressed, so it cannot be memory-mapped"):
        load(f"{NAME}@d4rl", mmap=True)


def test_a_mirror_of_our_own_logs_passes_for_nothing_else(server, home, tmp_path):
    write_hdf5(make_log(name=f"{NAME}@dr1"), tmp_path / "ours.hdf5")
    server.files[ORIGINAL] = ((tmp_path / "ours.hdf5").read_bytes(), {})
    get(NAME)
    assert load(NAME).name == load(NAME, mmap=True).name == f"{NAME}@d4rl"


def test_what_is_there_is_not_downloaded_again(server, original, twin):
    for source, sha256 in (("d4rl", original.sha256), ("minari", twin.sha256)):
        first = get(NAME, source)
        asked = len(server.requests)
        for wanted in (None, sha256.upper()):
            again = get(f"{NAME}@{source}", source, sha256=wanted)
            assert (again.path, again.new, again.sha256) == (first.path, False, sha256)
        with pytest.raises(UserError, match=f"another sha256: expected 0{{64}}, got {sha256}; --force downloads it again"):
            get(NAME, source, sha256="0" * 64)
        assert len(server.requests) == asked
        assert get(NAME, source, force=True).new
        assert len(server.requests) > asked


def test_force_replaces_file_and_record_together(server, original, home):
    get(NAME)
    other = d4rl_file(make_log((9,), seed=5))
    server.files[ORIGINAL] = (other, {"ETag": '"two"'})
    got = get(NAME, force=True)
    assert got.path.read_bytes() == other
    assert load(NAME).provenance.extra["sha256"] == got.sha256 == hashlib.sha256(other).hexdigest()


def test_an_original_without_its_record_says_so(server, original, home):
    path = get(NAME).path
    path.write_bytes(d4rl_file(make_log((7,))))  # not what was recorded
    for _ in range(2):
        log = load(NAME)
        assert log.warnings == (f"where it came from is not recorded: no {NAME}@d4rl.json that fits the file",)
        assert "url" not in log.provenance.extra
        record_path(path).unlink(missing_ok=True)
    assert get(NAME).sha256 is None


# ---- redirects -------------------------------------------------------------------------------------------------------


def test_redirects_are_followed_and_hugging_face_names_the_checksum(server, twin, retry):
    server.files["/store/xyz"] = server.files.pop(f"{TWIN}main_data.hdf5")
    server.next += [serve, redirects("/store/xyz", X_Linked_ETag=f'"{twin.sha256}"'), drops(1000), redirects("/store/xyz")]
    got = get(NAME, "minari", retry=retry)
    assert got.vouched == "the server's X-Linked-ETag"
    assert [path for path, _ in server.requests[1:]] == [f"{TWIN}main_data.hdf5", "/store/xyz"] * 2
    assert server.requests[-1][1]["range"] == "bytes=1000-"
    assert load(NAME).provenance.extra["vouched"] == got.vouched
    assert load(NAME).provenance.extra["url"] == f"{server.root}{TWIN}main_data.hdf5"


def test_redirects_without_an_end(server, home, retry):
    server.next += [redirects(ORIGINAL)] * 50
    left_alone(home, server, retry, [server.root + ORIGINAL, "redirects in a circle", MAKES])
    assert len(server.requests) <= 12
    assert retry.waits == []


@pytest.mark.parametrize("place", ["http://x.org/a", "ftp://x.org/a", "file:///etc/passwd"])
def test_no_redirect_leads_to_a_less_safe_place(place):
    request = urllib.request.Request("https://x.org/b")
    with pytest.raises(UserError, match=f"https://x.org/b: redirects to {place}, which is less safe"):
        Redirects().redirect_request(request, io.BytesIO(), 302, "Found", {}, place)


# ---- refusals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("status", [404, 410, 403])
def test_what_is_gone_names_the_recipe_that_always_works(server, home, retry, status):
    server.next += [says(status)]
    left_alone(home, server, retry, [server.root + ORIGINAL, f"the server answered {status}", MAKES])
    assert retry.waits == []
    server.next += [says(status)]
    left_alone(home, server, retry, [f"{server.root}{TWIN}metadata.json", str(status), MAKES], source="minari")


def test_a_twin_of_which_one_file_is_gone(server, twin, home, retry):
    del server.files[f"{TWIN}main_data.hdf5"]
    left_alone(home, server, retry, ["main_data.hdf5", "404", MAKES], source="minari")


def test_no_server_there(server, home, retry, monkeypatch):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setenv("DEADRECKON_D4RL_URL", f"http://127.0.0.1:{free.getsockname()[1]}")
        left_alone(home, server, retry, ["connection refused", MAKES])

    def no_name(*args, **options):
        raise socket.gaierror(socket.EAI_NONAME, "Name or service not known")

    monkeypatch.setattr(socket, "getaddrinfo", no_name)
    monkeypatch.setenv("DEADRECKON_D4RL_URL", "http://nowhere.invalid/")
    left_alone(home, server, retry, ["no server of that name (Name or service not known)", MAKES])
    assert retry.waits == []


@pytest.mark.parametrize("root", ["file:///etc", "ftp://x.org", "x.org", "http://", "http://x.org:port", "http://[x"])
def test_addresses_that_are_none(server, home, retry, monkeypatch, root):
    monkeypatch.setenv("DEADRECKON_D4RL_URL", root)
    left_alone(home, server, retry, [root, "address"])


def test_what_cannot_be_asked_for(server, home, retry):
    for words, name, source in (
        (["did you mean hopper-medium-v2"], "hopper-medum-v2", "d4rl"),
        (["unknown source 'mirai'", "minari"], NAME, "mirai"),
        (["has no Minari twin: --source d4rl downloads its", "collect hopper-random-v2`"], "hopper-random-v2", "minari"),
        (["contradict each other; leave @dr1 out"], f"{NAME}@dr1", "d4rl"),
    ):
        left_alone(home, server, retry, words, name, source)
    left_alone(home, server, retry, ["64 hexadecimal digits, got 'abc'"], sha256="abc")
    assert server.requests == []


def test_a_log_of_ours_alone_has_no_original(server, home, retry, monkeypatch):
    ours = replace(entry(NAME), original=None, minari=None)
    monkeypatch.setitem(ENTRIES, NAME, ours)
    left_alone(home, server, retry, [f"{NAME} has no original at D4RL's: {MAKES}"])
    with pytest.raises(UserError, match=f"not in the cache yet: {MAKES}$"):
        load(NAME)
    with pytest.raises(UserError, match=f"unknown version 'd4rl' of {NAME}: known are {NAME}@dr1 \\(collected\\)$"):
        load(f"{NAME}@d4rl")


# ---- broken transfers ------------------------------------------------------------------------------------------------


def test_a_dropped_connection_goes_on_where_it_was(server, original, home, retry):
    half = len(original.body) // 2
    server.next += [drops(half)]
    got = get(NAME, retry=retry)
    assert got.path.read_bytes() == original.body
    assert got.sha256 == original.sha256
    (_, first), (_, second) = server.requests
    assert "range" not in first
    assert (second["range"], second["if-range"]) == (f"bytes={half}-", '"one"')
    assert server.sent == [half, len(original.body) - half]
    assert retry.waits == [1.0]
    assert first["accept-encoding"] == "identity"
    assert cache(home) == [f"{NAME}@d4rl.hdf5", f"{NAME}@d4rl.json"]


def test_a_killed_process_is_gone_on_with_by_the_next(server, original, home):
    """What an interruption leaves is what a kill leaves."""
    server.next += [drops(2000)]

    def stop(seconds):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        get(NAME, retry=RetryPolicy(sleep=stop))
    part = f".{NAME}@d4rl.hdf5.part"
    assert cache(home) == [part, f"{part}.json"]
    assert (home / "data" / part).read_bytes() == original.body[:2000]
    assert at_hand(entry(NAME)) == []
    told = []
    got = get(NAME, progress=lambda done, total: told.append(done))
    assert told[0] == 2000
    assert server.requests[-1][1]["range"] == "bytes=2000-"
    assert got.path.read_bytes() == original.body
    assert cache(home) == [f"{NAME}@d4rl.hdf5", f"{NAME}@d4rl.json"]


def test_a_twin_is_gone_on_with_too(server, twin, home):
    server.next += [serve, drops(1500)]

    def stop(seconds):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        get(NAME, "minari", retry=RetryPolicy(sleep=stop))
    assert f".{NAME}@minari.hdf5.part/data/main_data.hdf5" in cache(home)
    got = get(NAME, "minari")
    assert server.requests[-1][1]["range"] == "bytes=1500-"
    assert got.sha256 == twin.sha256
    assert cache(home) == [f"{NAME}@minari.hdf5"]


def test_killed_just_before_the_end_nothing_is_fetched_again(server, original, home, tmp_path):
    part = home / "data" / f".{NAME}@d4rl.hdf5.part"
    part.parent.mkdir(parents=True)
    fetch(server.root + ORIGINAL, part)
    shutil.copy(part, tmp_path)
    got = get(NAME)
    assert len(server.requests) == 1
    assert got.path.read_bytes() == original.body
    assert cache(home) == [f"{NAME}@d4rl.hdf5", f"{NAME}@d4rl.json"]


def test_a_server_that_knows_no_ranges_starts_from_zero(server, original, retry):
    server.next += [drops(3000), drops(None, ranges=False)]
    assert get(NAME, retry=retry).path.read_bytes() == original.body
    assert server.requests[1][1]["range"] == "bytes=3000-"
    assert server.sent == [3000, len(original.body)]


def test_a_file_that_changed_meanwhile_starts_from_zero(server, original, retry):
    newer = d4rl_file(make_log((50,), seed=8))

    def changed(handler):
        server.files[ORIGINAL] = (newer, {"ETag": '"two"'})
        serve(handler)

    server.next += [drops(3000), changed]
    assert get(NAME, retry=retry).path.read_bytes() == newer
    assert server.requests[1][1]["if-range"] == '"one"'


@pytest.mark.parametrize("answer", [
    {"ETag": '"two"', "Content_Range": "bytes 3000-{last}/{size}"},  # another file, though it was asked for this one
    {"ETag": '"one"', "Content_Range": "bytes 0-{last}/{size}"},  # another place
    {"ETag": '"one"', "Content_Range": "bytes 3000-{last}/999999"},  # another size
    {"ETag": '"one"'},
])  # fmt: skip
def test_a_rest_that_does_not_fit_is_not_taken(server, original, retry, answer):
    size = len(original.body)
    headers = {key: value.format(last=size - 1, size=size) for key, value in answer.items()}
    server.next += [drops(3000), says(206, b"x" * (size - 3000), **headers)]
    assert get(NAME, retry=retry).path.read_bytes() == original.body
    assert "range" not in server.requests[2][1]
    assert len(retry.waits) == 2


def test_a_rest_that_is_not_there_is_fetched_from_zero(server, original, retry):
    server.next += [drops(3000), says(416)]
    assert get(NAME, retry=retry).path.read_bytes() == original.body
    assert "range" not in server.requests[2][1]


@pytest.mark.parametrize("etag", [{}, {"ETag": 'W/"weak"'}])
def test_the_date_stands_in_for_a_strong_etag(server, original, retry, etag):
    asked = "Mon, 01 Jun 2020 10:00:00 GMT"
    server.files[ORIGINAL] = (original.body, {"Last_Modified": asked, **etag})
    server.next += [drops(3000)]
    assert get(NAME, retry=retry).sha256 == original.sha256
    assert server.requests[1][1]["if-range"] == asked


def test_without_a_sign_of_its_state_a_file_starts_from_zero(server, original, retry):
    server.files[ORIGINAL] = (original.body, {})
    server.next += [drops(3000)]
    assert get(NAME, retry=retry).sha256 == original.sha256
    assert "range" not in server.requests[1][1]


@pytest.mark.parametrize("spoil", [
    lambda part: part.with_name(f"{part.name}.json").unlink(),
    lambda part: part.with_name(f"{part.name}.json").write_text('{"url": 3'),
    lambda part: part.with_name(f"{part.name}.json").write_text("[]"),
    lambda part: part.write_bytes(b"x" * 100_000),
])  # fmt: skip
def test_a_part_of_unknown_origin_is_not_gone_on_with(server, original, home, spoil):
    part = home / "data" / f".{NAME}@d4rl.hdf5.part"
    part.parent.mkdir(parents=True)
    server.next += [drops(3000)]
    with pytest.raises(UserError, match="broke after 3,000 of"):
        fetch(server.root + ORIGINAL, part, retry=RetryPolicy(tries=1))
    spoil(part)
    assert get(NAME).path.read_bytes() == original.body
    assert "range" not in server.requests[-1][1]


def test_a_part_from_another_address_is_not_gone_on_with(server, original, home, monkeypatch):
    server.next += [drops(3000)]
    with pytest.raises(UserError, match="broke after 3,000 of"):
        get(NAME, retry=RetryPolicy(tries=1))
    server.files[ORIGINAL.replace("d4rl", "mirror")] = server.files[ORIGINAL]
    monkeypatch.setenv("DEADRECKON_D4RL_URL", f"{server.root}/mirror")
    assert get(NAME).sha256 == original.sha256
    assert "range" not in server.requests[-1][1]


def test_a_server_in_trouble_is_asked_again(server, original, retry):
    server.next += [says(500), says(503)]
    assert get(NAME, retry=retry).sha256 == original.sha256
    assert retry.waits == [1.0, 2.0]


def test_a_server_that_stays_in_trouble(server, home, retry):
    server.next += [says(503)] * 9
    left_alone(home, server, retry, ["the server answered 503 Service Unavailable, 3 times in a row", MAKES])
    assert len(server.requests) == 3


def test_no_answer_at_all(server, home, original):
    stop = threading.Event()
    server.next += [lambda handler: stop.wait(5)] * 2
    waits = []
    left_alone(home, server, RetryPolicy(2, 0.05, waits.append), ["no answer for 0.05 s, 2 times in a row", MAKES])
    stop.set()
    assert waits == [1.0]


def test_a_body_that_is_always_too_short(server, original, home, retry):
    server.next += [drops(3000, ranges=False)] * 9
    size = len(original.body)
    with pytest.raises(UserError) as caught:
        get(NAME, retry=retry)
    text = str(caught.value)
    assert f"broke after 3,000 of {size:,} bytes, 3 times in a row (3,000 bytes are kept; the same command continues" in text
    assert MAKES in text
    assert cache(home) == [f".{NAME}@d4rl.hdf5.part", f".{NAME}@d4rl.hdf5.part.json"]
    assert len(server.requests) == 3
    server.next.clear()
    assert get(NAME).sha256 == original.sha256
    assert server.sent[-1] == size - 3000


def test_as_long_as_bytes_come_it_is_not_given_up(server, original, retry):
    server.next += [drops(500)] * 12
    assert get(NAME, retry=retry).sha256 == original.sha256
    assert retry.waits == [1.0] * 12


def test_a_body_without_a_length(server, original, retry):
    server.next += [lambda handler: handler.send(200, original.body, length="none")]
    told = []
    assert get(NAME, retry=retry, progress=lambda *a: told.append(a)).sha256 == original.sha256
    assert told[-1] == (len(original.body), None)


# ---- checksums -------------------------------------------------------------------------------------------------------


def test_a_checksum_of_the_user(server, original, home, retry):
    words = f"expected sha256 {'0' * 64} (by the caller), got {original.sha256}; the file was removed"
    left_alone(home, server, retry, [words, server.root + ORIGINAL, MAKES], sha256="0" * 64)
    assert get(NAME, sha256=original.sha256).vouched == "the caller"


def test_a_checksum_of_the_catalogue(server, original, home, retry, monkeypatch):
    monkeypatch.setitem(ENTRIES, NAME, replace(entry(NAME), sha256="0" * 64))
    left_alone(home, server, retry, ["(by the catalogue), got"])
    monkeypatch.setitem(ENTRIES, NAME, replace(entry(NAME), sha256=original.sha256))
    assert get(NAME).vouched == "the catalogue"


def base64_of(algorithm, body):
    return base64.b64encode(hashlib.new(algorithm, body).digest()).decode()


@pytest.mark.parametrize(("header", "form", "algorithm"), [
    ("X-Linked-ETag", '"{hex}"', "sha256"),
    ("Digest", "md5=abc, SHA-256={base64}", "sha256"),
    ("Repr-Digest", "sha-256=:{base64}:", "sha256"),
    ("Content-MD5", "{base64}", "md5"),
])  # fmt: skip
def test_a_checksum_of_the_server(server, original, home, retry, header, form, algorithm):
    def stamp(body):
        value = form.format(hex=hashlib.new(algorithm, body).hexdigest(), base64=base64_of(algorithm, body))
        return {header.replace("-", "_"): value}

    body, headers = server.files[ORIGINAL]
    server.files[ORIGINAL] = (body, headers | stamp(b"other"))
    expected = hashlib.new(algorithm, b"other").hexdigest()
    left_alone(home, server, retry, [f"expected {algorithm} {expected} (by the server's {header}), got"])
    server.files[ORIGINAL] = (body, headers | stamp(body))
    assert get(NAME).vouched == f"the server's {header}"


def test_the_checksum_of_a_part_is_not_that_of_the_whole(server, original, retry):
    """Content-MD5 is of what is sent, so the rest's differs; the first answer's still counts."""
    body, headers = server.files[ORIGINAL]
    half = len(body) // 2

    def rest(handler):
        place = f"bytes {half}-{len(body) - 1}/{len(body)}"
        handler.send(206, body[half:], Content_Range=place, Content_MD5=base64_of("md5", body[half:]), **headers)

    server.files[ORIGINAL] = (body, headers | {"Content_MD5": base64_of("md5", body)})
    server.next += [drops(half), rest]
    assert get(NAME, retry=retry).vouched == "the server's Content-MD5"


@pytest.mark.parametrize(("header", "value"), [
    ("X-Linked-ETag", '"' + "a" * 40 + '"'),  # git's, of a small file
    ("Digest", "sha-256=abc"),
    ("Digest", "sha-512=abcd"),
    ("Repr-Digest", "sha-256=:abcd:"),
    ("Content-MD5", "none"),
])  # fmt: skip
def test_what_is_no_checksum_vouches_for_nothing(server, original, header, value):
    body, headers = server.files[ORIGINAL]
    server.files[ORIGINAL] = (body, headers | {header.replace("-", "_"): value})
    assert get(NAME).vouched is None


# ---- files that are none -----------------------------------------------------------------------------------------------


def test_a_web_page_does_not_replace_what_has_come(server, original, home, retry):
    page = says(200, b"<html>Pay first</html>", Content_Type="text/html; charset=utf-8")
    server.next += [page]
    left_alone(home, server, retry, [server.root + ORIGINAL, "a web page instead of the file", MAKES])
    server.next += [drops(3000), page]
    with pytest.raises(UserError, match="a web page"):
        get(NAME, retry=retry)
    assert get(NAME).sha256 == original.sha256
    assert server.requests[-1][1]["range"] == "bytes=3000-"


def test_files_that_are_no_logs(server, original, home, retry):
    empty = io.BytesIO()
    with h5py.File(empty, "w") as file:
        file["weights"] = np.ones(3)
    bad = {key: np.array(getattr(original.log, key)) for key in ("observations", "actions", "rewards")}
    bad["rewards"][7] = np.nan
    nan = io.BytesIO()
    with h5py.File(nan, "w") as file:
        for key, value in bad.items():
            file[key] = value
    for body, words in (
        (b"<!doctype html><title>Moved</title>", ["no hdf5 file, it begins with '<!doctype html>"]),
        (b"", ["no hdf5 file, it is empty"]),
        (original.body[: len(original.body) // 2], ["cannot be read as hdf5, it is damaged or cut short"]),
        (empty.getvalue(), [f"{ORIGINAL}: no column actions", "this one has weights"]),
        (nan.getvalue(), ["rewards", "row 7"]),
    ):
        server.next += [says(200, body)]
        left_alone(home, server, retry, [server.root + ORIGINAL, *words, MAKES])


def test_twins_that_are_none(server, twin, home, retry):
    main, about = f"{TWIN}main_data.hdf5", f"{TWIN}metadata.json"
    good = dict(server.files)
    for place, body, words in (
        (about, b"<html>", ["metadata.json", "is not valid JSON"]),
        (about, b"[1]", ["metadata.json", "not the metadata of a Minari data set"]),
        (about, json.dumps({**twin.about, "data_format": "arrow"}).encode(), ["is stored as arrow; hdf5 is needed"]),
        (about, json.dumps({**twin.about, "action_space": None}).encode(), ["names no observation_space and action_space"]),
        (about, json.dumps({**twin.about, "total_steps": 51}).encode(), ["it has 50 steps, but metadata.json says 51"]),
        (main, b"PK\x03\x04 and so on", ["main_data.hdf5", "no hdf5 file"]),
        (main, twin.main[:4000], ["main_data.hdf5", "damaged or cut short"]),
    ):
        server.files = good | {place: (body, {})}
        left_alone(home, server, retry, [*words, MAKES], source="minari")


# ---- the disk, and others ----------------------------------------------------------------------------------------------


def test_a_file_that_does_not_fit_is_not_begun(server, original, home, retry):
    with files_up_to(2000):
        left_alone(home, server, retry, [f"no room for {len(original.body):,} bytes in {home / 'data'}"])


def test_a_disk_that_fills_up_meanwhile(server, original, home, retry):
    server.next += [lambda handler: handler.send(200, original.body, length="none", ETag='"one"')]
    with files_up_to(2000), pytest.raises(UserError, match=r"^cannot write .*@d4rl.hdf5: .*\(the part that has arrived is"):
        get(NAME, retry=retry)
    assert cache(home) == [f".{NAME}@d4rl.hdf5.part", f".{NAME}@d4rl.hdf5.part.json"]
    assert get(NAME).path.read_bytes() == original.body
    assert server.requests[-1][1]["range"].startswith("bytes=")


def test_a_folder_that_cannot_be_made(server, tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setenv("DEADRECKON_HOME", str(tmp_path / "file"))
    with pytest.raises(UserError, match=r"^cannot write .*Not a directory"):
        get(NAME)


def test_two_at_once(server, original, home):
    tried = []

    def other(done, total):
        if not tried:
            with pytest.raises(UserError, match="another process is at work on .* already") as caught:
                get(NAME)
            tried.append(caught)

    assert get(NAME, progress=other).sha256 == original.sha256
    assert tried
    assert len(server.requests) == 1
    assert cache(home) == [f"{NAME}@d4rl.hdf5", f"{NAME}@d4rl.json"]


# ---- the command -------------------------------------------------------------------------------------------------------


def test_the_command(server, original, twin, home, capsys):
    data(["get", NAME, "--source", "d4rl"])
    out, err = capsys.readouterr()
    path = str(home / "data" / f"{NAME}@d4rl.hdf5")
    assert out == f"{path}\n"
    assert "downloading hopper-medium-v2 from d4rl: 0.0 MB of 0.0 MB" in err
    assert f"! no checksum is known for this file; its sha256 is {original.sha256}" in err
    data(["get", NAME, "--source", "d4rl", "--sha256", original.sha256])
    assert capsys.readouterr() == (f"{path}\n", f"! {NAME}@d4rl is there already; --force downloads it again\n")
    data(["get", NAME, "--source", "minari", "--sha256", twin.sha256])
    assert "!" not in capsys.readouterr().err
    data(["list"])
    lines = {line.split()[0]: line for line in capsys.readouterr().out.splitlines() if line}
    assert " d4rl, minari  gym_mujoco_v2/hopper_medium-v2.hdf5" in lines[NAME]
    assert "  -  " in lines["hopper-expert-v2"]
    write_hdf5(make_log(name=f"{NAME}@dr1"), cached_path(NAME))
    data(["list"])
    assert " dr1, d4rl, minari " in capsys.readouterr().out
    data(["info", f"{NAME}@d4rl"])
    assert f"{NAME}@d4rl" in capsys.readouterr().out
