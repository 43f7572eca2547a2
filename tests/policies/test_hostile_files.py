"""Policy files from elsewhere that say of their log what no log has, or another thing than their networks."""

import copy
import json

import jax
import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.nets.encoder import Encoder
from deadreckon.nets.mlp import MLP
from deadreckon.policies import store
from deadreckon.policies.deployed import EnvPolicy, Seeing
from deadreckon.policies.kinds import Deterministic
from deadreckon.policies.loaded import load_policy
from deadreckon.runs.player import predictor

COLUMNS = {
    "x": {"role": "observation", "kind": "number"}, "m": {"role": "observation", "kind": "category", "levels": ["a", "b"]},
    "act": {"role": "action", "kind": "category", "levels": ["u", "v"]},
}  # fmt: skip
LOG = {
    "extra": {"schema": {"columns": COLUMNS}, "held": {}, "action_levels": ["u", "v"]},
    "action_space": {"kind": "Discrete", "n": 2}, "observation_shape": [3],
}  # fmt: skip
MOVES = {"role": "action", "kind": "number", "low": -1.0, "high": 1.0}
ROW = {"x": 1.0, "m": "a"}
GONE = object()


def changed(place: str, value) -> dict:
    """LOG with another value at a place, such as extra.schema."""
    log = copy.deepcopy(LOG)
    *above, last = place.split(".")
    within = log
    for key in above:
        within = within[key]
    if value is GONE:
        del within[last]
    else:
        within[last] = value
    return log


def file(path, log, outputs: int = 2, inner: str = "Categorical"):
    net = {"kind": "MLP", "weights": ["@w"], "biases": ["@b"], "activation": "relu", "normalise": False, "mask": 0}
    policy = {"kind": "EnvPolicy", "inner": {"kind": inner, "net": net}, "mean": None, "std": None, "low": None, "high": None}
    tree = {"format": 1, "meta": {"log": log}, "policy": policy}
    text = np.frombuffer(json.dumps(tree).encode(), np.uint8)
    np.savez(path, **{"policy.json": text}, w=np.ones((3, outputs), np.float32), b=np.arange(outputs, dtype=np.float32))
    return path


@pytest.mark.parametrize("rows", [2, 3, 4])
def test_a_layer_that_fits_one_number_of_observations_alone_is_refused(tmp_path, rows):
    path = file(tmp_path / "policy.npz", LOG)
    arrays = dict(np.load(path)) | {"b": np.zeros((rows, 2), np.float32)}
    np.savez(path, **arrays)
    for load in (predictor, load_policy):
        with pytest.raises(UserError, match="do not fit together|cannot be read as a policy file"):  # tests check shapes, too
            load(path)


@pytest.mark.parametrize("meta", [{}, {"meta": {}}, {"meta": {"log": None}}], ids=["none", "empty", "no log"])
def test_a_file_that_says_nothing_of_its_log_is_played(tmp_path, meta):
    path = file(tmp_path / "policy.npz", LOG)
    arrays = dict(np.load(path))
    tree = json.loads(arrays["policy.json"].tobytes())
    del tree["meta"]
    np.savez(path, **arrays | {"policy.json": np.frombuffer(json.dumps(tree | meta).encode(), np.uint8)})
    assert store.meta(path).get("log", {}) == {}
    load_policy(path)


def test_a_network_without_layers_is_refused(tmp_path):
    path = file(tmp_path / "policy.npz", LOG)
    arrays = dict(np.load(path))
    tree = json.loads(arrays["policy.json"].tobytes())
    tree["policy"]["inner"]["net"] |= {"weights": [], "biases": []}
    np.savez(path, **arrays | {"policy.json": np.frombuffer(json.dumps(tree).encode(), np.uint8)})
    for load in (predictor, load_policy):
        with pytest.raises(UserError, match=r"policy\.npz: "):
            load(path)


def test_the_file_itself_is_played(tmp_path):
    path = file(tmp_path / "policy.npz", LOG)
    assert predictor(path).predict(ROW) == load_policy(path).predict(ROW) == "v"


