"""What goes to the Hugging Face Hub and what is taken from there, against a client whose server is a folder."""

import hashlib
import shutil
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.files import read_json, write_json
from deadreckon.runs import hub


@pytest.fixture
def server(tmp_path, monkeypatch):
    """A folder for each repository, and what was asked for."""
    root = tmp_path / "server"
    asked = []

    class HfApi:
        def __init__(self, library_name):
            pass

        def create_repo(self, *, repo_id, repo_type, private, exist_ok):
            asked.append(("create", repo_id, repo_type, private))
            (root / repo_type / repo_id).mkdir(parents=True, exist_ok=exist_ok)

        def upload_folder(self, *, repo_id, repo_type, folder_path, commit_message):
            shutil.copytree(folder_path, root / repo_type / repo_id, dirs_exist_ok=True)

        def repo_info(self, *, repo_id, repo_type, revision, files_metadata):
            place = root / repo_type / repo_id
            if not place.is_dir():
                raise RuntimeError(f"404\nno {repo_id}")
            files = [path for path in sorted(place.rglob("*")) if path.is_file()]
            names = [SimpleNamespace(rfilename=p.relative_to(place).as_posix(), size=p.stat().st_size) for p in files]
            sha = hashlib.sha1(b"".join(p.read_bytes() for p in files)).hexdigest()
            return SimpleNamespace(sha=sha, siblings=names)

        def hf_hub_download(self, *, repo_id, repo_type, filename, revision, local_dir):
            asked.append(("download", filename))
            target = Path(local_dir) / filename
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(root / repo_type / repo_id / filename, target)

    module = ModuleType("huggingface_hub")
    module.HfApi = HfApi
    monkeypatch.setitem(sys.modules, "huggingface_hub", module)
    return SimpleNamespace(root=root, asked=asked)


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    return dr.Dataset.from_arrays(
        observations=rng.normal(size=(80, 3)), actions=rng.uniform(-1, 1, (80, 1)), rewards=rng.normal(size=80),
        timeouts=np.arange(80) % 8 == 7, name="mine",
    )  # fmt: skip


@pytest.fixture(scope="module")
def run(log, tmp_path_factory):
    agent = dr.agents.BC(hidden=(16, 16), batch_size=32)
    return dr.train(agent, log, steps=20, task=False, holdout=0, out=tmp_path_factory.mktemp("runs") / "r")


def test_a_log_comes_back_as_it_was(server, log, home):
    place = dr.push_to_hub(log, "me/mine")
    assert place == "datasets/me/mine"
    assert ("create", "me/mine", "dataset", True) in server.asked  # private unless asked otherwise
    again = dr.from_hub(place)
    assert again.fingerprint == log.fingerprint
    assert again.provenance.extra["hub"] == place
    downloads = [each for each in server.asked if each[0] == "download"]
    dr.from_hub(place)
    assert [each for each in server.asked if each[0] == "download"] == downloads  # this commit is here
    shutil.rmtree(server.root)
    commit = again.provenance.extra["commit"]
    assert dr.from_hub(place, revision=commit).fingerprint == log.fingerprint  # without the server
    card = read_json(home / "hub" / "datasets--me--mine" / commit / "deadreckon.json")
    assert card["kind"] == "log"


def test_a_commit_that_two_processes_fetch_is_there_once(server, log, home, monkeypatch):
    place = dr.push_to_hub(log, "me/mine")
    commit = hub._Hub("me/mine", True)("repo_info", revision=None, files_metadata=True).sha
    there = home / "hub" / "datasets--me--mine" / commit

    def faster(path, *given, rmtree=shutil.rmtree, **options):  # called when all files of a download are there
        if path.name == ".cache":
            shutil.copytree(path.parent, there)
        return rmtree(path, *given, **options)

    monkeypatch.setattr(hub.shutil, "rmtree", faster)
    assert dr.from_hub(place).fingerprint == log.fingerprint
    assert list(there.parent.iterdir()) == [there]


