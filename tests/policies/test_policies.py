"""Policies: the numpy player equals the package, files are safe, black boxes fit, densities are right."""

import dataclasses
import json
import re
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.stats
from scipy import integrate

from deadreckon.data.normalizer import EDGE, Normalizer
from deadreckon.data.spec import Box, Discrete, Spec
from deadreckon.errors import UserError
from deadreckon.nets.mlp import MLP, Init
from deadreckon.nets.vae import VAE
from deadreckon.policies import BlackBoxPolicy, EnvPolicy, Policy, Step, candidates, portable, store
from deadreckon.policies.candidates import GreedyQ, OneStep, PerturbedPolicy, ThresholdedPolicy, VAEDecoder
from deadreckon.policies.deployed import Mixture
from deadreckon.policies.kinds import Categorical, ClippedGaussian, Deterministic, Gaussian, TanhGaussian, TanhMeanGaussian
from deadreckon.policies.planner import Planner
from deadreckon.policies.policy import KINDS, NormalizedPolicy
from deadreckon.policies.sequence import DecisionTransformerNet, DecisionTransformerPolicy
from deadreckon.runs.player import predictor

KEY = jax.random.key(0)
SPEC = Spec.empty((3,), Box((-1.0, -1.0), (1.0, 1.0)), "any")
VIEW = Normalizer(np.array([1.0, -1.0, 0.0]), np.array([2.0, 0.5, 1.0]), np.array([-2.0, 0.0]), np.array([2.0, 1.0]))


def make(kind):
    actor = MLP.create(3, (8, 8), 4, KEY)
    perturbed = PerturbedPolicy(VAE.create(3, 2, (8,), KEY), MLP.create(5, (8,), 2, KEY), jnp.asarray(0.3))
    inner = {
        "deterministic": Deterministic(MLP.create(3, (8,), 2, KEY, activation="swish")),
        "gaussian": TanhGaussian(actor),
        "clipped": ClippedGaussian.of(MLP.create(3, (8,), 2, KEY), jnp.zeros(2)),
        "tanh mean": TanhMeanGaussian.create(SPEC, (8,), KEY, 0.5),
        "unbounded": Gaussian.of(MLP.create(3, (8,), 2, KEY, init=Init(last=3.0)), jnp.zeros(2)),
        "vae": VAEDecoder(VAE.create(3, 2, (8,), KEY)),
        "perturbed": perturbed,
        "normalised": Deterministic(MLP.create(3, (8, 8), 2, KEY, normalise=True)),
        "greedy": GreedyQ.of(TanhGaussian(actor), MLP.create(5, (8,), 1, KEY), 5),
        "greedy of perturbed": GreedyQ.of(perturbed, MLP.create(5, (8,), 1, KEY), 5),
        "greedy of a VAE": GreedyQ.of(VAEDecoder(VAE.create(3, 2, (8,), KEY)), MLP.create(5, (8,), 1, KEY), 5),
        "one step": OneStep(MLP.create(5, (8,), 2, KEY)),
    }[kind]
    return EnvPolicy.of(inner, VIEW)


GREEDY = ["greedy", "greedy of perturbed", "greedy of a VAE"]
DRAWING = ["gaussian", "clipped", "tanh mean", "unbounded", "vae", "perturbed", "one step", *GREEDY]


@pytest.mark.parametrize("kind", ["deterministic", "normalised", *DRAWING])
def test_file_round_trip_and_numpy_player(kind, tmp_path):
    policy = make(kind)
    assert isinstance(policy, Policy)
    store.save(tmp_path / "p.npz", policy)
    x = np.random.default_rng(0).normal(size=(6, 3)).astype("f4")
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(x), policy(x))
    play = portable.load(tmp_path / "p.npz")
    np.testing.assert_allclose(play(x), policy(x), atol=1e-5)
    assert ((play(x) >= VIEW.low) & (play(x) <= VIEW.high)).all()


