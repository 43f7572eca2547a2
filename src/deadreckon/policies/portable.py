"""Policy files that need numpy alone: this module imports nothing else, so it can be copied to wherever actions are needed.

A file is an npz archive of float32 or float16 arrays and one JSON text, `policy.json`. Nothing is pickled. The JSON is a tree:
`{"kind": "EnvPolicy", "inner": {...}, "mean": array, ...}`, where an array is the string `"@name"` of an archive member.

    play = load("policy.npz")
    action = play(observation)

Policies that see pictures, numbers from 0 to 255, need `portable_pictures.py` beside this file. With the files `table_*.py`,
which need numpy alone too, rows of the log's table can be given:

    play.predict({"temp": 20.1, "mode": "auto"})
"""

import importlib
import json
from typing import Any

import numpy as np

FORMAT = 1
_ACTIVATIONS = {
    "relu": lambda x: np.maximum(x, 0.0),
    "gelu": lambda x: 0.5 * x * (1.0 + np.tanh(np.sqrt(2.0 / np.pi) * (x + 0.044715 * x**3))),
    "tanh": np.tanh,
    "swish": lambda x: x / (1.0 + np.exp(-x)),
    "softplus": lambda x: np.logaddexp(x, 0.0),
}
_LOG_STD = (-5.0, 2.0)
_LATENT_CLIP = 0.5
_ILLEGAL = np.float32(-1e9)
# Kinds of policy and their fields as older files name them: kind -> (kind, {field: field}).
RENAMED = {
    "Asking": ("DecisionTransformerPolicy", {"wanted": "target_return"}),
    "Deployed": ("EnvPolicy", {}),
    "Moved": ("PerturbedPolicy", {"mover": "perturbation", "reach": "max_perturbation"}),
    "Planner": ("Planner", {"chosen": "cem_elites", "ends": "termination", "iterations": "cem_iterations"}),
    "Sequence": ("DecisionTransformerNet", {}),
    "Supported": ("ThresholdedPolicy", {"share": "threshold"}),
}
_EDGE = 1.0 - 1e-6
MOST_SAMPLES = 100_000
CANDIDATES = 2**14  # that are compared at once, by networks that may be hundreds of units wide
_CHOOSING = ("Categorical", "GreedyActions", "ThresholdedPolicy")  # among discrete actions
_SAMPLERS = ("TanhGaussian", "VAEDecoder", "PerturbedPolicy", "OneStep")
_UNBOUNDED = ("Gaussian", "UnboundedDeterministic")
KINDS = (*_CHOOSING, *_SAMPLERS, *_UNBOUNDED, "Deterministic", "GreedyQ", "ClippedGaussian", "TanhMeanGaussian")


def read(path):
    """The JSON tree and the arrays of a policy file; ValueError in one line if it is none."""
    try:
        with open(path, "rb") as file:
            if file.read(4) == b"PK\x03\x04":
                file.seek(0)
                return tree_of(dict(np.load(file, allow_pickle=False)))
    except Exception as error:
        what = "cannot read {}: {}" if isinstance(error, OSError) else "{} is not a whole policy file: {}"
        raise ValueError(what.format(path, getattr(error, "strerror", None) or error)) from error
    raise ValueError(f"{path} is not a policy file (.npz)")


def tree_of(arrays):
    """The JSON tree of a policy file, and its other arrays, as float32; an error of any kind if it is none."""
    if "policy.json" not in arrays:
        raise ValueError("no policy.json in it")
    tree = json.loads(arrays.pop("policy.json").tobytes())
    if tree["format"] != FORMAT:
        raise ValueError(f"format {tree['format']}, this reader knows {FORMAT}")
    arrays = {name: a.astype(np.float32) if a.dtype == np.float16 else a for name, a in arrays.items()}
    return tree | {"policy": _with_noise(_with_present_names(tree["policy"]), arrays, "policy")}, arrays


