"""BEAR: Q-learning held to the support of the log (thesis 4.3, Algorithm 1; A.3, A.4; Kumar et al. 2019).

The actor maximises the critics' conservative value subject to E_s MMD(behaviour, policy) <= threshold (eq. 4.1), solved by
dual gradient descent. Where the thesis misprints, the right form is used; `docs/agents/bear.md` lists every difference.
"""

from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import jax
import jax.numpy as jnp
import optax
from jaxtyping import Array, Float

from deadreckon.agents.agent import Agent, backup, bellman_loss, create_critics
from deadreckon.data.batch import BatchSpec
from deadreckon.errors import UserError
from deadreckon.nets import distributions as dist
from deadreckon.nets.mlp import MLP, minimum, q_values
from deadreckon.nets.mmd import Estimate, Kernel, estimated, root
from deadreckon.nets.optim import apply_gradients, copy, init_opt, polyak_update
from deadreckon.nets.vae import VAE
from deadreckon.policies import behavior as models
from deadreckon.policies.candidates import GreedyQ
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.randomness import keys
from deadreckon.training.hyperparameters import Count, CountOrZero, NonNegative, Positive, Range, Sizes, UnitInterval, static
from deadreckon.training.later_fields import later
from deadreckon.training.learner import Metrics

WARM_STEPS, WARM_SHARE = 40_000, 0.2  # of the run, whichever is smaller (the D4RL version: 40,000 of 500,000 and more)


class State(NamedTuple):
    """Networks, their targets, the two multipliers' logarithms and all optimisers."""

    actor: MLP
    critics: MLP  # stacked: leading axis K
    behavior: MLP | VAE
    log_multiplier: Array
    log_temperature: Array  # used on the SAC base only
    target_actor: MLP
    target_critics: MLP
    opts: dict[str, optax.OptState]