@pytest.mark.parametrize("kind", ["deterministic", *DRAWING])
@pytest.mark.parametrize("standardised", [False, True])
def test_observations_of_another_size_and_without_a_value_are_refused(kind, standardised, tmp_path):
    """One number would be broadcast against the means of all three."""
    policy = make(kind)
    policy = policy if standardised else dataclasses.replace(policy, mean=None, std=None)
    store.save(tmp_path / "p.npz", policy)
    play = portable.load(tmp_path / "p.npz")
    for wrong in (np.zeros(1), np.zeros((2, 4))):
        with pytest.raises(UserError, match=rf"an observation has {wrong.shape[-1]} numbers, 3 are needed$"):
            policy(wrong)
        with pytest.raises(UserError, match="numbers, 3 are needed$"):
            Mixture.of([policy, policy])(wrong)
        with pytest.raises(ValueError, match="numbers, 3 are needed$" if standardised else "numbers"):
            play(wrong)
    for gives in (policy, play):
        with pytest.raises(ValueError, match="an observation is not finite in row 1$"):
            gives(np.array([[0, 0, 0], [0, np.nan, 0]]))


@pytest.mark.parametrize("kind", GREEDY)
@pytest.mark.parametrize("greedy", [True, False])
def test_many_rows_are_compared_in_blocks(kind, greedy, tmp_path, monkeypatch):
    policy = make(kind)
    store.save(tmp_path / "p.npz", policy)
    play, x = portable.load(tmp_path / "p.npz"), np.random.default_rng(0).normal(size=(13, 3)).astype("f4")

    def actions():
        ours = policy.inner.actions(policy.view.observe(x), KEY, greedy=greedy, count=(2,) if not greedy else ())
        return np.asarray(ours), play(x, np.random.default_rng(0), greedy)

    whole = actions()
    for module in (candidates, portable):
        monkeypatch.setattr(module, "CANDIDATES", 24)  # of 5 a row
    sizes = []
    monkeypatch.setattr(portable.NumpyPolicy, "_best", lambda *given, best=portable.NumpyPolicy._best: (
        sizes.append(len(given[2])), best(*given))[1])  # fmt: skip
    for part, again in zip(whole, actions(), strict=True):
        np.testing.assert_allclose(again, part, atol=1e-6)
    assert sizes == [4, 4, 4, 1]


@pytest.mark.slow
@pytest.mark.parametrize("kind", DRAWING)
def test_draws_of_the_numpy_player_are_distributed_as_ours(kind, tmp_path):
    policy = make(kind)
    store.save(tmp_path / "p.npz", policy)
    many = np.repeat(np.random.default_rng(0).normal(size=(1, 3)).astype("f4"), 4000, 0)
    ours = np.asarray(policy.act(Step(jnp.asarray(many), None, None), (), jax.random.key(1), greedy=False)[0])
    theirs = portable.load(tmp_path / "p.npz")(many, np.random.default_rng(1), greedy=False)
    assert ours.std(0).min() > 0
    np.testing.assert_allclose(theirs.mean(0), ours.mean(0), atol=0.06)
    np.testing.assert_allclose(theirs.std(0), ours.std(0), atol=0.06)


def test_a_truncated_gaussian_has_all_its_mass_within_the_bounds():
    policy = TanhMeanGaussian.create(SPEC, (8,), KEY, 0.8)
    seen = jax.random.normal(KEY, (5, SPEC.observation_size))
    action = jnp.linspace(-EDGE, EDGE, 10)[:, None, None] * jnp.ones((5, SPEC.action_size))
    mean, std = np.asarray(jnp.tanh(policy.net(seen)), float), 0.8
    expected = scipy.stats.truncnorm.logpdf(action, (-1 - mean) / std, (1 - mean) / std, mean, std).sum(-1)
    np.testing.assert_allclose(policy.log_truncated(seen, action), expected, rtol=1e-4, atol=1e-4)
    assert np.isfinite(policy.log_truncated(seen, jnp.sign(action))).all()  # where a tanh has been rounded to a bound