@pytest.mark.slow
def test_a_run_comes_back_with_policies_and_metrics_and_nothing_else(server, run):
    again = dr.from_hub(dr.push_to_hub(run, "me/bc", private=False))
    x = np.ones((2, 3), np.float32)
    np.testing.assert_array_equal(again.policy(x), run.policy(x))
    assert again.metrics.equals(run.metrics)
    assert ("create", "me/bc", "model", False) in server.asked
    there = {path.relative_to(server.root / "model/me/bc").parts[0] for path in (server.root / "model/me/bc").rglob("*")}
    files = {"README.md", "deadreckon.json", "run.json", "status.json", "episodes.npz"}
    assert there == files | {"policies", "metrics", "evaluations"}
    assert (run.path / "checkpoints").exists()


def test_a_policy_comes_back(server, run):
    again = dr.from_hub(dr.push_to_hub(run.policy, "me/policy"))
    x = np.ones((2, 3), np.float32)
    np.testing.assert_array_equal(again(x), run.policy(x))


def exchanged(place):
    (place / "policy.npz").write_bytes((place / "policy.npz").read_bytes()[:-1] + b"x")


def cut(place):
    (place / "policy.npz").write_bytes((place / "policy.npz").read_bytes()[:-1])


def listing(name, kind=None):
    def change(place):
        manifest = read_json(place / hub.MANIFEST)
        about = manifest["files"]["policy.npz"]
        write_json(place / hub.MANIFEST, manifest | {"files": {name: about}} | ({} if kind is None else {"kind": kind}))

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (exchanged, "policy.npz is damaged or was exchanged: its sha256 is"),
        (cut, r"policy.npz has \d+ bytes there, deadreckon.json says"),
        (listing("policy.pkl"), "lists 'policy.pkl', which a policy does not have; nothing was downloaded"),
        (listing("../policy.npz"), "lists '../policy.npz', which a policy"),
        (listing("a/../../b.npy", "log"), r"lists 'a/../../b.npy', which a log"),
        (listing("..\\b.npy", "log"), r"which a log does not have"),
        (listing("policies/seed0.npz", "run"), "policies/seed0.npz has None bytes there"),
        (listing("policy.npz", "code"), "is not one that push_to_hub writes"),
        (lambda place: (place / hub.MANIFEST).unlink(), "has no deadreckon.json: it was not uploaded by push_to_hub"),
    ],
)
def test_what_is_not_as_listed_is_refused_and_nothing_is_kept(change, message, server, run, home):
    place = dr.push_to_hub(run.policy, "me/policy")
    change(server.root / "model/me/policy")
    with pytest.raises(dr.UserError, match=message):
        dr.from_hub(place)
    assert not [path for path in home.rglob("*") if path.is_file()]


def test_errors_of_the_client_are_one_line(server):
    with pytest.raises(dr.UserError, match=r"^Hugging Face Hub, model me/nothing: RuntimeError: 404 no me/nothing$"):
        dr.from_hub("me/nothing")


def test_the_client_is_an_extra(log, monkeypatch):
    monkeypatch.setitem(sys.modules, "huggingface_hub", None)
    with pytest.raises(dr.UserError, match=r"install the extra hub"):
        dr.push_to_hub(log, "me/mine")


@pytest.mark.slow  # the client is of the group `slow`
@pytest.mark.parametrize("method", ["create_repo", "upload_folder", "repo_info", "hf_hub_download"])
def test_the_real_client_takes_what_it_is_given(method):
    """The fake above has the same keywords, of which this makes sure."""
    import inspect

    client = pytest.importorskip("huggingface_hub").HfApi(library_name="deadreckon")
    given = {
        "create_repo": {"private": True, "exist_ok": True},
        "upload_folder": {"folder_path": "x", "commit_message": "y"},
        "repo_info": {"revision": None, "files_metadata": True},
        "hf_hub_download": {"filename": "x", "revision": "y", "local_dir": "z"},
    }[method]
    inspect.signature(getattr(client, method)).bind(repo_id="a/b", repo_type="model", **given)
