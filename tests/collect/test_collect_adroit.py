"""The Adroit recipes, with the files of their authors, and how these files come."""

import functools
import http.server
import shutil
import threading

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.collect import adroit, generate, recipe, recipe_names
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.transfer import RetryPolicy
from deadreckon.errors import DivergedError, UserError
from deadreckon.policies import load_dapg
from deadreckon.policies.kinds import Gaussian
from deadreckon.tasks import task
from deadreckon.tasks.adroit import TASKS
from tests.data.small_logs import make_log

DOOR = task("door")


def test_a_clone_that_diverges_ends_the_collection(monkeypatch):
    log = make_log([30] * 10, terminal=(True,), finals=False, name="people")
    monkeypatch.setattr(adroit, "BC", lambda: dr.agents.BC(hidden=(8,), lr=1e30))
    monkeypatch.setattr(adroit, "UPDATES", 20)
    with pytest.raises(DivergedError, match="people: its clone: [a-z_]* was not finite at update [0-9]*$"):
        adroit.cloned_policy(log)


@pytest.fixture
def files(real_data, home):
    """The package's folder with the authors' files in it, as after a download."""
    folder = home / "data" / "adroit"
    folder.mkdir(parents=True)
    for path in (real_data / "adroit").glob("*.pickle"):
        shutil.copy(path, folder)
    return folder


@pytest.fixture
def mirror(real_data, tmp_path, monkeypatch):
    """A server with the authors' files, laid out as their repository is."""
    root = tmp_path / "dapg"
    (root / "policies").mkdir(parents=True)
    (root / "demonstrations").mkdir()
    for path in (real_data / "adroit").glob("*_dapg_policy.pickle"):
        shutil.copy(path, root / "policies" / path.name.replace("_dapg_policy", ""))
    shutil.copy(real_data / "adroit" / "door-v0_demos.pickle", root / "demonstrations")

    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args):
            pass

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Quiet, directory=root)) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.01,))
        thread.start()
        monkeypatch.setenv("no_proxy", "127.0.0.1")
        monkeypatch.setenv("DEADRECKON_DAPG_URL", f"http://127.0.0.1:{server.server_port}/")
        yield root
        server.shutdown()
        thread.join()


def test_every_log_has_its_recipe_and_table_d1s_rows():
    rows = {(t.name, kind): recipe(f"{t.name}-{kind}-v1").steps for t in TASKS for kind in ("human", "cloned", "expert")}
    assert [rows[name, "human"] for name in ("pen", "hammer", "door", "relocate")] == [5_000, 11_310, 6_729, 9_942]
    for (name, kind), steps in rows.items():
        assert kind == "human" or steps == (500_000 if name == "pen" else 1_000_000)
    assert sum(recipe(name).task in ("pen", "hammer", "door", "relocate") for name in recipe_names()) == 12
    assert dr.data.catalogue.entry("door-human-v1").minari == "D4RL/door/human-v2"


def test_the_human_log_is_that_of_the_authors(files):
    log = generate("door-human-v1")
    original = dr.read(files / "door-v0_demos.pickle")
    assert log.name == "door-human-v1@dr1"
    assert (len(log), log.episodes, log.dropped) == (6_729, 25, 25)
    np.testing.assert_array_equal(log.observations, original.observations)
    np.testing.assert_array_equal(log.rewards, original.rewards)
    np.testing.assert_array_equal(log.actions, np.clip(original.actions, -1, 1))
    assert np.abs(original.actions).max() > 1.2
    part = generate("door-human-v1", steps=350)  # into the second demonstration
    assert part.episodes == 2
    np.testing.assert_array_equal(part.final_known, [False, True])
    np.testing.assert_array_equal(part.final_observations[1], original.observations[350])
    for options in ({"steps": 6_730}, {"seed": 1}):
        with pytest.raises(UserError, match="people made 6,729 steps, once"):
            generate("door-human-v1", **options)


@pytest.fixture
def once(monkeypatch):
    """Downloads are tried once, without a pause."""
    retry = RetryPolicy(tries=1, timeout=5.0, sleep=lambda seconds: None)
    monkeypatch.setattr(adroit, "download_file", functools.partial(adroit.download_file, retry=retry))


def test_a_downloaded_copy_serves_where_the_authors_file_is_not(home, real_data, monkeypatch, once):
    monkeypatch.setenv("DEADRECKON_DAPG_URL", "http://127.0.0.1:9")  # where nobody listens
    log = dr.read(real_data / "adroit" / "door-v0_demos.pickle").select([4, 5])
    (home / "data").mkdir(parents=True)
    write_hdf5(log, home / "data" / "door-human-v1@minari.hdf5")
    with pytest.raises(UserError, match="door-v0_demos.pickle: .*can be put manually"):  # its rewards may be other ones
        adroit.human(DOOR)
    write_hdf5(log, home / "data" / "door-human-v1@d4rl.hdf5")
    found = adroit.human(DOOR)
    assert len(found) == len(log)
    assert found.provenance.extra["from"] == "door-human-v1@d4rl"
    write_hdf5(dr.Dataset.from_arrays(observations=np.zeros((3, 5)), actions=np.zeros((3, 28)), rewards=np.zeros(3)),
               home / "data" / "door-human-v1@d4rl.hdf5")  # fmt: skip
    with pytest.raises(UserError, match=r"has observations \(5,\), door has \(39,\)"):
        adroit.human(DOOR)