def _with_present_names(node):
    """A policy's tree with the names that kinds and fields have now."""
    if isinstance(node, list):
        return [_with_present_names(part) for part in node]
    if not isinstance(node, dict):
        return node
    given = str(node.get("kind"))
    kind, fields = RENAMED.get(given, (given, {}))
    return {fields.get(name, name): _with_present_names(part) for name, part in node.items()} | {"kind": kind}


def _with_noise(node, arrays, name) -> Any:
    """A policy's tree whose candidates have noise, which older files have the number of alone."""
    if isinstance(node, list):
        return [_with_noise(part, arrays, f"{name}.{i}") for i, part in enumerate(node)]
    if not isinstance(node, dict):
        return node
    node = {field: _with_noise(part, arrays, f"{name}.{field}") for field, part in node.items()}
    if node["kind"] == "GreedyQ" and "samples" in node:
        if type(node["samples"]) is not int or not 1 <= node["samples"] <= MOST_SAMPLES:  # before they are drawn
            raise ValueError(f"{name}: samples must be from 1 to {MOST_SAMPLES:,}, got {node['samples']!r:.40}")
        noise = np.random.default_rng(0).standard_normal((node.pop("samples"), _noise_size(node["actor"], arrays)))
        node["noise"], arrays[f"{name}.noise"] = f"@{name}.noise", noise.astype(np.float32)
    return node


def _noise_size(actor, arrays):
    """Numbers of noise that an action takes."""
    if actor["kind"] == "OneStep":
        return arrays[actor["net"]["biases"][-1][1:]].shape[-1]
    net = actor["net"] if actor["kind"] == "TanhGaussian" else actor["vae"]["encoder"]
    return arrays[net["biases"][-1][1:]].shape[-1] // 2


def load(path):
    """A `NumpyPolicy` from a file; ValueError in one line if it is none, or of a kind that numpy alone does not play."""
    tree, arrays = read(path)
    if (kind := unknown_kind(tree["policy"])) is not None:
        raise ValueError(f"{path} is of the kind {kind}, which numpy alone does not play")
    return NumpyPolicy(tree, arrays)


def parts_of(inner):
    """The policies that one is made of."""
    return inner.get("members", [inner["member"]] if inner["kind"] in ("History", "Seeing") else [])


def unknown_kind(policy):
    """The first kind of policy in a file's tree that is not played here, or None."""
    inner = policy["inner"]
    parts = parts_of(inner)
    unknown = [] if parts or inner["kind"] in KINDS else [inner["kind"]]
    return next(iter([*unknown, *filter(None, map(unknown_kind, parts))]), None)