def test_a_gaussian_around_a_tanh_has_the_likelihood_of_actions_and_the_density_of_what_acts():
    """Against numpy: what imitation maximises has no bounds; of what acts each bound has all that lies beyond it."""
    policy = TanhMeanGaussian.create(SPEC, (8,), KEY, 0.5)
    policy = dataclasses.replace(policy, log_std=np.log(np.asarray([0.5, 0.1], np.float32)))

    @jax.jit
    def told(policy, seen, taken):
        drawn = policy.actions(seen[:1], KEY, greedy=False, count=(20_000,))
        greedy = policy.actions(seen, KEY, greedy=True)
        return policy.net(seen), greedy, policy.log_likelihood(seen, taken), policy.log_prob(seen, taken), drawn

    seen = np.random.default_rng(0).normal(size=(6, 3)).astype("f4")
    taken = np.array([[1, -1], [0.3, 0.2], [-1, 0.5], [0.9, 1], [0, 0], [1, 1]], "f4")
    taken = np.clip(taken, -EDGE, EDGE).astype("f4")  # as in batches
    net, greedy, log_likelihood, log_prob, drawn = told(policy, seen, taken)
    mean = np.tanh(np.asarray(net, float))
    np.testing.assert_allclose(greedy, mean, atol=1e-6)
    normal = scipy.stats.norm(mean, [0.5, 0.1])
    np.testing.assert_allclose(log_likelihood, normal.logpdf(taken).sum(1), rtol=1e-4)
    inside = np.abs(taken) < 0.99
    beyond = np.where(taken > 0, normal.logsf(1.0), normal.logcdf(-1.0))
    np.testing.assert_allclose(log_prob, np.where(inside, normal.logpdf(taken), beyond).sum(1), rtol=1e-4)
    drawn = np.asarray(drawn)[:, 0]
    np.testing.assert_allclose((drawn == 1.0).mean(0), normal.sf(1.0)[0], atol=0.01)


def test_files_whose_candidates_have_no_noise_are_read(tmp_path):
    """Files of 0.1.0's first months have the number of candidates alone, which were drawn anew at every call."""
    for kind in GREEDY:
        policy = make(kind)
        store.save(tmp_path / "now.npz", policy)
        with np.load(tmp_path / "now.npz") as file:
            arrays = {name: file[name] for name in file.files}
        tree = json.loads(arrays.pop("policy.json").tobytes())
        noise = arrays.pop(tree["policy"]["inner"].pop("noise")[1:])
        tree["policy"]["inner"]["samples"] = len(noise)
        np.savez(tmp_path / "old.npz", **{"policy.json": np.frombuffer(json.dumps(tree).encode(), np.uint8)}, **arrays)
        x = np.random.default_rng(0).normal(size=(6, 3)).astype("f4")
        np.testing.assert_array_equal(store.load(tmp_path / "old.npz")(x), policy(x))
        np.testing.assert_allclose(portable.load(tmp_path / "old.npz")(x), policy(x), atol=1e-5)


OLD = {now: (old, {new: before for before, new in fields.items()}) for old, (now, fields) in portable.RENAMED.items()}


def with_old_names(node):
    """A policy's tree as files of older versions have it."""
    if isinstance(node, list):
        return [with_old_names(part) for part in node]
    if not isinstance(node, dict):
        return node
    kind, fields = OLD.get(node["kind"], (node["kind"], {}))
    return {fields.get(name, name): with_old_names(part) for name, part in node.items()} | {"kind": kind}


PARTS = ("MLP", "VAE", "Transformer", "Block")  # whose names are what they were
PARTLY_RENAMED = ["gaussian", "perturbed", "greedy of perturbed", "thresholded", "planner", "mixture", "transformer"]


