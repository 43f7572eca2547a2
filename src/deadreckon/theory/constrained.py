"""Distribution-constrained backups (thesis 4.2, A.1, A.2): what a restricted set of policies costs, and what it saves.

A set Π of policies is an array `choices` (k, s, a): in every state any of the k distributions of actions may be followed, at
any time and independently of what is followed elsewhere. `support(behavior, epsilon)` is the thesis's Π_ε, `behavior[None]` the
singleton, and `everything(states, actions)` all policies (mixtures of choices never have a larger maximum).

Theorem 4.2.1 as printed does not hold. With Q_k = T^Π Q_{k-1} + e_k, |e_k| <= δ, d(s) = max_{π in Π} E_π δ and π_k greedy on
Q_k in Π:

- V^Π - V^{π_k} <= (I - γ P^{π_k})^{-1} (E_{π*} |Q^Π - Q_k| + E_{π_k} |Q_k - Q^Π|): the inserted terms E_{π*} Q_k - E_{π_k}
  Q_k are not positive, because π_k is greedy;
- E_π |Q_k - Q^Π| <= d + γ P^π d + γ² P^π P^{π'} d + ..., with any policies of Π;
- so E_ρ0 |V^Π - V^{π_k}| <= 2 Σ_m (m + 1) γ^m c(m) E_μ d = 2 C~ / (1 - γ)² E_μ d, with C~ = (1 - γ)² Σ_{m >= 0} (m + 1) γ^m
  c(m);
- and |V^Π - V*| <= α_V / (1 - γ), α_V = max_s [max_a Q* - max_{π in Π} E_π Q*], as T^Π contracts and T^Π V* is at most α_V
  below V*.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from deadreckon.errors import UserError
from deadreckon.theory import solve

STEPS = 400  # of c(k): what is behind weighs less than 1e-6 of the sum for discounts up to 0.95


def everything(states: int, actions: int) -> Float[np.ndarray, "a s a"]:
    """The set of all policies."""
    return np.broadcast_to(np.eye(actions)[:, None], (actions, states, actions))


def supported(allowed: Bool[np.ndarray, "s a"]) -> Float[np.ndarray, "a s a"]:
    """The policies that take only allowed actions.

    Raises:
        UserError: a state without any.
    """
    if not allowed.any(1).all():
        raise UserError(f"state {int(allowed.any(1).argmin())} has no allowed action: the set of policies is empty")
    actions = allowed.shape[1]
    instead = np.where(allowed, np.arange(actions), allowed.argmax(1)[:, None])  # (s, a): itself, or the first that is
    return np.eye(actions)[instead.T]


def support(behavior: Float[np.ndarray, "s a"], epsilon: float) -> Float[np.ndarray, "a s a"]:
    """Π_ε: π(a | s) = 0 wherever behavior(a | s) < epsilon.

    Raises:
        UserError: an epsilon above the likeliest action's probability somewhere.
    """
    return supported(behavior >= epsilon)


# ---- the operator -----------------------------------------------------------------------------------------------------


def best(q: Float[Array, "s a"], choices: Float[Array, "k s a"]) -> Float[Array, "s"]:
    """max over π in Π of E_π q."""
    return jnp.einsum("ksa,sa->sk", choices, q).max(1)


def greedy(q: Float[Array, "s a"], choices: Float[Array, "k s a"]) -> Float[Array, "s a"]:
    """The policy of Π with the largest E_π q."""
    which = jnp.einsum("ksa,sa->sk", choices, q).argmax(1)
    return jnp.take_along_axis(choices, which[None, :, None], 0)[0]


def backup(
    transitions: Float[Array, "s a t"], rewards: Float[Array, "s a"], q: Float[Array, "t a"], choices: Array, discount: Any
) -> Float[Array, "s a"]:
    """T^Π q (Definition 4.2.1)."""
    return solve.ahead(transitions, rewards, best(q, choices), discount)


def modified(
    transitions: Float[Array, "s a t"], rewards: Float[Array, "s a"], choices: Float[Array, "k s a"]
) -> tuple[Float[Array, "s k t"], Float[Array, "s k"]]:
    """The world of A.1, whose actions are the choices: transitions E_π[P] and, what A.1 leaves out, rewards E_π[r].

    Its Bellman operator T' and T^Π are one operation: T' E_Π q = E_Π T^Π q, with (E_Π q)(s, k) = E_{a ~ k}[q(s, a)].
    """
    return jnp.einsum("ksa,sat->skt", choices, transitions), jnp.einsum("ksa,sa->sk", choices, rewards)


def fixed_point(transitions: Array, rewards: Array, choices: Array, discount: Any) -> Float[Array, "s a"]:
    """Q^Π, by policy iteration in the modified world."""
    after = solve.policy_iteration(*modified(transitions, rewards, choices), discount).max(1)
    return solve.ahead(transitions, rewards, after, discount)


def iterates(
    transitions: Array, rewards: Array, choices: Array, discount: Any, errors: Float[Array, "n s a"], first: Array
) -> Float[Array, "n s a"]:
    """Q_1 .. Q_n of Q_k = T^Π Q_{k-1} + e_k, from `first`."""

    def step(q: Array, error: Array) -> tuple[Array, Array]:
        q = backup(transitions, rewards, q, choices, discount) + error
        return q, q

    return jax.lax.scan(step, first, errors)[1]


# ---- the two constants ------------------------------------------------------------------------------------------------


def printed_suboptimality(transitions: Array, rewards: Array, choices: Array, discount: Any) -> Float[Array, ""]:
    """α(Π) = max |T^Π Q* - T Q*| (Definition 4.2.2): γ times a gap; α / (1 - γ) bounds Q* - Q^Π, not V* - V^Π."""
    q = solve.policy_iteration(transitions, rewards, discount)
    return jnp.abs(discount * transitions @ (q.max(1) - best(q, choices))).max()


def suboptimality(transitions: Array, rewards: Array, choices: Array, discount: Any) -> Float[Array, ""]:
    """α_V = max_s [max_a Q* - max_{π in Π} E_π Q*], of which V* - V^Π is at most 1 / (1 - γ) times."""
    q = solve.policy_iteration(transitions, rewards, discount)
    return (q.max(1) - best(q, choices)).max()


def concentrability(
    transitions: Array, initial: Array, choices: Array, data: Float[Array, "s"], steps: int = STEPS
) -> Float[Array, "n"]:
    """c(0) .. c(steps): the least numbers with ρ0 P^π1 .. P^πk <= c(k) μ for all policies of Π (Assumption 4.2.1).

    The largest probability of being in a state after k steps is a k-step decision problem that pays 1 there, solved backwards
    for all states at once. Infinite where Π comes to states that the data `data` (μ) lacks.
    """
    flow = modified(transitions, jnp.zeros(transitions.shape[:2]), choices)[0]

    def ratio(reach: Array) -> Array:
        chance = initial @ reach
        return jnp.where(chance > 0.0, chance / data, 0.0).max()

    def back(reach: Array, _: None) -> tuple[Array, Array]:
        reach = jnp.einsum("skt,tu->sku", flow, reach).max(1)
        return reach, ratio(reach)

    at_once = jnp.eye(len(initial))
    return jnp.concatenate([ratio(at_once)[None], jax.lax.scan(back, at_once, None, length=steps)[1]])


def coefficient(c: Float[Array, "n"], discount: Any) -> Float[Array, ""]:
    """C~ = (1 - γ)² Σ_{m >= 0} (m + 1) γ^m c(m), as far as `c` goes: a little less, so checks are stricter."""
    m = jnp.arange(len(c))
    return (1.0 - discount) ** 2 * ((m + 1) * discount**m * c).sum()


def printed_coefficient(c: Float[Array, "n"], discount: Any) -> Float[Array, ""]:
    """C(Π) = (1 - γ)² Σ_{k >= 1} k γ^{k-1} c(k): each step's error is weighed where the next step leads."""
    return coefficient(c[1:], discount)