@pytest.mark.slow
@pytest.mark.parametrize("name", [t.name for t in TASKS])
def test_a_short_expert_log_of_every_task(files, name):
    found = task(name)
    log = generate(f"{name}-expert-v1", steps=30)
    assert log.observations.shape == (30, *found.observation_shape)
    assert not log.extras  # no log-densities: actions were clipped
    assert np.abs(log.actions).max() == 1.0
    assert log.provenance.extra["policies"] == ["DAPG's"]


def test_the_expert_opens_the_door(files):
    log = generate("door-expert-v1", steps=600)
    assert log.episodes == 3
    # D4RL's 100 is the mean return of this policy with these draws, 2,880.6.
    assert np.median(log.returns()) == pytest.approx(2880, rel=0.1)


def test_policies_are_read_without_running_them(real_data):
    policy = load_dapg(real_data / "adroit" / "pen-v0_dapg_policy.pickle")
    assert isinstance(policy.inner, Gaussian)
    assert [w.shape for w in policy.inner.net.weights] == [(45, 64), (64, 64), (64, 48)]
    assert policy(np.zeros((3, 45), np.float32)).shape == (3, 24)
    # One number by hand: the network's first layer, with observations shifted and scaled as the file says.
    from deadreckon.policies.torch_pickle import load_network

    found = load_network(real_data / "adroit" / "pen-v0_dapg_policy.pickle")
    model, seen = found["model"], np.random.default_rng(0).normal(size=45)
    out = (seen - model["in_shift"]) / (model["in_scale"] + 1e-8)
    for number, layer in enumerate(model["_modules"]["fc_layers"]["_modules"].values()):
        out = layer["_parameters"]["weight"] @ out + layer["_parameters"]["bias"]
        out = np.tanh(out) if number < 2 else out * model["out_scale"] + model["out_shift"]
    np.testing.assert_allclose(policy(seen), out, rtol=1e-4, atol=1e-5)


@pytest.mark.slow
def test_the_cloned_log_is_half_people_half_a_clone(files, monkeypatch):
    monkeypatch.setattr(adroit, "UPDATES", 20)
    log = generate("door-cloned-v1", steps=700, seed=3)
    people = adroit.human(DOOR)
    np.testing.assert_array_equal(log.actions[:350], people.actions[:350])
    np.testing.assert_array_equal(log.lengths, [300, 50, 200, 150])
    np.testing.assert_array_equal(log.final_known, [False, True, True, True])
    assert not np.array_equal(log.observations[350], people.observations[350])
    assert log.provenance.extra["rows"] == [350, 350]
    assert log.provenance.extra["from"] == "door-human"
    assert not log.extras


def test_people_are_repeated_until_half_is_full(files):
    people = adroit.human(DOOR)
    log = adroit._repeated(people, 7_000, "door-cloned-v1@dr1")
    np.testing.assert_array_equal(log.actions, np.concatenate([people.actions, people.actions[:271]]))
    np.testing.assert_array_equal(log.lengths, np.append(people.lengths, 271))
    np.testing.assert_array_equal(log.final_observations[-1], people.observations[271])
    np.testing.assert_array_equal(log.final_known, [False] * 25 + [True])
    assert log.timeouts[-1]
    assert adroit._repeated(people, 2 * 6_729, "two").episodes == 50


@pytest.mark.slow
def test_a_killed_clone_is_gone_on_with(files, monkeypatch, tmp_path):
    monkeypatch.setattr(adroit, "_CHUNK", 10)
    people = adroit.human(DOOR)
    monkeypatch.setattr(adroit, "UPDATES", 10)
    adroit.cloned_policy(people, folder=tmp_path / "b")  # as far as it got
    monkeypatch.setattr(adroit, "UPDATES", 30)
    resumed, whole = adroit.cloned_policy(people, folder=tmp_path / "b"), adroit.cloned_policy(people)
    seen = people.observations[:5]
    np.testing.assert_array_equal(resumed(seen), whole(seen))


def test_files_come_from_the_authors_once(mirror, home):
    place = adroit.policy_file(task("relocate"))
    assert place == home / "data" / "adroit" / "relocate-v0_dapg_policy.pickle"
    assert place.read_bytes() == (mirror / "policies" / "relocate-v0.pickle").read_bytes()
    (mirror / "policies" / "relocate-v0.pickle").unlink()
    assert adroit.policy_file(task("relocate")) == place
    assert len(adroit.human(DOOR)) == 6_729
    assert sorted(path.name for path in place.parent.iterdir()) == ["door-v0_demos.pickle", "relocate-v0_dapg_policy.pickle"]


def test_what_does_not_come_or_is_something_else_is_told_in_one_line(mirror, home, once):
    with pytest.raises(UserError, match=r"pen-v0_demos.pickle: .*404.*can be put manually at .*adroit/pen-v0_demos.pickle$"):
        adroit.human(task("pen"))
    shutil.copy(mirror / "demonstrations" / "door-v0_demos.pickle", mirror / "policies" / "door-v0.pickle")
    with pytest.raises(UserError, match=r"door-v0.pickle: no policy of DAPG in it.*the file was removed; .*manually"):
        adroit.policy_file(DOOR)
    assert not list((home / "data" / "adroit").glob("*.p*"))


@pytest.mark.slow
def test_experts_earn_the_reference_returns(files):
    """Each 100 of D4RL is its expert's return; ours, on today's physics, is within a tenth, hammer's within a fifth."""
    for found in TASKS:
        returns, reached = adroit.successes(found, load_dapg(adroit.policy_file(found)), episodes=200)
        assert found.reference.normalise(returns.mean()) == pytest.approx(100, abs=20 if found.name == "hammer" else 12)
        assert reached.mean() > (0.55 if found.name == "pen" else 0.8)