@pytest.mark.parametrize("kind", PARTLY_RENAMED)
def test_files_with_old_names_are_read(kind, tmp_path):
    net = MLP.create(3, (8,), 2, KEY)
    planner = Planner(net, jnp.zeros((2, 2)), jnp.zeros(3), jnp.ones(3), 1, "learned", 3, 4, 2, 1, 2, 0.1)
    choices = dataclasses.replace(VIEW, low=None, high=None)
    transformer = DecisionTransformerNet.create(SPEC, 1, 4, 1, KEY)
    policy = {
        "transformer": lambda: EnvPolicy.of(DecisionTransformerPolicy(transformer, jnp.ones(()), jnp.ones(()), 3), VIEW),
        "thresholded": lambda: EnvPolicy.of(ThresholdedPolicy(net, Categorical(net), jnp.asarray(0.3)), choices),
        "planner": lambda: EnvPolicy.of(planner, VIEW),
        "mixture": lambda: Mixture.of([make("perturbed"), make("gaussian")]),
    }.get(kind, lambda: make(kind))()
    store.save(tmp_path / "now.npz", policy)
    with np.load(tmp_path / "now.npz") as file:
        arrays = {name: file[name] for name in file.files}
    tree = json.loads(arrays.pop("policy.json").tobytes())
    old = tree | {"policy": with_old_names(tree["policy"])}
    assert {"Deployed"} <= set(re.findall(r'"kind": "(\w+)"', json.dumps(old))) <= {*portable.RENAMED, *KINDS, *PARTS}
    assert "EnvPolicy" not in json.dumps(old)
    if kind == "transformer":  # as files had it before these names were in `RENAMED`
        inner = old["policy"]["inner"]
        assert (inner["kind"], inner["net"]["kind"]) == ("Asking", "Sequence")
        assert "wanted" in inner
        assert "target_return" not in inner
    np.savez(tmp_path / "old.npz", **{"policy.json": np.frombuffer(json.dumps(old).encode(), np.uint8)}, **arrays)

    again = store.load(tmp_path / "old.npz")
    assert jax.tree.structure(again) == jax.tree.structure(policy)
    assert all(map(np.array_equal, jax.tree.leaves(again), jax.tree.leaves(policy)))
    if kind in ("perturbed", "thresholded"):
        x = np.random.default_rng(0).normal(size=(6, 3)).astype("f4")
        np.testing.assert_array_equal(portable.load(tmp_path / "old.npz")(x), portable.load(tmp_path / "now.npz")(x))


def test_a_file_tells_what_its_policy_was_taught(tmp_path):
    policy, x = make("gaussian"), np.zeros((4, 3), np.float32)
    ids = np.array([2**64 - 1, 0, 5], np.uint64)
    store.save(tmp_path / "p.npz", policy, {"agent": "bc"}, taught=ids)
    store.save(tmp_path / "half.npz", policy, half=True, taught=ids[:0])
    store.save(tmp_path / "old.npz", policy)
    np.testing.assert_array_equal(store.load_all(tmp_path / "p.npz").taught, ids)
    assert store.load_all(tmp_path / "p.npz").taught.dtype == np.uint64
    assert store.load_all(tmp_path / "half.npz").taught.size == 0  # known to be nothing
    assert store.load_all(tmp_path / "old.npz").taught is None
    assert store.meta(tmp_path / "p.npz") == {"agent": "bc"}
    np.testing.assert_array_equal(store.load(tmp_path / "p.npz")(x), policy(x))
    np.testing.assert_allclose(portable.load(tmp_path / "p.npz")(x), policy(x), atol=1e-5)
    with pytest.raises(UserError, match="no file"):
        store.load_all(tmp_path / "none.npz")


def constant(value, size=2):
    """Acts the same always: the bias alone counts."""
    net = MLP((jnp.zeros((3, size)),), (jnp.full(size, value),), "relu")
    return EnvPolicy.of(Deterministic(net), Normalizer(None, None, -np.ones(size), np.ones(size)))


VALUES = np.array([-1.0, 0.0, 2.0])