# ---- Theorem 4.2.1 ----------------------------------------------------------------------------------------------------


def worst_error(delta: Float[Array, "s a"], choices: Array, data: Float[Array, "s"]) -> Float[Array, ""]:
    """E_μ[max_{π in Π} E_π δ]."""
    return data @ best(delta, choices)


def loss_bound(coefficient: Any, error: Any, gap: Any, discount: Any) -> Any:
    """E_ρ0 |V^{π_k} - V*| <= 2 C~ / (1 - γ)² E_μ[max E_π δ] + α_V / (1 - γ), for every k if Q_0 = Q^Π, else in the limit."""
    return 2.0 * coefficient * error / (1.0 - discount) ** 2 + gap / (1.0 - discount)


def printed_loss_bound(coefficient: Any, error: Any, gap: Any, discount: Any) -> Any:
    """Theorem 4.2.1 as printed: γ / (1 - γ)² [C E_μ[..] + (1 - γ) / γ α]. Its own proof has 2 γ; neither holds."""
    return discount * coefficient * error / (1.0 - discount) ** 2 + gap / (1.0 - discount)


def value_bound(c: Array, error: Any, gap: Any, discount: Any) -> Any:
    """E_ρ0 |V_k - V*| <= Σ_m γ^m c(m) E_μ[max E_π δ] + α_V / (1 - γ): of the iterates V_k themselves, which A.2.1 speaks of.

    They obey |V_k - V^Π| <= d + γ max_π P^π |V_{k-1} - V^Π|, once: one horizon less than what a greedy policy may lose.
    """
    return (discount ** jnp.arange(len(c)) * c).sum() * error + gap / (1.0 - discount)