@pytest.mark.parametrize(
    ("place", "value", "words"),
    [
        ("extra", 5, "meta.log.extra must be an object or null, got 5"),
        ("extra.schema", [1], "meta.log.extra.schema must be an object or null"),
        ("extra.schema.columns", [1], "meta.log.extra.schema.columns must be an object"),
        ("extra.schema.columns.x", "s", r"columns\['x'\] must be an object, got 's'"),
        ("extra.schema.columns.x", {}, r"columns\['x'\] lacks role"),
        ("extra.schema.columns.x.role", ["action"], r"columns\['x'\].role must be"),
        ("extra.schema.columns.x.low", "a", r"columns\['x'\].low must be a number or null, got 'a'"),
        ("extra.schema.columns.x.why", 5, "column x: unknown entry 'why'"),
        ("extra.schema.columns.m.levels", GONE, "column m: a category that is observed needs levels"),
        ("extra.schema.columns.m.levels", 5, r"columns\['m'\].levels must be a list"),
        ("extra.schema.columns.m.levels", [[[1]], {}], r"columns\['m'\].levels\[0\] must be"),
        ("extra.schema.columns.act.unit", 5, r"columns\['act'\].unit must be a text, got 5"),
        ("extra.held", [1], "meta.log.extra.held must be an object or null"),
        ("extra.held", {"x": [1]}, r"meta.log.extra.held\['x'\] must be an object"),
        ("extra.held", {"x": {"mean": "abc"}}, r"meta.log.extra.held\['x'\].mean must be a number, got 'abc'"),
        ("extra.action_levels", 5, "meta.log.extra.action_levels must be a list"),
        ("action_space", [1], "meta.log.action_space must be an object or null"),
        ("action_space.n", "x", "meta.log.action_space.n must be a whole number, got 'x'"),
        ("action_space.n", 2.5, "meta.log.action_space.n must be a whole number, got 2.5"),
        ("action_space.n", -5, "meta.log.action_space.n must be a whole number from 1"),
        ("action_space.n", 10**9, "meta.log.action_space.n must be a whole number from 1"),
        ("action_space.n", GONE, "meta.log.action_space.n must be a whole number from 1"),
        ("observation_shape", 5, "meta.log.observation_shape must be a list"),
        ("observation_shape", ["a"], r"meta.log.observation_shape\[0\] must be a whole number"),
        ("observation_shape", [-3], "meta.log.observation_shape must be of up to"),
        ("observation_shape", [10**9], "meta.log.observation_shape must be of up to"),
    ],
)
def test_another_shape_is_refused(place, value, words, tmp_path):
    path = file(tmp_path / "policy.npz", changed(place, value))
    for reader in (predictor, load_policy):
        with pytest.raises(UserError, match=f"policy.npz: .*{words}"):
            reader(path)


LEGAL = {"role": "legal", "kind": "flag"}
OF_MOVES = changed("extra.schema.columns.act", MOVES) | {"action_space": None}
del OF_MOVES["extra"]["action_levels"]


@pytest.mark.parametrize(
    ("log", "inner", "words"),
    [
        (changed("extra.schema.columns.m.levels", ["a", "b", "c"]), "Categorical", "the columns of its schema make 4 numbers"),
        (changed("extra.schema.columns.x.marked", True), "Categorical", "the columns of its schema make 4 numbers"),
        (LOG, "Deterministic", "it acts by 2 numbers, and its log has 2 discrete actions"),
        (OF_MOVES, "Deterministic", "it acts by 2 numbers, and its log has 1 columns of continuous actions"),
        ({"observation_shape": [7]}, "Categorical", "cannot be read as a policy file"),
    ],
)
def test_a_policy_that_is_not_of_its_log_is_refused(log, inner, words, tmp_path):
    path = file(tmp_path / "policy.npz", log, inner=inner)
    for reader in (predictor, load_policy):
        with pytest.raises(UserError, match=f"policy.npz: .*{words}"):
            reader(path)


def test_a_network_of_more_actions_than_the_log_has_names_is_refused(tmp_path):
    path = file(tmp_path / "policy.npz", LOG, 5)
    with pytest.raises(UserError, match="policy.npz: .* acts by one of 5 actions, and its log has 2 discrete actions"):
        predictor(path)
    with pytest.raises(UserError, match="rows: the policy chose action 4, and its log has 2 actions"):
        load_policy(path).predict(ROW)


def test_a_column_of_a_legal_action_that_there_is_not_is_refused(tmp_path):
    log = changed("extra.schema.columns.L", LEGAL | {"of": "zz"}) | {"observation_shape": [5]}
    with pytest.raises(UserError, match="column L of its schema says where an action is legal that is none of its log's"):
        predictor(file(tmp_path / "policy.npz", log))


def test_pictures_are_taken_as_a_list_of_whole_numbers_too(tmp_path):
    encoder = Encoder.create("patches", (16, 16, 3), 8, jax.random.key(0))
    member = EnvPolicy(Deterministic(MLP.create(8, (4,), 2, jax.random.key(1))), None, None, None, None)
    policy = EnvPolicy(Seeing(encoder, member), None, None, None, None)
    store.save(tmp_path / "policy.npz", policy, {"log": {"observation_shape": [16, 16, 3]}})
    pictures = np.random.default_rng(0).integers(0, 256, (2, 16, 16, 3))
    for reader in (predictor, load_policy):
        found = reader(tmp_path / "policy.npz")
        for given in (pictures.astype(np.uint8), pictures.tolist()):
            np.testing.assert_allclose(found.predict(given), policy(pictures.astype(np.uint8)), atol=1e-6)
        for given in (pictures / 255, pictures * 2, pictures * np.nan, -pictures):
            with pytest.raises(UserError, match="rows: images hold whole numbers from 0 to 255"):
                found.predict(given)