def episodes(act, lengths=(7, 12), n=300):
    """(steps, n) which of the constant policies acted, episodes of these lengths in turn."""
    first = np.ones(n, bool)
    age, length = np.zeros(n, int), np.resize(lengths, n)
    out, begun = [], []
    for t in range(40):
        actions = act(np.zeros((n, 3), np.float32), first, t)
        assert (actions[:, 0] == actions[:, 1]).all()
        out.append(np.abs(actions[:, :1] - np.tanh(VALUES)).argmin(1))
        begun.append(first)
        age += 1
        first = age == length
        age[first] = 0
    return np.array(out), np.array(begun)


@pytest.mark.slow
@pytest.mark.parametrize("player", [False, True])
@pytest.mark.parametrize("greedy", [False, True])
def test_a_mixture_draws_at_the_beginning_of_an_episode_and_keeps_to_it(player, greedy, tmp_path):
    mixture = Mixture.of([constant(value) for value in VALUES])
    assert isinstance(mixture, Policy)
    store.save(tmp_path / "m.npz", mixture, taught=np.arange(3, dtype=np.uint64))
    carry = [mixture.start(300)]

    def ours(x, first, t):
        step = Step(jnp.asarray(x), jnp.zeros(len(x)), jnp.asarray(first))
        actions, carry[0] = mixture.act(step, carry[0], jax.random.key(t), greedy=greedy)
        return np.asarray(actions)

    play = portable.load(tmp_path / "m.npz")
    play.drawing = np.random.default_rng(0)
    who, begun = episodes((lambda x, first, t: play(x, first=first, greedy=greedy)) if player else ours)
    assert (who[1:] == who[:-1])[~begun[1:]].all()
    drawn = who[begun]
    # Three chances alike: 1500 draws are within five standard errors of a third.
    np.testing.assert_allclose(np.bincount(drawn, minlength=3) / len(drawn), 1 / 3, atol=0.06)
    # An episode's draw says nothing of the next one's.
    again = who[1:][begun[1:]] == who[:-1][begun[1:]]
    assert abs(again.mean() - 1 / 3) < 0.08


def test_a_mixtures_members_keep_their_coordinates_and_its_file_comes_back(tmp_path):
    other = Normalizer(np.zeros(3), np.ones(3), np.array([-9.1, -9.1], "f4"), np.array([9.1, 9.1], "f4"))
    members = [make("gaussian"), EnvPolicy.of(Deterministic(MLP.create(3, (8,), 2, KEY)), other)]
    mixture = Mixture.of(members)
    for half in (False, True):
        store.save(tmp_path / "m.npz", mixture, half=half)
        again = store.load(tmp_path / "m.npz")
        np.testing.assert_array_equal(again.inner.members[1].high, other.high)
        np.testing.assert_array_equal(again.inner.members[0].std, VIEW.std)
    store.save(tmp_path / "m.npz", mixture)
    x = np.random.default_rng(0).normal(size=(50, 3)).astype("f4")
    np.testing.assert_array_equal(store.load(tmp_path / "m.npz")(x), mixture(x))
    play = portable.load(tmp_path / "m.npz")
    play.drawing = np.random.default_rng(0)
    for acts in (mixture(x), play(x)):
        fits = np.array([np.isclose(acts, member(x), atol=1e-5).all(1) for member in members])
        assert fits.any(0).all()
        assert fits.sum(1).min() > 10
    one = play(x[0])
    assert one.shape == (2,)
    np.testing.assert_array_equal(play(x[0]), one)  # the same episode
    assert len({play(x[0], first=True).tobytes() for _ in range(20)}) == 2
    with pytest.raises(UserError, match="a Mixture policy has no log-probabilities"):
        mixture.log_prob(x, np.zeros((50, 2)))
    assert mixture.action_probs is None