# ---- Theorem 4.2.2 ----------------------------------------------------------------------------------------------------


def reachable(transitions: Array, initial: Array, choices: Array) -> Bool[Array, "s"]:
    """Whether some policy of Π comes to a state after one step or more."""
    steps = modified(transitions, jnp.zeros(transitions.shape[:2]), choices)[0].max(1) > 0.0
    first = (initial[:, None] * steps).max(0) > 0.0
    return jax.lax.fori_loop(0, len(initial), lambda _, seen: seen | (seen[:, None] & steps).any(0), first)


def support_bound(own: Any, least: Any, epsilon: Any, discount: Any) -> Any:
    """C(Π_ε) <= C(β) + [1 - ε (1 - γ)² / (1 - γ ε)²] / f, both C as printed, with f the least μ(s) where Π_ε comes to.

    A policy on actions with β >= ε has Σ_a min(π, β) >= Σ_a π β >= ε: drawn together, the two take the same action with at
    least ε, and k times in a row with ε^k. So their states are within 1 - ε^k, c(k) <= c_β(k) + (1 - ε^k) / f, and
    Σ k γ^{k-1} (1 - ε^k) = 1 / (1 - γ)² - ε / (1 - γ ε)². It is never above C(β) + 1 / f, where C <= 1 / f always.
    """
    return own + (1.0 - epsilon * ((1.0 - discount) / (1.0 - discount * epsilon)) ** 2) / least


def printed_support_bound(own: Any, least: Any, epsilon: Any, discount: Any) -> Any:
    """C(Π_ε) <= C(β) (1 + γ (1 - ε) / ((1 - γ) f)): Theorem 4.2.2 as printed, where sums of ratios are ratios of sums."""
    return own * (1.0 + discount * (1.0 - epsilon) / ((1.0 - discount) * least))


def shifted_support_bound(own: Any, least: Any, epsilon: Any, discount: Any) -> Any:
    """C~(Π_ε) <= C~(β) + [1 - (1 - γ)² / (1 - γ ε)²] / f: the same for C~, by Σ (m + 1) (γ ε)^m = 1 / (1 - γ ε)²."""
    return own + (1.0 - ((1.0 - discount) / (1.0 - discount * epsilon)) ** 2) / least