class BEAR(Agent):
    """Bootstrapping error accumulation reduction, with every option that the thesis describes."""

    revision: ClassVar[int] = 2
    supports_images: ClassVar[bool] = True
    by_length: ClassVar[tuple[str, ...]] = ("warm_start",)
    other_names: ClassVar[dict[str, str]] = {"epsilon": "threshold", "lambda": "min_weight"}

    base: Literal["td3", "sac"] = static("td3")  # base algorithm: "td3" has no entropy (Algorithm 1), "sac" a bonus for it
    actor_lr: NonNegative = 1e-4  # learning rate of the actor (D4RL version)
    critic_lr: NonNegative = 3e-4  # learning rate of the critics (D4RL version)
    behavior_lr: NonNegative = 3e-4  # learning rate of the behaviour model (D4RL version)
    discount: UnitInterval = 0.99  # discount factor per step
    tau: UnitInterval = 0.005  # Polyak rate of all target networks, per update
    critics: Count = static(2)  # number of critics (K)
    min_weight: UnitInterval = 0.75  # weight of the smallest critic in the targets (lambda); the rest is of the largest
    target_samples: Count = static(10)  # actions sampled from the target actor (p), of which the best value is the target
    actor_value: Literal["min", "mean"] = static("min")  # minimum or mean over the critics; mean suits Walker2d (A.4)
    actor_samples: Count = static(1)  # actions per state that estimate the value in the actor loss (D4RL version: 1)
    behavior: models.Kind = static("gaussian")  # model of the log: "gaussian" (tanh-Gaussian, A.4) or "vae" (official code)
    behavior_hidden: Sizes | None = static(None)  # width of each hidden layer of that model; None: hidden, for a VAE 750,750
    constraint: Literal["mmd", "kl", "cross_entropy"] = static("mmd")  # distance to the log; KL forms need the gaussian model
    threshold: float | None = None  # threshold epsilon; None: 0.05 (thesis), for cross_entropy -2, for a relative MMD 0
    mmd_actions: Literal["before_tanh", "after_tanh"] = static("before_tanh")  # actions compared; before works better (A.4)
    mmd_reference: Literal["model", "logged"] = static("model")  # reference actions; those of the model work better (A.4)
    kernel: Kernel = static("laplacian")  # kernel of the MMD: "laplacian" works in all cases, "gaussian" on expert data (A.4)
    bandwidth: Positive = 20.0  # scale of the Laplacian kernel, or VARIANCE of the Gaussian one (20 in all settings, A.4)
    mixture: Annotated[tuple[float, ...], Range(gt=0)] = static((1.0, 10.0, 50.0))  # bandwidths of the mixture kernel (A.4)
    mmd_estimate: Estimate = static("biased")  # estimate: biased, of unbiased squares, or relative to the model's own
    policy_samples: Count = static(4)  # actions sampled from the policy in the MMD (m)
    behavior_samples: Count = static(4)  # actions sampled from the behaviour model in the MMD (n); 4 or 5 is best (4.4)
    dual: bool = static(True)  # whether the multiplier is adapted; otherwise it keeps its initial value (tuned, Figure A.5)
    multiplier: NonNegative = 1.0  # initial value of the Lagrange multiplier (alpha)
    multiplier_lr: NonNegative = 1e-3  # learning rate of the logarithm of the multiplier (A.4)
    multiplier_min: float = -5.0  # lower limit of the logarithm of the multiplier (A.4)
    multiplier_max: float = 10.0  # upper limit of the logarithm of the multiplier (A.4)
    dual_warm_start: bool = static(False)  # whether the multiplier is adapted in the warm start too (D4RL version)
    warm_start: CountOrZero | None = static(None)  # updates with the constraint alone; None: min(40,000, 20 % of the run)
    density_weighting: bool = static(False)  # whether Bellman errors are weighted by 1 / behaviour density (A.3, Figure A.6)
    density_clip: Annotated[float, Range(ge=1)] = 10.0  # largest such weight, in multiples of the mean over the batch
    temperature: Positive = 0.2  # initial entropy temperature, with base="sac"
    temperature_lr: NonNegative = 3e-4  # learning rate of the logarithm of the temperature, with base="sac"
    test_action: Literal["greedy_q", "actor"] = static("greedy_q")  # best of several by Q_1 (A.4), or the actor alone
    test_samples: Count = static(10)  # actions sampled for greedy_q (p, 4.3); the D4RL version takes 100
    hidden: Sizes = static((256, 256))  # width of each hidden layer
    batch_size: Count = static(256)  # batch size (transitions per update)
    standardise: bool = later(False)  # whether flat observations are standardised to mean 0 and standard deviation 1

    def resolve(self, spec, steps):
        """Fills in threshold, warm start and the behaviour model's width."""
        agent = super().resolve(spec, steps)
        name = "density_weighting" if self.constraint == "mmd" else f"constraint={self.constraint!r}"
        relative = (self.constraint, self.mmd_estimate) == ("mmd", "relative")
        draws = min(self.policy_samples, self.behavior_samples if self.mmd_reference == "model" else 1)
        refused = {
            f"{name} needs densities: behavior='gaussian', got {self.behavior!r}":
                (self.constraint != "mmd" or self.density_weighting) and self.behavior != "gaussian",
            "mmd_estimate='unbiased' needs policy_samples and behavior_samples of 2 or more, with mmd_reference='model'":
                (self.constraint, self.mmd_estimate) == ("mmd", "unbiased") and draws < 2,
            "mixture needs at least one bandwidth": (self.constraint, self.kernel, self.mixture) == ("mmd", "mixture", ()),
            f"actor_samples ({self.actor_samples}) must not exceed policy_samples ({self.policy_samples})":
                self.actor_samples > self.policy_samples,
            f"multiplier_min ({self.multiplier_min:g}) must not exceed multiplier_max ({self.multiplier_max:g})":
                self.multiplier_min > self.multiplier_max,
            f"threshold must be 0 or more, as no {self.constraint.upper()} is less, got {self.threshold}":
                self.constraint != "cross_entropy" and not relative and (self.threshold or 0.0) < 0.0,
        }  # fmt: skip
        if wrong := [what for what, is_so in refused.items() if is_so]:
            raise UserError(f"{type(self).__name__}.{wrong[0]}")
        threshold = -2.0 if self.constraint == "cross_entropy" else 0.0 if relative else 0.05
        width = (750, 750) if self.behavior == "vae" else self.hidden
        return agent.replace(
            threshold=threshold if self.threshold is None else self.threshold,
            warm_start=self.warm_start if self.warm_start is not None else min(WARM_STEPS, int(WARM_SHARE * steps)),
            behavior_hidden=width if self.behavior_hidden is None else self.behavior_hidden,
        )

    def needs(self, spec):
        """Transitions."""
        return BatchSpec(batch_size=self.batch_size, standardise=self.standardise)

    def init(self, spec, key) -> Any:
        """Fresh networks; targets are copies."""
        ka, kc, kb = keys(key, "actor", "critics", "behavior")
        actor = MLP.create(spec.observation_size, self.hidden, 2 * spec.action_size, ka)
        critics = create_critics(spec, self.hidden, self.critics, kc)
        model = models.create(self.behavior, spec, self.hidden if self.behavior_hidden is None else self.behavior_hidden, kb)
        # A multiplier of zero is the unconstrained actor; logarithms must stay finite to be of a healthy state.
        log_multiplier, log_temperature = (jnp.log(jnp.maximum(x, 1e-30)) for x in (self.multiplier, self.temperature))
        trained = dict(actor=actor, critics=critics, behavior=model, multiplier=log_multiplier, temperature=log_temperature)
        opts = {name: init_opt(part) for name, part in trained.items()}
        return State(actor, critics, model, log_multiplier, log_temperature, copy(actor), copy(critics), opts)

    def mix(self, q: Float[Array, "k *n b"]) -> Float[Array, "*n b"]:
        """lambda min_j Q_j + (1 - lambda) max_j Q_j (Algorithm 1, line 5)."""
        return self.min_weight * minimum(q) + (1.0 - self.min_weight) * q.max(0)

    def future(self, state, batch, key) -> Float[Array, "b"]:
        """The best mixed value over p actions of the target actor (Algorithm 1, lines 4-5)."""
        d = dist.gaussian_head(state.target_actor(batch.next_observation))
        pre = dist.sample(d, key, (self.target_samples,))
        value = self.mix(q_values(state.target_critics, batch.next_observation, jnp.tanh(pre)))
        entropy = jnp.exp(state.log_temperature) * dist.log_prob(d, pre) if self.base == "sac" else 0.0
        return (value - entropy).max(0)

    def bellman_weight(self, state, batch) -> Float[Array, "b"] | None:
        """1 / beta(a|s) by the fitted model, scaled to mean one over the batch, then clipped (A.3)."""
        if not self.density_weighting:
            return None
        log_density = dist.log_prob(dist.gaussian_head(state.behavior(batch.observation)), jnp.arctanh(batch.action))
        weight = jax.nn.softmax(-log_density) * len(log_density)
        return jax.lax.stop_gradient(jnp.minimum(weight, self.density_clip))

    def divergence(self, d: dist.Gaussian, pre, state, batch, key, k_copies) -> Float[Array, "b"]:
        """How far the policy `d`, with draws `pre` before the tanh, is from the model's draws and copies, for every state."""
        if self.constraint != "mmd":
            model = dist.gaussian_head(state.behavior(batch.observation))
            return dist.kl(d, model) if self.constraint == "kl" else -dist.log_prob(model, pre).mean(0)
        logged = jnp.arctanh(batch.action)[None]
        if self.mmd_reference == "model":
            logged = models.draws(state.behavior, batch.observation, key, self.behavior_samples)
        # Before the tanh by default: after it, gradients all but vanish where actions saturate (A.4).
        squash = (lambda x: x) if self.mmd_actions == "before_tanh" else jnp.tanh
        copies = models.draws(state.behavior, batch.observation, k_copies, self.policy_samples)
        x, y, own = (squash(each) for each in (pre, jax.lax.stop_gradient(logged), copies))
        return estimated(self.mmd_estimate, x, y, own, self.kernel, self.bandwidth, self.mixture)

    def constrained(self, divergence: Float[Array, "b"]) -> Float[Array, ""]:
        """What the threshold is for: the mean over states, of unbiased squares its root."""
        return root(divergence.mean()) if (self.constraint, self.mmd_estimate) == ("mmd", "unbiased") else divergence.mean()

    def actor_loss(self, actor, state, batch, step, key):
        """The Lagrangian of eq. 4.1, -E[Q] + alpha E_s[MMD], and means of divergence, log-probability and value."""
        k_policy, k_behavior, k_copies = keys(key, "policy", "behavior", "copies")
        d = dist.gaussian_head(actor(batch.observation))
        pre = dist.sample(d, k_policy, (self.policy_samples,))
        divergence = self.constrained(self.divergence(d, pre, state, batch, k_behavior, k_copies))
        drawn = pre[0] if self.actor_samples == 1 else pre[: self.actor_samples]
        q = q_values(state.critics, batch.observation, jnp.tanh(drawn))
        value = (minimum(q) if self.actor_value == "min" else q.mean(0)).mean()
        log_prob = dist.log_prob(d, drawn).mean() if self.base == "sac" else jnp.zeros(())
        objective = value - jnp.exp(state.log_temperature) * log_prob if self.base == "sac" else value
        return self.lagrangian(-objective, divergence, state, step), (divergence, log_prob, value)

    def lagrangian(self, loss, divergence, state, step):
        """`loss` plus the multiplier times the divergence; during the warm start the divergence alone."""
        warm = step < self.warm_start
        return jnp.where(warm, 0.0, loss) + jnp.where(warm, 1.0, jnp.exp(state.log_multiplier)) * divergence

    def dual_step(self, state, divergence, step):
        """Gradient ascent of alpha (E[MMD] - threshold) in log alpha, clipped (A.4); see `dual_warm_start`."""
        if not self.dual:
            return state.log_multiplier, state.opts["multiplier"]
        slope = -jnp.exp(state.log_multiplier) * (divergence - self.threshold)
        value, opt = apply_gradients(state.log_multiplier, slope, state.opts["multiplier"], self.multiplier_lr)
        value = jnp.clip(value, self.multiplier_min, self.multiplier_max)
        rested = state.log_multiplier, state.opts["multiplier"]
        return (value, opt) if self.dual_warm_start else self.after_warm_start((value, opt), rested, step)

    def after_warm_start(self, new, old, step):
        """`new` once the warm start is over; until then `old`, as the actor follows the constraint alone and cannot answer."""
        return jax.tree.map(lambda n, o: jnp.where(step < self.warm_start, o, n), new, old)

    def learn_values(self, state, batch, k_model, k_future) -> tuple[Any, Metrics]:
        """One step of the behaviour model and of the critics, whose weights use the model from before it."""
        opts = dict(state.opts)
        grads, model_metrics = jax.grad(models.loss, has_aux=True)(state.behavior, batch.observation, batch.action, k_model)
        model, opts["behavior"] = apply_gradients(state.behavior, grads, opts["behavior"], self.behavior_lr)
        target = backup(batch, self.discount, self.future(state, batch, k_future))
        grads, metrics = jax.grad(bellman_loss, has_aux=True)(state.critics, batch, target, self.bellman_weight(state, batch))
        critics, opts["critics"] = apply_gradients(state.critics, grads, opts["critics"], self.critic_lr)
        return state._replace(critics=critics, behavior=model, opts=opts), metrics | model_metrics

    def update(self, state, batch, *, step, key) -> tuple[Any, Metrics]:
        """Behaviour model, critics, actor, multipliers, targets (Algorithm 1)."""
        k_model, k_future, k_actor = keys(key, "behavior", "target", "actor_loss")
        state, metrics = self.learn_values(state, batch, k_model, k_future)
        opts = dict(state.opts)
        grad = jax.value_and_grad(self.actor_loss, has_aux=True)
        (loss, (divergence, log_prob, value)), grads = grad(state.actor, state, batch, step, k_actor)
        actor, opts["actor"] = apply_gradients(state.actor, grads, opts["actor"], self.actor_lr)
        log_alpha, opts["multiplier"] = self.dual_step(state, divergence, step)
        log_temperature = state.log_temperature
        if self.base == "sac":  # entropy held at minus the number of action dimensions, as in SAC
            slope = batch.action.shape[-1] - log_prob  # the entropy, -log_prob, less its target
            stepped = apply_gradients(log_temperature, slope, opts["temperature"], self.temperature_lr)
            log_temperature, opts["temperature"] = self.after_warm_start(stepped, (log_temperature, opts["temperature"]), step)
        targets = polyak_update((state.target_actor, state.target_critics), (actor, state.critics), self.tau)
        metrics |= {"actor_loss": loss, "actor_value": value, self.constraint: divergence, "multiplier": jnp.exp(log_alpha)}
        state = state._replace(actor=actor, target_actor=targets[0], target_critics=targets[1], opts=opts)
        return state._replace(log_multiplier=log_alpha, log_temperature=log_temperature), metrics

    def representation_loss(self, state, batch, *, step, key):
        """That of the critics."""
        target = backup(batch, self.discount, self.future(state, batch, keys(key, "target")[0]))
        return bellman_loss(state.critics, batch, target, self.bellman_weight(state, batch))[0]

    def policy(self, state):
        """The best of `test_samples` draws by Q_1, or the actor itself."""
        actor, first = TanhGaussian(state.actor), jax.tree.map(lambda w: w[0], state.critics)
        return actor if self.test_action == "actor" else GreedyQ.of(actor, first, self.test_samples)

    def q_value(self, state, observation, action):
        """The mixed value that the targets use."""
        return self.mix(q_values(state.critics, observation, action))