@pytest.mark.slow
def test_a_mixture_of_choices_tells_the_chances_of_its_first(tmp_path):
    plain = Normalizer(None, None, None, None)
    members = [EnvPolicy.of(Categorical(MLP.create(3, (8,), 4, key)), plain) for key in jax.random.split(KEY)]
    mixture, x = Mixture.of(members), np.random.default_rng(0).normal(size=(2, 3)).astype("f4")
    told = mixture.action_probs(x)
    np.testing.assert_allclose(told, (members[0].action_probs(x) + members[1].action_probs(x)) / 2, rtol=1e-6)
    many = np.repeat(x[:1], 20_000, 0)
    step = Step(jnp.asarray(many), jnp.zeros(len(many)), jnp.ones(len(many), bool))
    drawn, _ = mixture.act(step, mixture.start(len(many)), KEY, greedy=False)
    np.testing.assert_allclose(np.bincount(np.asarray(drawn), minlength=4) / len(many), told[0], atol=0.02)
    store.save(tmp_path / "m.npz", mixture)
    played = portable.load(tmp_path / "m.npz")(many, np.random.default_rng(1), greedy=False)
    np.testing.assert_allclose(np.bincount(played, minlength=4) / len(many), told[0], atol=0.02)


def test_player_needs_numpy_alone(tmp_path):
    store.save(tmp_path / "p.npz", make("gaussian"))
    code = (
        "import sys\n"
        "for name in ('jax', 'equinox', 'scipy', 'gymnasium'): sys.modules[name] = None\n"
        "from deadreckon.policies.portable import load\n"
        f"print(load({str(tmp_path / 'p.npz')!r})([[0.0, 0.0, 0.0]]).tolist())"
    )
    out = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    np.testing.assert_allclose(json.loads(out), make("gaussian")(np.zeros((1, 3))), atol=1e-6)


@pytest.mark.slow
def test_density_over_environment_actions_integrates_to_one():
    net = MLP.create(1, (4,), 2, KEY)
    policy = EnvPolicy.of(TanhGaussian(net), Normalizer(None, None, np.array([-3.0]), np.array([1.0])))
    f = lambda a: float(jnp.exp(policy.log_prob(np.zeros((1, 1)), np.array([[a]], "f4")))[0])  # noqa: E731
    total, _ = integrate.quad(f, -2.9995, 0.9995, limit=50, epsabs=1e-3, epsrel=1e-3)
    assert abs(total - 1) < 5e-3
    with pytest.raises(UserError, match="no log-probabilities"):
        make("vae").log_prob(np.zeros((1, 3)), np.zeros((1, 2)))


def test_black_box_gets_numpy_and_a_generator():
    policy = BlackBoxPolicy(lambda obs, rng: rng.uniform(-1, 1, (len(obs), 2)))
    assert isinstance(policy, Policy)
    assert policy(np.zeros(3)).shape == (2,)
    np.testing.assert_array_equal(policy(np.zeros((4, 3))), policy(np.zeros((4, 3))))
    with pytest.raises(UserError, match="gave 1 actions for 4"):
        BlackBoxPolicy(lambda obs, rng: np.zeros((1, 2)))(np.zeros((4, 3)))


@pytest.mark.parametrize("damage", ["text", "truncated", "kind", "pickle", "missing"])
def test_broken_files_are_told_in_one_line(damage, tmp_path):
    path = tmp_path / "p.npz"
    store.save(path, make("gaussian"))
    if damage == "text":
        path.write_text("hello")
    elif damage == "truncated":
        path.write_bytes(path.read_bytes()[:300])
    elif damage == "kind":
        tree, arrays = portable.read(path)
        tree["policy"]["inner"]["kind"] = "os.system"
        np.savez(path, **{"policy.json": np.frombuffer(json.dumps(tree).encode(), np.uint8)}, **arrays)
    elif damage == "pickle":
        np.savez(path, **{"policy.json": np.array([{"a": 1}], object)})
    else:
        path.unlink()
    with pytest.raises(UserError) as error:
        store.load(path)
    assert "\n" not in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.parametrize("content", [b"a,b\n1,2\n", b"", b"\x89HDF\r\n\x1a\n", b"\x80\x04K\x01.", np.zeros(1).tobytes()])