class NumpyPolicy:
    """Acts by numpy alone: `policy(observations)` gives greedy actions, and `policy.predict(rows)` takes rows of a table."""

    def __init__(self, tree, arrays):
        self.tree, self.arrays, self.log = tree["policy"], arrays, tree.get("meta", {}).get("log", {})
        self._predictor = None
        inner = self.tree["inner"]
        self.past: np.ndarray | None = None  # of a history: (n, numbers) without the next observation
        self.member = NumpyPolicy({"policy": inner["member"]}, arrays) if inner["kind"] == "History" else None
        self.members = [NumpyPolicy({"policy": member}, arrays) for member in inner.get("members", [])]
        self.rank = 3 if inner["kind"] == "Seeing" else 1  # axes of one observation
        self.behind = NumpyPolicy({"policy": inner["member"]}, arrays) if inner["kind"] == "Seeing" else None  # an encoder
        self.steps, self.action_size = (inner["steps"], inner["action_size"]) if self.member else (1, 0)
        self.which: np.ndarray | None = None  # of a mixture: (n,) who acts
        self.drawing = np.random.default_rng()  # what draws where no generator is given

    def __call__(self, observations, rng=None, greedy=True, first=None, legal=None):
        """Actions in the environment's bounds, if the policy knows these.

        `rng`: NumPy generator for draws; without one, a generator that continues from call to call. `first`: whether an episode
        begins, for one observation, or (n,) for a batch. A mixture needs it: it then draws which member acts, and keeps to it.
        Without it, an episode begins with the first call and wherever a batch has another size. A policy that acts on the last
        steps of an episode needs it in every call. `legal`: (actions,) or (n, actions) truth values, the end of the
        observations, where these lack it.
        """
        if self.behind is not None:
            if legal is not None:
                raise ValueError("legal actions are the end of flat observations; this policy takes images: leave legal out")
            return self._on_pictures(self.behind, np.asarray(observations), rng, greedy)
        sees = bool(self.members) and self.members[0].rank > 1  # a mixture's pictures stay as they are
        x = np.asarray(observations, None if sees else np.float32)
        x = x if legal is None else np.concatenate([x, np.asarray(legal, np.float32)], -1)
        if self.member is not None:
            return self._on_history(self.member, x, rng, greedy, first)
        if self.members:
            return self._mixed(x, rng, greedy, first)
        rng, kind = rng or self.drawing, self.tree["inner"]["kind"]
        batch, get = self._observed(x if x.ndim > 1 else x[None]), self._array
        if kind in _CHOOSING:
            action = self._chosen(self.tree["inner"], batch, rng, greedy)
            return action if x.ndim > 1 else action[0]
        action = self._pre(self.tree["inner"], batch, rng, greedy)
        bounded = self.tree["low"] is not None
        if kind in ("ClippedGaussian", "TanhMeanGaussian") or (kind == "Gaussian" and bounded):
            action = np.clip(action, -1.0, 1.0)
        elif kind not in _UNBOUNDED:
            action = np.tanh(action)
        if bounded:
            low, high = get(self.tree["low"]), get(self.tree["high"])
            action = low + 0.5 * (action + 1.0) * (high - low)
        return action.astype(np.float32) if x.ndim > 1 else action[0].astype(np.float32)

    def _on_pictures(self, behind, pictures, rng, greedy):
        """Actions on what an encoder makes of pictures."""
        actions = behind(self._features(pictures if pictures.ndim > 3 else pictures[None]), rng, greedy)
        return actions if pictures.ndim > 3 else actions[0]

    def _features(self, pictures):
        return _beside_this("portable_pictures").features(self.tree["inner"]["encoder"], self.arrays, pictures)

    def _mixed(self, x, rng, greedy, first):
        """Actions of the members whose turn it is."""
        rank = self.members[0].rank
        batch = x if x.ndim > rank else x[None]
        n = len(batch)
        begins = np.broadcast_to(np.asarray(False if first is None else first, bool), n)
        if self.which is None or len(self.which) != n:
            self.which, begins = np.zeros(n, int), np.ones(n, bool)
        drawn = (rng or self.drawing).integers(len(self.members), size=n)
        self.which = np.where(begins, drawn, self.which)
        actions = np.stack([member(batch, rng, greedy, begins) for member in self.members])[self.which, np.arange(n)]
        return actions if x.ndim > rank else actions[0]

    def _on_history(self, member, x, rng, greedy, first):
        """Actions on the last steps: observations with the actions between them, the newest last."""
        if first is None:
            steps = self.tree["inner"]["steps"]
            raise ValueError(f"this policy acts on the last {steps} steps: say first=True where an episode begins, else False")
        batch, inner = x if x.ndim > 1 else x[None], self.tree["inner"]
        begins = np.broadcast_to(np.asarray(first, bool), len(batch))
        if self.past is None or len(self.past) != len(batch):
            if not begins.all():
                raise ValueError("no episode is in progress: the first call, and one of another size, needs first=True")
            self.past = np.zeros((len(batch), 1), np.float32)
        none = np.zeros((len(batch), inner["action_size"]), np.float32)
        start = np.concatenate([batch, none] * (inner["steps"] - 1), 1)
        history = np.concatenate([np.where(begins[:, None], start, self.past), batch], 1)
        actions = member(history, rng, greedy)
        self.past = np.concatenate([history, self.done(actions)], 1)[:, batch.shape[1] + none.shape[1] :].astype(np.float32)
        return actions if x.ndim > 1 else actions[0]

    def done(self, actions):
        """Actions as a history has them: (n, action_size) float32 in [-1, 1], or one-hot."""
        of = self.tree["inner"]["member"]
        if of["low"] is None:
            return np.eye(self.action_size, dtype=np.float32)[np.asarray(actions)]
        low, high = self._array(of["low"]), self._array(of["high"])
        return np.clip(2.0 * (np.asarray(actions, np.float32) - low) / (high - low) - 1.0, -_EDGE, _EDGE).astype(np.float32)

    act = __call__  # as `table_predict` calls it, of a policy without memory

    def predict(self, rows, **options):
        """Actions by name in rows of a table; see `table_predict.Predictor.predict`, whose options it takes."""
        if self._predictor is None:
            self._predictor = _beside_this("table_predict").Predictor(self, self.log)
        return self._predictor.predict(rows, **options)

    def probs(self, observations):
        """(n, actions) probabilities of discrete actions at a batch of observations; None of continuous ones, and of a mixture
        or a policy on histories, whose actions depend on the episode."""
        if self.behind is not None:
            return self.behind.probs(self._features(np.asarray(observations)))
        if (node := self.tree["inner"])["kind"] not in _CHOOSING:
            return None
        scores = self._scores(node, self._observed(observations))
        if node["kind"] != "Categorical":
            return np.eye(scores.shape[-1], dtype=np.float32)[scores.argmax(-1)]
        likely = np.exp(scores - scores.max(-1, keepdims=True))
        return likely / likely.sum(-1, keepdims=True)

    def _observed(self, x):
        """A batch of observations in the coordinates of the networks."""
        inner, mean, std = self.tree["inner"], self.tree["mean"], self.tree["std"]
        if mean is not None:  # against which one number alone would be broadcast
            net = inner.get("net") or inner.get("critic") or {}
            check_size(x, self._array(mean).shape[-1], net.get("mask", 0) if inner["kind"] in _CHOOSING else 0)
        check_finite(x)
        return x if mean is None else (x - self._array(mean)) / self._array(std)

    def _array(self, reference):
        return self.arrays[reference[1:]]

    def _net(self, net, x):
        seen, last, mask = x, len(net["weights"]) - 1, net.get("mask", 0)
        check_size(x, self._array(net["weights"][0]).shape[-2], mask)
        for i, (w, b) in enumerate(zip(net["weights"], net["biases"])):
            x = x @ self._array(w) + self._array(b)
            if i < last and net["kind"] == "LayerNormMLP":
                x = self._normalised(net, x) if i == 0 else np.where(x > 0.0, x, np.expm1(np.minimum(x, 0.0)))
            elif i < last:
                x = _ACTIVATIONS[net["activation"]](x)
                if net.get("normalise", False):
                    x = _standardised(x, 1e-6)
        return np.where(seen[..., -mask:] > 0.5, x, _ILLEGAL) if mask else x

    def _normalised(self, net, x):
        """The first layer of a network that normalises it."""
        x = _standardised(x, 1e-5)
        return np.tanh(x * self._array(net["gain"]) + self._array(net["shift"]))

    def _chosen(self, node, x, rng, greedy):
        """Indices of discrete actions, (n,)."""
        scores = self._scores(node, x)
        if node["kind"] == "Categorical" and not greedy:
            scores = scores + rng.gumbel(size=scores.shape)
        return scores.argmax(-1).astype(np.int32)

    def _scores(self, node, x):
        """(n, actions) logits, or values; minus infinity of actions that are not likely enough."""
        if node["kind"] != "ThresholdedPolicy":
            return self._net(node["critic" if node["kind"] == "GreedyActions" else "net"], x)
        likely = self._net(node["behavior"]["net"], x)
        enough = likely >= likely.max(-1, keepdims=True) + np.log(self._array(node["threshold"]))
        return np.where(enough, self._net(node["critic"], x), -np.inf)

    def _pre(self, node, x, rng, greedy):
        """Actions before the tanh, (n, size)."""
        kind = node["kind"]
        if kind in ("Deterministic", "UnboundedDeterministic"):
            return self._net(node["net"], x)
        if kind == "GreedyQ":
            noise = self._array(node["noise"])
            drawn = (len(noise), len(x), noise.shape[-1])
            noise = noise[:, None] if greedy else rng.standard_normal(drawn, np.float32)
            noise, rows = np.broadcast_to(noise, drawn), max(CANDIDATES // len(noise), 1)
            starts = range(0, max(len(x), 1), rows)
            return np.concatenate([self._best(node, x[i : i + rows], noise[:, i : i + rows]) for i in starts])
        if kind in ("Gaussian", "ClippedGaussian", "TanhMeanGaussian"):
            if kind == "TanhMeanGaussian":
                mean, log_std = np.tanh(self._net(node["net"], x)), np.clip(self._array(node["log_std"]), *_LOG_STD)
            else:
                mean, log_std = np.split(self._net(node["net"], x), 2, -1)
            return mean if greedy else mean + np.exp(log_std) * rng.standard_normal(mean.shape, np.float32)
        if kind not in _SAMPLERS:
            raise ValueError(f"unknown kind of policy {kind!r}")
        shape = len(x), _noise_size(node, self.arrays)
        return self._from_noise(node, x, np.zeros(shape, np.float32) if greedy else rng.standard_normal(shape, np.float32))

    def _best(self, node, x, noise):
        """The best candidates by the critic, before the tanh, from standard normal noise (count, n, z)."""
        pre = self._from_noise(node["actor"], x, noise)
        q = self._net(node["critic"], _beside(x, np.tanh(pre)))[..., 0]
        return np.take_along_axis(pre, np.argmax(q, 0)[None, ..., None], 0)[0]

    def _from_noise(self, node, x, noise):
        """Actions before the tanh from standard normal noise, (*count, n or 1, z)."""
        kind = node["kind"]
        if kind == "TanhGaussian":
            mean, log_std = np.split(self._net(node["net"], x), 2, -1)
            return mean + np.exp(np.clip(log_std, *node.get("log_std", _LOG_STD))) * noise
        if kind == "VAEDecoder":
            return self._net(node["vae"]["decoder"], _beside(x, np.clip(noise, -_LATENT_CLIP, _LATENT_CLIP)))
        if kind == "PerturbedPolicy":
            action = np.tanh(self._from_noise({"kind": "VAEDecoder", "vae": node["vae"]}, x, noise))
            move = np.tanh(self._net(node["perturbation"], _beside(x, action)))
            return np.arctanh(np.clip(action + self._array(node["max_perturbation"]) * move, -_EDGE, _EDGE))
        if kind == "OneStep":
            return np.arctanh(np.clip(self._net(node["net"], _beside(x, noise)), -_EDGE, _EDGE))
        raise ValueError(f"unknown kind of policy {kind!r} among candidates")


def _beside_this(name):
    """A module that lies beside this one, in the package or elsewhere."""
    return importlib.import_module(f"{__package__}.{name}" if __package__ else name)


def check_finite(x):
    """ValueError where rows are not finite."""
    if not np.isfinite(x).all():
        raise ValueError(f"an observation is not finite in row {int(np.argmin(np.isfinite(x).all(-1)))}")


def check_size(x, size, mask):
    """ValueError where rows are not of `size` numbers, the last `mask` of which say which actions are legal."""
    parts = f", {size - mask} and which of the {mask} actions are legal (legal=)" if mask else ""
    if x.shape[-1] != size:
        raise ValueError(f"an observation has {x.shape[-1]} numbers, {size} are needed{parts}")
    if mask and not (some := (x[..., -mask:] > 0.5).any(-1)).all():
        raise ValueError(f"no action is legal in row {int(np.argmin(some))}; at least one must be")


def _standardised(x, epsilon):
    """Rows with mean zero and variance one."""
    x = x - x.mean(-1, keepdims=True)
    return x / np.sqrt(np.square(x).mean(-1, keepdims=True) + epsilon)


def _beside(x, many):
    """Each of `many` (*count, n or 1, size) behind its row of `x`."""
    lead = np.broadcast_shapes(x.shape[:-1], many.shape[:-1])
    return np.concatenate([np.broadcast_to(part, (*lead, part.shape[-1])) for part in (x, many)], -1)