def test_files_of_other_kinds_are_told_apart(content, tmp_path):
    path = tmp_path / "p.csv"
    path.write_bytes(content)
    with pytest.raises(ValueError, match=rf"^{path} is not a policy file \(\.npz\)$"):
        portable.read(path)
    np.savez(tmp_path / "log.npz", observations=np.zeros(1))
    with pytest.raises(ValueError, match=r"not a whole policy file: no policy.json in it"):
        portable.read(tmp_path / "log.npz")


def test_a_kind_of_policy_of_ones_own_is_saved_and_read_and_takes_no_name_that_there_is(tmp_path):
    class Constant(NormalizedPolicy):
        level: jnp.ndarray

        def pre_actions(self, observation, key, *, greedy, count=()):
            return jnp.broadcast_to(self.level, (*count, len(observation), 1))

    policy = EnvPolicy(Constant(jnp.ones(1)), None, None, None, None)
    store.save(tmp_path / "p.npz", policy)
    found = store.load(tmp_path / "p.npz")
    assert type(found.inner) is Constant
    np.testing.assert_array_equal(found(np.zeros((2, 3))), policy(np.zeros((2, 3))))
    with pytest.raises(TypeError, match="deadreckon.policies.kinds has a kind of policy called Gaussian already"):
        type("Gaussian", (NormalizedPolicy,), {})
    assert KINDS["Gaussian"].__module__ == "deadreckon.policies.kinds"


def test_rows_without_the_legal_actions_or_without_any_are_refused(tmp_path):
    spec = Spec.empty((5,), Discrete(3, masked=True), "any")
    policy = EnvPolicy(Categorical.create(spec, (4,), KEY), None, None, None, None)
    store.save(tmp_path / "p.npz", policy)
    for play, error in ((policy, UserError), (portable.load(tmp_path / "p.npz"), ValueError)):
        assert play(np.zeros(2), legal=[False, True, False]) == 1
        with pytest.raises(error, match=r"an observation has 2 numbers, 5 are needed, 2 and which of the 3 actions are legal"):
            play(np.zeros(2))
        with pytest.raises(error, match="no action is legal in row 1; at least one must be"):
            play(np.zeros((2, 2)), legal=[[True, True, False], [False, False, False]])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda inner, arrays: inner.update(net="none"), r"inner.net must be of the kind MLP or of the kind Lay.*, got 'none'"),
        (lambda inner, arrays: inner["net"].update(activation="cube"), "activation must be |do not fit together.*cube"),
        (lambda inner, arrays: inner["net"].update(weights=None), "weights"),
        (lambda inner, arrays: arrays.update({inner["net"]["weights"][0][1:]: np.zeros((5, 7), "f4")}), "do not fit together"),
        (lambda inner, arrays: inner["net"]["weights"].pop(), "do not fit together|is damaged"),
    ],
)  # fmt: skip
def test_a_policy_that_could_not_act_is_refused_when_it_is_loaded(tmp_path, change, words):
    net = MLP.create(3, (4,), 2, jax.random.key(0))
    store.save(tmp_path / "p.npz", EnvPolicy(Deterministic(net), jnp.zeros(3), jnp.ones(3), -jnp.ones(2), jnp.ones(2)))
    with np.load(tmp_path / "p.npz") as file:
        arrays = dict(file)
    tree = json.loads(arrays.pop("policy.json").tobytes())
    change(tree["policy"]["inner"], arrays)
    np.savez(tmp_path / "p.npz", **arrays, **{"policy.json": np.frombuffer(json.dumps(tree).encode(), np.uint8)})
    with pytest.raises(UserError, match=words):
        store.load(tmp_path / "p.npz")
    with pytest.raises(UserError):
        predictor(tmp_path / "p.npz")
