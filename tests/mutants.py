"""Planted bugs: does a test fail for each?

    python tests/mutants.py                      # each by the tests named beside it; a table at the end
    python tests/mutants.py --whole              # what these have let pass, by all fast tests
    python tests/mutants.py --only huber ddof    # those whose name holds one of the words
    python tests/mutants.py --markdown           # the table, as docs/planted-bugs.md has it

A bug is one edit of the source that a person could make. Each is applied alone to a copy of `src`, and tests are run on it.
Results are kept in `.cache/mutants.json` under a digest of the bug and of all of `src` and `tests`, so that a run which was
interrupted goes on, and a change of the package begins anew (with `--keep` only for what has survived).
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "src" / "deadreckon"
CACHE = ROOT / ".cache" / "mutants.json"
PAGE = ROOT / "docs" / "planted-bugs.md"


class Mutant(NamedTuple):
    """One bug.

    Attributes:
        name: by which it is known.
        file: below `src/deadreckon`.
        original: text that stands there once.
        replacement: what it becomes.
        breaks: what is wrong then, in a phrase.
        tests: arguments of pytest, without `tests/`, that should see it.
    """

    name: str
    file: str
    original: str
    replacement: str
    breaks: str
    tests: tuple[str, ...]

    def source(self) -> str:
        """The whole file with the bug in it."""
        text = (SOURCE / self.file).read_text()
        if text.count(self.original) != 1:
            raise ValueError(f"{self.name}: the original must stand once in {self.file}, not {text.count(self.original)} times")
        return text.replace(self.original, self.replacement)


MUTANTS = (
    # ---- targets and losses of agents
    Mutant(
        "history-crosses-episodes", "data/history.py", "past = np.maximum(rows - back, starts)",
        "past = np.maximum(rows - back, 0)", "a history begins in the episode before", ("data/test_history.py",),
    ),
    Mutant(
        "history-actions-before-start", "data/history.py", "np.where(there, action, np.float32(0.0))", "action",
        "a history has actions from before its episode's start", ("data/test_history.py",),
    ),
    Mutant(
        "history-never-reset", "policies/deployed.py",
        "jnp.where(first, beginning(observation, self.action_size, self.steps), later)", "later",
        "a policy remembers the episode before", ("policies/test_history.py",),
    ),
    Mutant(
        "history-oldest-part", "ope/histories.py", "slice(max(sizes) - size, max(sizes))", "slice(0, size)",
        "estimators show a policy of fewer steps the oldest ones",
        ("runs/test_history.py::test_policies_of_fewer_steps_act_on_the_newest",),
    ),
    Mutant(
        "backup-terminal", "agents/agent.py", "batch.reward + discount * (1.0 - batch.terminal) * future",
        "batch.reward + discount * future", "targets look beyond a terminal",
        ("agents/test_actor_critics.py::test_td3_target_is_smoothed_clipped_masked_and_the_smaller",),
    ),
    Mutant(
        "greedy-candidates-drawn", "policies/candidates.py",
        "noise = jnp.broadcast_to(self.noise.reshape(samples, *[1] * (len(count) + 1), size), shape)",
        "noise = jax.random.normal(key, shape)", "greedy actions depend on the place in a batch",
        ("policies/test_policies.py::test_file_round_trip_and_numpy_player",),
    ),
    Mutant(
        "mean-without-tanh", "policies/kinds.py", "mean = jnp.tanh(self.net(observation))", "mean = self.net(observation)",
        "the mean of a normal likelihood is not squashed",
        ("policies/test_policies.py::test_a_gaussian_around_a_tanh_has_the_likelihood_of_actions_and_the_density_of_what_acts",),
    ),
    Mutant(
        "reward-shift", "agents/scaled_rewards.py", "self.reward_scale * batch.reward + self.reward_shift",
        "self.reward_scale * (batch.reward + self.reward_shift)", "rewards are shifted before they are scaled",
        ("agents/test_scaled_rewards.py",),
    ),
    Mutant(
        "standardised-shift", "agents/scaled_rewards.py", "reward_shift=-scale * float(spec.reward.mean)",
        "reward_shift=-float(spec.reward.mean)", "standardised rewards are shifted by a mean that is not scaled",
        ("agents/test_scaled_rewards.py",),
    ),
    Mutant(
        "last-layer-as-others", "nets/mlp.py", 'if init.weights == "uniform" or init.last is not None:',
        'if init.weights == "uniform":', "last layers begin as wide as the others",
        ("agents/test_actor_critics.py",),
    ),
    Mutant(
        "spans-start-at-zero", "training/program.py", "index = first + draw(plan, root, step, count)",
        "index = draw(plan, root, step, count)",
        "lanes of several logs all learn from the first log",
        ("training/test_fit.py::test_lanes_of_several_logs_see_the_rows_of_their_own",),
    ),
    Mutant(
        "plans-share-nothing", "bench/filling.py", "return max(start + self.ready, device) + self.training",
        "return start + self.ready + self.training",
        "a plan gives every program the whole device",
        ("bench/test_filling.py::test_the_plan_is_what_one_gets_by_hand",),
    ),
    Mutant(
        "service-of-others-stopped", "bench/device.py", "if _answers(control, \"get_server_list\"):\n            yield",
        "if _answers(control, \"quit\"):\n            yield",
        "a multi-process service that ran already is stopped",
        ("bench/test_filling.py::test_the_service_is_started_and_stopped_only_where_it_does_not_run",),
    ),
    Mutant(
        "second-stage-at-the-level-of-the-first", "bench/claims.py", "staged(test.again, rival, on, alpha / 2)",
        "staged(test.again, rival, on, alpha)",
        "the second stage of a claim is at the level of the first",
        ("bench/test_claims_again.py::test_fresh_seeds_alone_decide_what_the_first_ones_left_open",),
    ),
    Mutant(
        "second-stage-of-seen-seeds", "bench/claims_file.py", "one.first_seed < suite.first_seed + suite.seeds and",
        "False and",
        "seeds that the first stage of a claim has seen decide again",
        ("bench/test_claims_again.py::test_wrong_second_stages_are_refused_in_one_line",),
    ),
    Mutant(
        "rates-of-a-shared-device", "bench/filling.py", "seen.share += (now - self.looked) / len(training)",
        "seen.share += now - self.looked",
        "a program that shares the device is taken for a slow one",
        ("bench/test_filling.py::test_programs_that_train_side_by_side_share_the_time",),
    ),
    Mutant(
        "rewards-unscaled", "training/program.py", "batch = learner.learned(batch)", "learner.learned(batch)",
        "agents learn from rewards as logged, whatever their scale", ("agents/test_scaled_rewards.py",),
    ),
    Mutant(
        "cosine-upside-down", "nets/optim.py", "0.5 * (1.0 + jnp.cos(jnp.pi * share))", "0.5 * (1.0 - jnp.cos(jnp.pi * share))",
        "learning rates rise instead of falling", ("agents/test_scaled_rewards.py",),
    ),
    Mutant(
        "unbiased-diagonal", "nets/mmd.py", "(m * yy - 1.0) / (m - 1)", "yy", "the unbiased MMD counts a draw beside itself",
        ("nets/test_mmd.py",),
    ),
    Mutant(
        "copies-as-the-model", "agents/bear.py", "k_copies, self.policy_samples)", "k_copies, self.behavior_samples)",
        "copies are as many as draws of the model, and not of the policy", ("agents/test_bear.py",),
    ),
    Mutant(
        "copies-before-tanh", "agents/bear.py", "self.mmd_estimate, x, y, own,", "self.mmd_estimate, x, y, copies,",
        "copies are compared before the tanh",
        ("agents/test_bear.py",),
    ),
    Mutant(
        "relative-not-less-own", "nets/mmd.py", "return mmd(x, *to_model) - own", "return mmd(x, *to_model)",
        "the relative MMD has the floor of the biased one", ("nets/test_mmd.py",),
    ),
    Mutant(
        "fql-smaller-critic", "agents/fql.py", "q.mean(0) if self.target_q == \"mean\" else minimum(q)", "q.mean(0)",
        "FQL's targets always take the mean of its critics",
        ("agents/test_rivals.py::test_fqls_targets_take_the_mean_of_the_critics_or_the_smaller",),
    ),
    Mutant(
        "cql-gap-limit", "agents/cql.py", "self.min_gap).mean(-1)", "-jnp.inf).mean(-1)", "CQL's difference has no limit",
        ("agents/test_offline.py::test_cqls_difference_has_a_lower_limit_row_by_row",),
    ),
    Mutant(
        "bellman-stop-gradient", "agents/agent.py", "jnp.square(q - jax.lax.stop_gradient(target))", "jnp.square(q - target)",
        "critics learn through their own targets",
        ("agents/test_bear.py::test_bellman_loss_is_the_squared_error_with_no_gradient_through_the_target",),
    ),
    Mutant(
        "trace-off-by-one", "agents/agent.py", "step[0] + decay * step[1] * later", "step[0] + decay * later",
        "advantages cross the ends of episodes",
        ("agents/test_rivals.py::test_traced_advantages_are_discounted_sums_that_end_where_rows_do",),
    ),
    Mutant(
        "imitation-weight-slope", "agents/agent.py", "-(jax.lax.stop_gradient(weight) * log_prob).mean()",
        "-log_prob.mean()", "weights of imitation are forgotten",
        ("agents/test_offline.py::test_iql_losses",),
    ),
    Mutant(
        "least-is-greatest", "nets/mlp.py", "jnp.where(a <= b, a, b)", "jnp.where(a >= b, a, b)",
        "the greatest of a few critics counts instead of the least", ("nets/test_mlp.py",),
    ),
    Mutant(
        "least-of-many", "nets/mlp.py", "jax.lax.stop_gradient(values).argmin(0)", "jax.lax.stop_gradient(values).argmax(0)",
        "the greatest of many critics counts",
        ("agents/test_offline.py::test_the_least_of_many_is_that_of_few_with_a_slope_of_one_of_them",),
    ),
    Mutant(
        "polyak-swapped", "nets/optim.py", "t + rate * (o - t)", "o + rate * (t - o)", "targets follow at the wrong rate",
        ("nets/test_mlp.py",),
    ),
    Mutant(
        "td3-stale-target", "agents/td3.py", "(actor, state.critics), self.tau)",
        "(state.actor, state.critics), self.tau)", "the target actor follows the actor of before the update",
        ("agents/test_actor_critics.py::test_td3_actor_follows_the_first_critic_and_moves_every_other_update",),
    ),
    Mutant(
        "td3-noise-unclipped", "agents/td3.py", "-self.noise_clip, self.noise_clip)", "-self.noise_clip, jnp.inf)",
        "smoothing noise is clipped on one side only",
        ("agents/test_actor_critics.py::test_td3_target_is_smoothed_clipped_masked_and_the_smaller",),
    ),
    Mutant(
        "td3-policy-freq", "agents/td3.py", "step % self.policy_freq == 0", "step % self.policy_freq != 0",
        "the actor moves at the wrong updates",
        ("agents/test_actor_critics.py::test_td3_actor_follows_the_first_critic_and_moves_every_other_update",),
    ),
    Mutant(
        "td3bc-lambda-slope", "agents/td3_bc.py", "jax.lax.stop_gradient(jnp.abs(q).mean())", "jnp.abs(q).mean()",
        "the weight of the value has a gradient",
        ("agents/test_actor_critics.py::test_td3_bc_weight_has_no_gradient",),
    ),
    Mutant(
        "sac-entropy-sign", "agents/sac.py", "slope = -(log_prob + self.entropy_target)",
        "slope = -(log_prob - self.entropy_target)", "entropy is held at minus its target",
        ("agents/test_actor_critics.py::test_sac_temperature_falls_when_the_policy_is_more_random_than_asked",),
    ),
    Mutant(
        "sac-key-reuse", "agents/sac.py", "self.update_actor(state, batch, step, k_actor)",
        "self.update_actor(state, batch, step, k_target)", "actor and target share their draws",
        (
            "agents/test_actor_critics.py::test_sac_draws_of_targets_and_actor_have_keys_of_their_own",
        ),
    ),
    Mutant(
        "iql-expectile-side", "agents/iql.py", "jnp.where(gap < 0, 1.0 - self.expectile, self.expectile)",
        "jnp.where(gap > 0, 1.0 - self.expectile, self.expectile)", "the expectile is that of the other side",
        ("agents/test_offline.py::test_iql_losses",),
    ),
    Mutant(
        "cql-without-volume", "agents/cql.py", "q_values(critics, batch.observation, uniform) + size * jnp.log(2.0)",
        "q_values(critics, batch.observation, uniform)", "uniform actions are weighted as if the box had volume one",
        ("agents/test_offline.py::test_cql_penalty",),
    ),
    Mutant(
        "cql-multiplier-sign", "agents/cql.py", 'slope = self.threshold - metrics["gap"]',
        'slope = metrics["gap"] - self.threshold',
        "the multiplier falls where the gap is too large",
        ("agents/test_offline.py::test_cql_multiplier_rises_where_the_difference_is_too_large",),
    ),
    Mutant(
        "bcq-max-axis", "agents/bcq.py", "self.mixed(q).max(0)", "self.mixed(q).mean(0)",
        "targets take the mean action instead of the best",
        ("agents/test_offline.py::test_bcq_target_is_the_best_of_perturbed_actions_by_a_mixture",),
    ),
    Mutant(
        "bear-dual-sign", "agents/bear.py", "* (divergence - self.threshold)", "* (self.threshold - divergence)",
        "the multiplier descends",
        ("agents/test_bear.py::test_dual_step_ascends_clips_and_rests",),
    ),
    Mutant(
        "bear-warm-start", "agents/bear.py", "warm = step < self.warm_start", "warm = step <= self.warm_start",
        "the warm start lasts one update longer",
        (
            "agents/test_bear.py::test_dual_step_ascends_clips_and_rests",
            "agents/test_bear.py::test_actor_loss_is_the_lagrangian",
        ),
    ),
    Mutant(
        "awr-window-mask", "agents/agent.py", "[batch.mask[:, 1:], jnp.zeros_like(batch.mask[:, :1])]",
        "[batch.mask[:, :-1], jnp.zeros_like(batch.mask[:, :1])]", "advantages come from rows beyond an episode's end",
        ("agents/test_rivals.py::test_awr_returns_are_td_lambda_within_episode_and_window",),
    ),
    Mutant(
        "ppo-timeout-goes-on", "agents/on_policy.py", 'goes_on = 1.0 - jnp.maximum(rows["terminal"], rows["timeout"])',
        'goes_on = 1.0 - rows["terminal"]', "advantages run on beyond a timeout",
        ("agents/test_ppo.py::test_advantages_are_the_sums_by_hand",),
    ),
    Mutant(
        "ppo-timeout-is-terminal", "agents/on_policy.py", 'discount * (1.0 - rows["terminal"]) * following',
        'discount * (1.0 - jnp.maximum(rows["terminal"], rows["timeout"])) * following', "a timeout has no future",
        ("agents/test_ppo.py::test_advantages_are_the_sums_by_hand",),
    ),
    Mutant(
        "ppo-clip-max", "agents/ppo.py", "-jnp.minimum(ratio * gain, clipped * gain)",
        "-jnp.maximum(ratio * gain, clipped * gain)",
        "the objective is not pessimistic",
        ("agents/test_ppo.py::test_what_is_gained_beyond_the_clip_counts_no_more",),
    ),
    Mutant(
        "edac-self-pairs", "agents/edac.py", "- jnp.square(unit).sum((0, -1))", "- jnp.square(unit).sum(-1).mean(0)",
        "pairs of a critic with itself are not all taken out",
        ("agents/test_offline.py::test_edac_likeness_by_hand_and_by_pairs",),
    ),
    Mutant(
        "mve-discount", "agents/mve.py", "rewards[t] + self.discount * goes_on[t] * value",
        "rewards[t] + self.discount * value",
        "made-up steps after an end count",
        ("agents/test_expansion.py::test_mve_is_the_sum_by_hand",),
    ),
    Mutant(
        "steve-variance-axis", "agents/steve.py", "targets.var((1, 2))", "targets.var(1).mean(1)",
        "disagreement of critics is forgotten",
        ("agents/test_expansion.py::test_steve_weighs_horizons_by_their_certainty",),
    ),
    Mutant(
        "model-of-changes", "dynamics/model.py", "change = batch.next_observation - batch.observation",
        "change = batch.next_observation", "models learn the next observation instead of its change",
        ("dynamics/test_ensemble.py::test_an_update_is_of_changes_of_observations_and_of_rewards_in_deviations",),
    ),
    # ---- policies in use
    Mutant(
        "unknown-level-passes", "policies/table_columns.py", "elif flag:\n                outside[row] = True",
        "elif True:\n                outside[row] = True", "an unknown level becomes no level without a word",
        ("policies/test_table_encoder.py::test_rows_that_are_refused",),
    ),
    Mutant(
        "fill-forgotten", "policies/table_columns.py", "np.where(absent, self.fill, values)", "np.where(absent, 0.0, values)",
        "missing values are 0 at use and the mean in training", ("policies/test_table_encoder.py",),
    ),
    Mutant(
        "names-swapped", "policies/table_encoder.py", "return actions if self.levels is None else self.levels[actions]",
        "return actions if self.levels is None else self.levels[::-1][actions]",
        "actions are named in another order than that of their codes", ("test_three_tables.py",),
    ),
    Mutant(
        "levels-sorted-at-use", "policies/table_columns.py",
        'self.key, self.levels, self.marked = key, list(column["levels"]), bool(column.get("marked"))',
        'self.key, self.levels, self.marked = key, sorted(column["levels"]), bool(column.get("marked"))',
        "levels are encoded at use in another order than in training", ("test_three_tables.py",),
    ),
    Mutant(
        "marks-forgotten", "policies/table_encoder.py", "out[:, place + 1] = absent[:, index]", "out[:, place + 1] = 0.0",
        "nothing says at use where a value was missing", ("policies/test_table_encoder.py",),
    ),
    Mutant(
        "outside-at-the-end", "policies/table_columns.py", "(values > self.seen_high)", "(values >= self.seen_high)",
        "the largest value of a log lies outside it", ("policies/test_table_encoder.py",),
    ),
    Mutant(
        "past-not-taken", "policies/table_predict.py", "taken if episodes.logged is None else episodes.logged[rows]", "taken",
        "a history has what the policy would have done in place of what was done",
        ("runs/test_predict.py::test_policies_on_histories_take_the_logged_past",),
    ),
    Mutant(
        "sampled-evenly", "policies/table_predict.py", "np.cumsum(probs.astype(np.float64), 1)",
        "np.cumsum(np.ones(probs.shape), 1)", "sampled actions all have the same probability",
        ("runs/test_predict.py::test_probabilities_by_name_and_what_is_sampled_from_them",),
    ),
    Mutant(
        "member-of-each-row", "policies/table_predict.py", "size=len(self.number))[self.number]", "size=len(self.number))",
        "a mixture changes its member within an episode",
        ("runs/test_predict.py::test_one_member_of_a_mixture_acts_to_the_end_of_an_episode_that_flags_alone_tell",),
    ),
    Mutant(
        "texts-guessed-anew", "data/formats/any_table.py", "read_delimited(path, asked, known=known)",
        "read_delimited(path, asked)", "a column of texts is read as numbers or truth values in a table of few rows",
        ("cli/test_predict.py::test_a_file_of_a_few_rows_is_read_as_the_log_was",),
    ),
    Mutant(
        "columns-for-a-row", "runs/service.py", "given = [rows] if single else rows", "given = rows",
        "a service takes a dictionary of columns, of as many rows as it has", ("runs/test_service.py",),
    ),
    Mutant(
        "body-without-limit", "runs/service.py", "if size > most:", "if size > 1_000 * most:",
        "a body whose length is not said has no limit",
        ("runs/test_service.py::test_large_bodies_are_refused_before_they_are_whole",),
    ),
    # ---- networks
    Mutant(
        "tanh-correction", "nets/distributions.py", "return (normal - squash).sum(-1)", "return (normal + squash).sum(-1)",
        "the density of squashed actions has the wrong sign of its correction",
        ("nets/test_distributions.py",),
    ),
    Mutant(
        "kl-swapped", "nets/distributions.py", "jnp.square((p.mean - q.mean) * jnp.exp(-q.log_std))",
        "jnp.square((p.mean - q.mean) * jnp.exp(-p.log_std))", "a divergence measures in the wrong distribution's deviations",
        ("nets/test_distributions.py",),
    ),
    Mutant(
        "mmd-bandwidth", "nets/mmd.py", "jnp.exp(-squared / (2.0 * bandwidth))", "jnp.exp(-squared / bandwidth)",
        "the Gaussian kernel is narrower by sqrt 2", ("nets/test_mmd.py",),
    ),
    Mutant(
        "adamw-decays-new", "nets/optim.py", "lambda n, p: n - lr * weight_decay * p", "lambda n, p: n - weight_decay * p",
        "weights decay without the learning rate",
        ("nets/test_mlp.py",),
    ),
    # ---- batches and logs
    Mutant(
        "n-step-beyond-end", "data/batch.py", "inside = k < self.span(rows)", "inside = k <= self.span(rows)",
        "n-step rewards hold one of the next episode", ("training/test_fit.py",),
    ),
    Mutant(
        "next-action-across", "data/batch.py", "inside = ~r.log.is_end[rows]", "inside = ~np.asarray(r.log.terminals[rows])",
        "what the log did next is that of another episode after a timeout", ("training/test_fit.py",),
    ),
    Mutant(
        "hidden-rows", "data/batch.py", 'np.searchsorted(self._before, flat, side="right")',
        "np.searchsorted(self._before, flat)",
        "a row without a next observation or terminal is learned from in place of the one after it", ("training/test_fit.py",),
    ),
    Mutant(
        "spooled-quotes", "data/formats/spool.py", """_compute.replace_substring(cells, b'"', b'""')""", "cells",
        "a large text file loses quotes within its texts, or is refused", ("data/formats/test_spool.py",),
    ),
    Mutant(
        "usable-timeouts", "data/dataset.py", "self.final_known | self.terminals[self.ends]", "self.final_known | True",
        "rows without a next observation or terminal are learned from", ("data/test_dataset.py",),
    ),
    Mutant(
        "returns-of-long-episodes", "data/episodes.py", "to_go[rows] += factor * to_go[rows + steps]",
        "to_go[rows] += discount * to_go[rows + steps]",
        "in long episodes rewards far ahead are discounted as if they were near", ("data/test_dataset.py",),
    ),
    Mutant(
        "returns-to-go", "data/episodes.py", "to_go[rows] += discount * to_go[rows + 1]",
        "to_go[rows] += discount * to_go[rows]",
        "returns to go are sums of the wrong rows", ("data/test_dataset.py",),
    ),
    Mutant(
        "frame-timeouts", "data/frame.py", 'columns["timeouts"] |= ends & ~columns["terminals"]', 'columns["timeouts"] |= ends',
        "ended episodes are also cut off", ("data/test_frame.py",),
    ),
    Mutant(
        "horizon-cut", "data/formats/build.py", "(step % horizon == horizon - 1) & ~ends", "(step % horizon == 0) & ~ends",
        "a horizon cuts one step early", ("data/formats/test_hdf5.py",),
    ),
    Mutant(
        "minari-truncations", "data/formats/minari_inside.py",
        "columns[\"timeouts\"] = timeouts", "columns[\"terminals\"] = timeouts",
        "truncations are read as terminals", ("data/formats/test_minari.py",),
    ),
    Mutant(
        "holdout-share", "data/split.py", "round((1 - self.share) * log.episodes)", "round(self.share * log.episodes)",
        "the share is learned from and the rest held out", ("data/test_split.py",),
    ),
    Mutant(
        "folds-not-drawn", "data/split.py", "        return rng.permutation(np.arange(log.episodes) % k)\n    order",
        "        return np.arange(log.episodes) % k\n    order", "folds are not drawn by the seed",
        ("data/test_split.py::test_folds_are_drawn_by_the_seed",),
    ),
    # ---- replay and learning online
    Mutant(
        "replay-overwrites", "training/replay.py", "start = self.count - rows.shape[1]", "start = 0",
        "each flush overwrites the file from its beginning", ("training/test_replay.py",),
    ),
    Mutant(
        "row-after-reset", "online/exploration.py", "terminal[:, None], timeout[:, None])",
        "timeout[:, None], terminal[:, None])",
        "terminals and timeouts change places in the replay file",
        ("online/test_exploration.py::test_rows_are_what_the_simulator_did",),
    ),
    # ---- Gymnasium environments as tasks
    Mutant(
        "gymnasium-fall-in-time", "tasks/gymnasium_copies.py", "timeouts = self._alive & ~terminals & (",
        "timeouts = self._alive & (", "a fall in an environment's last step is a timeout too",
        ("tasks/test_gymnasium.py::test_a_fall_in_the_last_step_is_a_terminal",),
    ),
    Mutant(
        "gymnasium-replayed", "tasks/gymnasium_copies.py", "in self._taken[i, : self._age[i]]:",
        "in self._taken[i, 1 : self._age[i]]:", "an environment that is taken up again misses the first action of its episode",
        ("tasks/test_gymnasium.py::test_restored_copies_go_on_bit_for_bit",),
    ),
    Mutant(
        "gymnasium-start", "tasks/gymnasium_spaces.py", "space.dtype.type(space.start + i)", "space.dtype.type(i)",
        "an environment's discrete actions are counted from 0, wherever they start",
        ("tasks/test_gymnasium.py::test_numbers_that_do_not_begin_at_zero",),
    ),
    Mutant(
        "gymnasium-episode-seed", "tasks/gymnasium_copies.py", "SeedSequence([seed, number])", "SeedSequence([seed])",
        "all later episodes of a copy of an environment are the same", ("tasks/test_gymnasium.py::test_seeds_of_episodes",),
    ),
    Mutant(
        "chance-of-discrete", "collect/rollouts.py", "-jnp.log(high + 1.0)", "-jnp.log(high)",
        "uniform discrete actions are logged with the probability of one action less",
        ("runs/test_gymnasium_runs.py::test_a_log_by_chance",),
    ),
    Mutant(
        "minari-bounds", "data/formats/minari_rows.py", "np.minimum(environment.low, seen.min)", "environment.low",
        "bounds of observations in Minari's data sets leave rows outside",
        ("runs/test_gymnasium_runs.py::test_bounds_hold_every_row",),
    ),
    # ---- from a log to a better policy online
    Mutant(
        "uncalibrated", "agents/cql.py", "(q if floor is None else jnp.maximum(q, floor))", "q",
        "Cal-QL holds values down as far as CQL does",
        ("agents/test_fine_tuning.py::test_cal_qls_term_holds_the_policys_actions_down_to_the_return_and_no_further",),
    ),
    Mutant(
        "calibrated-in-other-units", "agents/cal_ql.py",
        "self.reward_scale * batch.monte_carlo[:, 0] + self.reward_shift * batch.monte_carlo[:, 1]",
        "self.reward_scale * batch.monte_carlo[:, 0]", "returns lack the shift of the rewards",
        ("agents/test_fine_tuning.py::test_cal_qls_term_holds_the_policys_actions_down_to_the_return_and_no_further",),
    ),
    Mutant(
        "cut-is-an-end", "data/episodes.py", "each[ends] / (1.0 - discount)", "each[ends]",
        "nothing follows an episode that was cut",
        ("online/test_mixed.py::test_returns_of_the_log_are_exact_also_where_episodes_were_cut",),
    ),
    Mutant(
        "same-pair", "agents/rlpd.py", "drawn = jax.random.choice(k_subset, self.critics, (self.subset,), replace=False)",
        "drawn = jnp.arange(self.subset)", "RLPD's targets always are of the same critics",
        ("agents/test_fine_tuning.py::test_rlpds_target_is_the_least_of_a_random_pair_of_normalised_critics",),
    ),
    Mutant(
        "rlpd-least-actor", "agents/rlpd.py", "return values.mean(0)", "return minimum(values)",
        "RLPD's actor climbs the least critic",
        ("agents/test_fine_tuning.py::test_rlpds_actor_climbs_the_mean_of_all_critics",),
    ),
    Mutant(
        "padding-is-drawn", "training/program.py", '"logged rows", step), (plan.logged,), 0, rows)',
        '"logged rows", step), (plan.logged,), 0, rows + 4)', "rows beyond the log's are drawn",
        ("online/test_mixed.py::test_every_batch_has_exactly_its_share_of_the_log",),
    ),
    Mutant(
        "experience-as-it-is", "online/mixed.py", "out[..., part] = self.view.observe(out[..., part])", "pass",
        "what is experienced is not in the log's coordinates",
        ("online/test_mixed.py::test_experience_is_seen_in_the_coordinates_of_the_log",),
    ),
    Mutant(
        "acts-on-raw-observations", "online/exploration.py", "seen = jnp.asarray(self.view.observe(self.seen))",
        "seen = jnp.asarray(self.seen)", "policies that standardise act on raw observations",
        ("online/test_mixed.py::test_the_policy_acts_in_the_coordinates_of_the_log",),
    ),
    Mutant(
        "returns-lost-on-resume", "online/mixed.py", "self._note_returns(np.stack(rows), 0)", "pass",
        "a run that is taken up again has forgotten the returns",
        ("online/test_mixed.py::test_stopped_and_taken_up_again_it_is_the_same",),
    ),
    Mutant(
        "begins-anew", "runs/online.py", "job.states = jax.device_put(start.states(job.states))", "pass",
        "an online run begins with networks of its own instead of those of its start",
        ("runs/test_fine_tuned.py::test_it_begins_with_the_parameters_targets_and_coordinates_of_the_run",),
    ),
    Mutant(
        "held-out-in-the-replay", "runs/started.py", "return Beside(part.learning,", "return Beside(log,",
        "episodes that were held out are learned from online",
        ("runs/test_fine_tuned.py::test_held_out_episodes_are_not_in_the_replay",),
    ),
    # ---- intervals, bootstrap, scores
    Mutant(
        "student-two-sided", "stats/means.py", "special.stdtrit(n - 1, 1 - alpha / 2) * x.std(ddof=1)",
        "special.stdtrit(n - 1, 1 - alpha) * x.std(ddof=1)", "Student's interval is one-sided", ("stats/test_means.py",),
    ),
    Mutant(
        "student-ddof", "stats/inference.py", "influence.std(0, ddof=1) / np.sqrt(n)", "influence.std(0) / np.sqrt(n)",
        "standard errors divide by n",
        ("stats/test_inference.py",),
    ),
    Mutant(
        "ensemble-prediction", "stats/bootstrap.py", "np.sqrt(1 + 1 / members)", "np.sqrt(1 / members)",
        "an ensemble's interval is that of its mean", ("stats/test_means.py",),
    ),
    Mutant(
        "crossed-axes", "stats/crossed.py", "sources.append((float(columns.var(ddof=1)) / episodes, episodes - 1.0))",
        "sources.append((float(columns.var(ddof=1)) / policies, episodes - 1.0))", "the variance over episodes counts seeds",
        ("report/test_rows.py",),
    ),
    Mutant(
        "paired-unpaired", "stats/crossed.py", "(a.mean(0) - b.mean(0)).var(ddof=1)",
        "(a.mean(0).var(ddof=1) + b.mean(0).var(ddof=1))",
        "paired episodes count as independent", ("report/test_rows.py",),
    ),
    Mutant(
        "iqm-quarters", "stats/scores.py", "cut = n // 4", "cut = n // 5", "the interquartile mean keeps too much",
        ("stats/test_scores.py",),
    ),
    Mutant(
        "ties-count-whole", "stats/scores.py", "(x[:, None] == y) / 2", "(x[:, None] == y)", "ties count as wins",
        ("stats/test_scores.py",),
    ),
    Mutant(
        "bold-one-sided", "stats/comparison.py", "return float(2.0 * stdtr(dof, -abs(t)))", "return float(stdtr(dof, -abs(t)))",
        "p is half of what it is", ("stats/test_scores.py",),
    ),
    Mutant(
        "betting-alpha", "stats/betting.py", ">= np.log(1 / alpha)", ">= np.log(0.5 / alpha)",
        "a bound by betting fails twice as often as it says", ("stats/test_betting.py",),
    ),
    # ---- estimators of policies' values
    Mutant(
        "ratios-swapped", "ope/importance.py",
        "own[which] - logged_probs(case, behavior, model, folds, clipped=clipped)",
        "logged_probs(case, behavior, model, folds, clipped=clipped) - own[which]",
        "weights are the log's probabilities over the policy's",
        ("ope/test_bandit.py", "ope/test_exact.py::test_weighted_values_are_true_within_their_intervals",),
    ),
    Mutant(
        "ended-episodes-forgotten", "ope/weights.py", "stays = self.ended & (not alive_only)",
        "stays = self.ended & alive_only",
        "episodes that have ended leave the weights' sum",
        ("ope/test_intervals.py::test_sums_by_hand",),
    ),
    Mutant(
        "discount-in-contributions", "ope/weights.py",
        "return np.bincount(self.of, rho * x * self.discount**self.time, self.count)",
        "return np.bincount(self.of, rho * x, self.count)", "contributions of episodes are not discounted",
        ("ope/test_intervals.py::test_sums_by_hand", "ope/test_intervals.py", "ope/test_demands.py",),
    ),
    Mutant(
        "kaplan-meier", "ope/weights.py", "at_risk = np.maximum(beyond + cut, 1)", "at_risk = np.maximum(beyond, 1)",
        "chances of being cut off leave out those that are",
        ("ope/test_intervals.py::test_chances_of_being_cut_off_by_hand",),
    ),
    Mutant(
        "switch-side", "ope/switch.py", "np.where(log_rho <= limit, log_rho, -np.inf)",
        "np.where(log_rho >= limit, log_rho, -np.inf)",
        "large weights are trusted and small ones not",
        ("ope/test_switch.py::test_switch_by_hand",),
    ),
    Mutant(
        "fqe-terminal", "ope/fqe.py", "self.discount * (1.0 - batch.terminal) * future", "self.discount * future",
        "fitted values look beyond a terminal",
        ("ope/test_case.py::test_targets_of_fitted_values_end_at_terminals",),
    ),
    Mutant(
        "fqe-member-weights", "ope/fqe.py", 'error = square * batch.extra["weight"].T[:, None, :]',
        'error = square * batch.extra["weight"].mean(-1)', "all members learn from the mean of their redraws",
        ("ope/test_case.py::test_members_learn_each_from_its_own_redrawn_episodes",),
    ),
    Mutant(
        "dice-future-masked", "ope/dice.py", "self.discount * lasts * future - q", "self.discount * future - q",
        "residuals look beyond a terminal",
        ("ope/test_case.py::test_the_saddle_point_looks_ahead_where_the_episode_goes_on_and_nowhere_else",),
    ),
    Mutant(
        "rank-correlation-order", "stats/ranks.py", "(rankdata(each, axis=1) for each in (a, b))",
        "(a, b)", "rank correlation is of values", ("ope/test_metrics.py",),
    ),
    Mutant(
        "regret-k", "ope/metrics.py", "np.sort(estimates)[::-1][k - 1]", "np.sort(estimates)[k - 1]",
        "regret is of the k worst", ("ope/test_metrics.py",),
    ),
    Mutant(
        "error-rates-swapped", "ope/metrics.py", "float(taken[~good].mean())", "float(taken[good].mean())",
        "the share of false alarms is that of right ones",
        ("ope/test_metrics.py",),
    ),
    Mutant(
        "tail-side", "ope/tail.py", "np.maximum(quantile - returns, 0.0) / share",
        "np.maximum(returns - quantile, 0.0) / share",
        "the tail is the upper one",
        ("ope/test_tail.py::test_exact_where_the_log_is_the_distribution",),
    ),
    Mutant(
        "guarantee-bonferroni", "ope/guarantee.py", "alpha / len(case.policies))", "alpha)",
        "a guarantee holds for one policy, not for all",
        ("ope/test_demands.py::test_a_guarantee_shares_its_chance_of_failing_among_all_policies",),
    ),
    Mutant(
        "horizon-off-by-one", "ope/estimand.py", "over = time == horizon - 1", "over = time == horizon",
        "an estimand's horizon ends no episode",
        ("ope/test_decide.py::test_a_horizon_cuts_episodes_and_knows_what_the_task_ended",),
    ),
    # ---- the decision
    Mutant(
        "deploy-by-estimate", "ope/select.py", "    elif low > 0:\n", "    elif difference > 0:\n",
        "policies are deployed by the estimate, not by its lower end",
        ("ope/test_select.py::test_the_lower_end_decides_and_not_the_estimate",),
    ),
    Mutant(
        "objections-ignored", "ope/select.py", "key=lambda i: (not objections[i], *_standing(first, every[i]))",
        "key=lambda i: _standing(first, every[i])", "a policy with objections is chosen before one without",
        ("ope/test_select.py::test_a_policy_that_something_speaks_against_is_not_chosen_before_one_without",),
    ),
    Mutant(
        "missing-support", "ope/support.py", "rare = chances < RARE /", "rare = chances > RARE /",
        "common actions count as unsupported",
        ("ope/test_decide.py::test_actions_that_the_log_never_takes_are_told",),
    ),
    Mutant(
        "looks-spend-nothing", "runs/looks.py", "1 + len(own.looks) + sum(len(note.looks) for note in others)",
        "1 + len(own.looks)", "looks at overlapping episodes are not counted together",
        ("runs/test_offline.py::test_each_look_at_the_same_episodes_spends_half_of_what_is_left",),
    ),
    Mutant(
        "tracked-before-checkpoint", "runs/trackers/feed.py", "self.waiting[0] < below", "self.waiting[0] <= below",
        "trackers are told what no checkpoint holds yet", ("runs/test_trackers.py",),
    ),
    Mutant(
        "tracked-without-evaluation", "runs/trackers/feed.py",
        "return not judged or self.folder.part(\"evaluations\", step).exists()", "return True",
        "a point is told before its evaluation is done, which is then lost", ("runs/test_trackers.py",),
    ),
    Mutant(
        "tracked-id-anew", "runs/trackers/feed.py", "if not path.exists():", "if True:",
        "a resumed run is another tracked run",
        ("runs/test_trackers.py::test_a_resumed_run_is_the_same_tracked_run_and_gives_all_points_again",),
    ),
    Mutant(
        "wandb-doubles", "runs/trackers/wandb_runs.py", "if step >= run.starting_step:", "if step >= 0:",
        "points are doubled in W&B when a run is resumed",
        ("runs/test_trackers.py::test_wandb_takes_only_what_its_server_lacks",),
    ),
    Mutant(
        "callback-too-early", "runs/recorder.py", "pc.field(\"step\") <= step", "pc.field(\"step\") < step",
        "a callback does not see the evaluation that has just been done",
        ("runs/test_trackers.py::test_a_callback_sees_the_run_and_ends_it",),
    ),
    Mutant(
        "callbacks-of-one-log", "runs/recorder.py",
        "for recorder, part in zip(recorders, parts) for each in recorder.seen(part)",
        "for recorder, part in zip(recorders[:1], parts) for each in recorder.seen(part)",
        "of runs on several logs only those on the first are told to the callback",
        ("runs/test_trackers.py::test_runs_on_several_logs_are_told_of_apart_and_end_together",),
    ),
    Mutant(
        "one-log-ends-alone", "runs/recorder.py", "for recorder in recorders:\n                recorder.end_at(progress.step)",
        "for recorder in recorders[:1]:\n                recorder.end_at(progress.step)",
        "of runs on several logs only those on the first end where all do",
        ("runs/test_trackers.py::test_runs_on_several_logs_are_told_of_apart_and_end_together",),
    ),
    Mutant(
        "hub-unchecked", "runs/hub.py", 'if (found := sha256_of(aside / name)) != about["sha256"]:',
        'if (found := sha256_of(aside / name)) == "":', "a file from the Hub that was exchanged is used", ("runs/test_hub.py",),
    ),
    Mutant(
        "hub-any-file", "runs/hub.py", "if not allowed.fullmatch(name):", "if not name:",
        "files of other kinds and in other folders are taken from the Hub", ("runs/test_hub.py",),
    ),
    Mutant(
        "rounds-untold", "bench/sampler.py", "self.study.tell(trial, value)", "self.study.tell(trial, 0.0)",
        "Optuna proposes without knowing what its proposals came to", ("bench/test_sampler.py",),
    ),
    Mutant(
        "holdout-of-resumed", "runs/holdout.py", "if given is None and before is not None:", "if before is not None:",
        "a run that is gone on with cannot be told to hold out otherwise",
        ("runs/test_holdout.py::test_a_run_that_is_gone_on_with_keeps_what_it_held_out",),
    ),
    Mutant(
        "discounted-return", "runs/evaluate.py", "rewards * self.discounts[:, None] ** t",
        "rewards * self.discounts[:, None] ** (t + 1)", "true discounted returns are too small by one discount",
        ("runs/test_train.py::test_nothing_counts_after_an_episodes_end",),
    ),
    Mutant(
        "counts-after-end", "runs/evaluate.py", "rewards = np.where(alive, rewards, 0.0)", "rewards = rewards + 0.0",
        "rewards after an episode's end count",
        ("runs/test_train.py::test_nothing_counts_after_an_episodes_end",),
    ),
    Mutant(
        "turns-begin-alike", "tasks/turns.py", "[seeds[i] for i in turn]", "[seeds[i] for i in range(len(turn))]",
        "where episodes run in turns, each turn has the starts of the first",
        ("runs/test_evaluate.py::test_episodes_in_turns_are_those_side_by_side",),
    ),
    Mutant(
        "late-picture", "tasks/carla_server.py", "if image.frame == self.frame:", "if image.frame <= self.frame:",
        "a picture of an earlier step counts as that of this one",
        ("tasks/test_carla.py::test_pictures_that_come_late_are_dropped",),
    ),
    Mutant(
        "blue-first", "tasks/carla_server.py", "blue_first[:, :, 2::-1]", "blue_first[:, :, :3]",
        "pictures of CARLA have blue and red the wrong way round",
        ("tasks/test_carla.py::test_the_order_of_an_episode",),
    ),
    Mutant(
        "clock-left-standing", "tasks/carla_server.py", "lambda: self.world.apply_settings(settings),", "lambda: None,",
        "a CARLA server is left in synchronous mode",
        ("tasks/test_carla.py::test_the_order_of_an_episode",),
    ),
    Mutant(
        "dark-pictures", "data/formats/flat_pictures.py", "(255.0 / most)", "1.0",
        "pictures that D4RL keeps as numbers from 0 to 1 become black",
        ("data/formats/test_flat_pictures.py::test_a_file_of_a_known_name_holds_pictures",),
    ),
    # ---- designers
    Mutant(
        "claim-weight", "mbo/nemo.py", "label_weight=setting.n / len(data)", "label_weight=1.0 / len(data)",
        "a claim counts less than a row of the data, by the number of designs",
        ("mbo/test_nemo.py::test_a_claim_counts_as_one_row_of_the_data",),
    ),
    Mutant(
        "lecun-bias", "nets/mlp.py", 'LECUN, TRUNCATED = Init("lecun", 0.0),', 'LECUN, TRUNCATED = Init("lecun"),',
        "biases begin at random",
        ("mbo/test_nemo.py::test_models_begin_as_lecun_s",),
    ),
    Mutant(
        "travel-cap", "mbo/nemo.py", "jnp.minimum(high, origin + reach)", "high", "designs travel upwards without limit",
        ("mbo/test_nemo.py::test_designs_travel_no_further_than_they_may",),
    ),
    Mutant(
        "sum-unchecked", "mbo/constraints.py", "total == self.bound if self.equal", "True if self.equal",
        "sums that must equal a number are not checked", ("mbo/test_batch.py",),
    ),
    Mutant(
        "mixture-projected", "mbo/repair.py", "good, spent = self.good(x), 0.0", "good, spent = np.ones(len(x), bool), 0.0",
        "mixtures are projected in floating point alone", ("mbo/test_batch.py",),
    ),
    Mutant(
        "batch-known", "mbo/batch.py", "set() if repeat else", "set() if True else",
        "designs of the data are proposed", ("mbo/test_batch.py::test_designs_of_the_data_are_proposed_only_where_asked",),
    ),
    Mutant(
        "replicate-scatter", "mbo/replicates.py", "error = scatter / np.sqrt(count)", "error = scatter / count",
        "the standard error of a mean falls with the number of measurements",
        ("mbo/test_batch.py::test_replicates_are_pooled_with_their_noise",),
    ),
    Mutant(
        "unit-of-scores", "mbo/calibration.py", "1e-12 * (y.std() or 1.0)", "1e-12",
        "intervals of small scores are told to hold, and do not",
        ("mbo/test_validation.py::test_the_unit_of_the_scores_does_not_matter",),
    ),
    Mutant(
        "rows-for-designs", "mbo/validation.py", "len(np.unique(data.x, axis=0)) == len(data) and len(parts)", "len(parts)",
        "replicates of few designs pass for rows that the model has not seen",
        ("mbo/test_validation.py::test_replicates_of_few_designs_are_not_taken_for_rows_that_the_model_has_not_seen",),
    ),
    Mutant(
        "levels-ascend", "mbo/constraints.py", "if self.levels is None else value", "if True else value",
        "levels that are numbers are compared by their places",
        ("mbo/test_rules.py::test_levels_that_are_numbers_are_compared_as_numbers_in_whatever_order_they_stand",),
    ),
    Mutant(
        "one-grid", "mbo/grids.py", "COARSER = (0, 1, 2, 3, 4, -1, -2, -3)", "COARSER = (0,)",
        "sums whose weights need a finer grid than the usual one are called impossible", ("mbo/test_lattice.py",),
    ),
    Mutant(
        "bounds-rounded-out", "mbo/variables.py", "low, high = _within(float(low), 1), _within(float(high), -1)", "pass",
        "proposals lie beyond bounds of more digits than 32 bits hold",
        ("mbo/test_rules.py::test_proposals_do_not_lie_beyond_bounds_as_they_are_written",),
    ),
    Mutant(
        "best-forbidden", "mbo/baselines.py", "rows if data.repair.free else", "rows if True else",
        "the best of the data are proposed against the rules",
        ("mbo/test_rules.py::test_the_best_of_the_data_are_those_that_the_rules_allow",),
    ),
    Mutant(
        "few-held-out", "mbo/validation.py", "max(parts.sum() // 5, ENOUGH)", "parts.sum() // 5",
        "a handful of rows calibrates an interval of 95 %",
        ("mbo/test_validation.py::test_a_method_that_is_fitted_once_holds_out_enough_to_calibrate_by",),
    ),
    Mutant(
        "conformal-rank", "mbo/calibration.py", "(n + 1) * LEVEL", "n * LEVEL",
        "intervals lack the correction for few rows",
        ("mbo/test_gp.py::test_the_factor_is_the_quantile_with_its_correction",),
    ),
    Mutant(
        "effect-average", "mbo/effects.py", "    mean = each.mean(1)\n", "    mean = each[:, 0]\n",
        "what a variable does on average is what it does in the first row",
        ("mbo/test_effects.py::test_averages_are_those_of_the_model_over_the_rows",),
    ),
    Mutant(
        "average-covariance", "mbo/process.py", "self.y_std**2 * (prior - white @ white.T)", "self.y_std**2 * prior",
        "averages over designs are as unsure as without data",
        ("mbo/test_effects.py::test_averages_of_the_process_have_the_covariance_of_its_posterior",),
    ),
    Mutant(
        "mixture-room", "mbo/effects.py", "return np.where(held, part, scaled)", "return part",
        "the other parts of a mixture make no room for the one that changes",
        ("mbo/test_effects.py::test_parts_of_a_mixture_make_room_for_one_another",),
    ),
    Mutant(
        "choice-greedy", "mbo/first_choice.py", "value = low if np.isfinite(low).all()",
        "value = made.predicted if np.isfinite(low).all()",
        "the one to try is that of the highest prediction, however unsure",
        ("mbo/test_effects.py::test_the_one_to_try_is_that_of_the_best_lower_end_near_the_data",),
    ),
    Mutant(
        "noise-praised", "mbo/first_choice.py", "made.fitted is None or made.by_chance", "made.fitted is None",
        "a proposal is preferred by a model that has learned nothing",
        ("report/test_design_page.py::test_of_noise_nothing_is_praised",),
    ),
    Mutant(
        "interval-turned", "mbo/first_choice.py", "return (high, low) if data.minimise else (low, high)", "return low, high",
        "the ends of intervals of costs are swapped",
        ("mbo/test_effects.py::test_columns_beside_proposals_are_in_the_targets_sign",),
    ),
    Mutant(
        "pooled-row-numbers", "mbo/replicates.py",
        "replicates=count, std_error=error, table_rows=data.numbered(first)",
        "replicates=count, std_error=error, table_rows=None",
        "rows of pooled designs are not called as the table has them",
        ("mbo/test_effects.py::test_columns_beside_proposals_are_in_the_targets_sign",),
    ),
    Mutant(
        "sheet-formula", "data/formats/xlsx_out.py", "return cell(shown(", "return (shown(",
        "spreadsheets hold texts that are formulas in another program",
        ("data/formats/test_xlsx_out.py::test_texts_of_cells",),
    ),
    Mutant(
        "chance-counted-once", "mbo/validation.py", "(2.12 if self.crossed else 1.06)", "1.06",
        "noise that agrees with itself in cross-validation passes for a relation",
        ("mbo/test_gp.py::test_of_tables_without_any_relation_few_pass_for_some",),
    ),
    Mutant(
        "interval-without-noise", "mbo/gp.py", "measured = np.hypot(std, process.noise)", "measured = std",
        "the factor of measurements is put on the deviation of the mean",
        ("mbo/test_gp.py::test_intervals_are_for_one_new_measurement",),
    ),
    Mutant(
        "noise-of-a-pooled-row", "mbo/replicates.py", "(data.replicates - 1.0) *", "0.0 *",
        "one new measurement has as little noise as the mean of several",
        ("mbo/test_gp.py::test_intervals_are_for_one_new_measurement",),
    ),
    Mutant(
        "fold-noise-usual", "mbo/gp.py", "process.noise if error is None else process.noise_of(error)", "process.noise",
        "rows out of fold are judged by the usual noise, not by their own",
        ("mbo/test_gp.py::test_a_row_out_of_fold_is_judged_by_its_own_noise",),
    ),
    Mutant(
        "auto-no-tie", "mbo/auto.py", "rank[best] - rank[0] <= error", "rank[best] - rank[0] <= 0",
        "another method is taken for a difference that is chance",
        ("mbo/test_auto.py::test_the_best_order_is_taken_unless_the_process_is_as_good",),
    ),
    Mutant(
        "best-of-several-by-chance", "mbo/validation.py", "1 - CHANCE / self.tried", "1 - CHANCE",
        "the best of several methods is praised for what chance gives",
        ("mbo/test_auto.py::test_of_noise_no_method_is_praised",),
    ),
    Mutant(
        "slices-from-below", "mbo/hypervolume.py", "y = y[np.argsort(-y[:, -1], kind=\"stable\")]",
        "y = y[np.argsort(y[:, -1], kind=\"stable\")]", "hypervolumes are summed from the wrong end",
        ("mbo/test_front.py::test_hypervolumes_have_their_closed_forms",),
    ),
    Mutant(
        "front-not-updated", "mbo/front.py", "np.concatenate([front, y[i : i + 1]])", "front",
        "designs of a batch for several targets do not know of each other",
        ("mbo/test_front.py::test_the_batch_is_chosen_given_those_before",),
    ),
    Mutant(
        "coverage-own-fold", "mbo/validation.py", "self._calibration(~held)", "self._calibration(held)",
        "designs judge themselves",
        ("mbo/test_gp.py::test_the_factor_is_the_quantile_with_its_correction",),
    ),
    Mutant(
        "nemo-phase", "mbo/nemo.py", "% settings.model_updates == settings.model_updates - 1",
        "% settings.model_updates == 0", "designs move before their models have learned",
        ("mbo/test_nemo.py::test_designs_move_after_every_ratio_updates_of_the_models_and_not_while_these_are_pretrained",),
    ),
    Mutant(
        "nemo-bin-edge", "mbo/nml.py", "(jnp.arange(bins) + 0.5) / bins", "jnp.arange(bins) / bins",
        "bins are known by their lower edges",
        ("mbo/test_nemo.py::test_middles_of_bins_are_halfway_between_their_edges",),
    ),
    Mutant(
        "nml-own-model", "mbo/nml.py", "jnp.diagonal(own, axis1=0, axis2=2)", "own.mean(0)",
        "each bin's probability is the mean over all models",
        ("mbo/test_nemo.py::test_p_nml_takes_each_bin_from_its_own_model",),
    ),
    Mutant(
        "climb-descends", "mbo/surrogate.py", "jnp.clip(x + lr * slope, low, high)", "jnp.clip(x - lr * slope, low, high)",
        "designs go down",
        ("mbo/test_designers.py::test_proposals",),
    ),
    Mutant(
        "coms-margin-sign", "mbo/coms.py", 'slack = self.settings.margin - metrics["overestimation"]',
        'slack = metrics["overestimation"] - self.settings.margin',
        "the penalty falls where too much is promised",
        ("mbo/test_parts.py::test_a_penalty_grows_where_too_much_is_promised",),
    ),
    Mutant(
        "minimised-scores", "mbo/designs.py", "return -scores if self.minimise else scores", "return scores",
        "scores to be made small are shown with the wrong sign", ("mbo/test_designs.py",),
    ),
    Mutant(
        "mixture-variance", "mbo/forward.py", "jnp.sqrt(jnp.exp(2 * log_std).mean(0) + mean.var(0))",
        "jnp.sqrt(jnp.exp(2 * log_std).mean(0))", "members that disagree do not doubt",
        ("mbo/test_parts.py::test_a_mixture_is_unsure_of_what_its_members_are_unsure_of_and_disagree_on",),
    ),
    # ---- report
    Mutant(
        "percent-factor", "report/text.py", 'f"{100 * value:.1f}\\N{NO-BREAK SPACE}%"', 'f"{value:.1f}\\N{NO-BREAK SPACE}%"',
        "percentages are shares",
        ("report/test_text.py",),
    ),
    Mutant(
        "percent-chart", "report/curves.py", "series.append(_series(page, e, name, factor))",
        "series.append(_series(page, e, name))",
        "a chart in percent is drawn in shares",
        ("report/test_page.py::test_a_chart_in_percent_shows_percent",),
    ),
    Mutant(
        "score-scale", "tasks/task.py",
        "return 100.0 * (np.asarray(returns, np.float64) - self.random) / (self.expert - self.random)",
        "return 100.0 * (np.asarray(returns, np.float64) - self.random) / self.expert", "scores of the expert are not 100",
        ("tasks/test_maze2d.py",),
    ),
    Mutant(
        "overestimation-sign", "report/rows.py", "self.value - self.truth", "self.truth - self.value",
        "overestimation has the wrong sign",
        ("report/test_rows.py",),
    ),
    Mutant(
        "rows-worst-first", "report/rows.py", "r.worth.value, reverse=True)", "r.worth.value)",
        "the table begins with the worst",
        ("report/test_rows.py",),
    ),
    Mutant(
        "minus-sign", "report/text.py", 'else f"{value:,.0f}"', 'else f"{value / 1000:,.0f}"', "numbers of thousands lose them",
        ("report/test_text.py",),
    ),
    # ---- randomness
    Mutant(
        "purposes-by-place", "randomness.py", "numbers = [number(purpose) for purpose in purposes]",
        "numbers = list(range(len(purposes)))", "keys follow from the order of their purposes, not from the names",
        ("test_randomness.py",),
    ),
    Mutant(
        "host-purpose-forgotten", "randomness.py", "[seed, number(purpose), *counters]", "[seed, *counters]",
        "all draws on the host are the same", ("test_randomness.py",),
    ),
    Mutant(
        "key-split-and-folded", "agents/awac.py", 'keys(key, "target", "actor_loss")', "jax.random.split(key)",
        "a method splits its key in place of naming purposes", ("test_randomness.py",),
    ),
    Mutant(
        "recommend-nested-lock", "runs/attempt.py", "offline.judge_alone(runs, log, estimators, None, settings)",
        "offline.judge(runs, log, estimators, **vars(settings))", "the work takes the lock that whoever asked for it holds",
        ("runs/test_recommend.py::test_policies_learn_from_one_part_and_are_judged_by_the_other",),
    ),
    Mutant(
        "resamples-in-one-heap", "stats/bootstrap.py", "units * np.arange(len(part))", "0 * np.arange(len(part))",
        "all resamples are counted as one", ("stats/test_bootstrap.py",),
    ),
    Mutant(
        "brac-warm-start", "agents/brac.py", "jnp.where(step < self.warm_start, 0.0, q)", "q",
        "the actor follows critics that know nothing yet", ("agents/test_offline.py",),
    ),
    Mutant(
        "rem-two-mixtures", "agents/rem.py", "weights, value = target\n", "weights, value = target[0] ** 2, target[1]\n",
        "the mixture is not that of its target", ("agents/test_rivals.py",),
    ),
    Mutant(
        "mobile-temperature", "agents/mobile.py", "largest_temperature: ClassVar[float] = 1.0",
        "largest_temperature: ClassVar[float] = 9.0",
        "the temperature has no bound", ("agents/test_offline_mbrl.py",),
    ),
    Mutant(
        "jackknife-share", "stats/bootstrap.py", "* (1.0 - left_out) / np.sqrt(left_out", "/ np.sqrt(left_out",
        "the jackknife forgets how little each part leaves out", ("stats/test_means.py",),
    ),
    Mutant(
        "magic-critics", "ope/doubly_robust.py", "uncorrected * self._critics_errors(case, nuisances, begins)",
        "0.0 * uncorrected", "MAGIC's interval takes its critics for true",
        ("ope/test_exact.py::test_magic_with_critics_of_folds_lies_within_its_interval_as_often_as_promised",),
    ),
    Mutant(
        "gains-nuisance", "ope/select.py", "if found.nuisance is not None:", "if False:",
        "gains take critics for true that nothing corrects",
        ("ope/test_exact.py::test_magic_with_critics_of_folds_lies_within_its_interval_as_often_as_promised",),
    ),
    Mutant(
        "magic-going-on", "ope/weights.py", "goes[last] = False", "goes[self.ends] = False",
        "MAGIC takes episodes that are cut off for ended",
        ("ope/test_intervals.py::test_the_share_of_the_policys_episodes_that_go_on_by_hand",),
    ),
    Mutant(
        "magic-left-out", "ope/linear.py", "case.data.episodes / folds / float(judged.episodes.sum())", "1.0 / folds",
        "critics of folds forget what teaches all of them",
        ("ope/test_corrected.py::test_critics_of_folds_know_what_taught_them",),
    ),
    Mutant(
        "checkpoint-columns", "ope/fits.py", "{name: _digest(column) for", "{name: column.shape for",
        "a checkpoint of other folds is taken", ("ope/test_asked.py",),
    ),
    Mutant(
        "beyond-log", "ope/evaluated.py", "float(self._endless(part) @ going_on)", "0.0",
        "what lies beyond the recording is the log's share, whatever the policy does", ("ope/test_cut.py",),
    ),
    Mutant(
        "clipped-scale", "ope/behavior.py", "told - trained.view.log_scale_within(unit)", "told - trained.view.log_scale",
        "probabilities at the bounds of actions are divided by the unit, as densities are",
        ("ope/test_case.py::test_policies_are_divided_by_models_of_their_own_kind_whatever_the_unit",),
    ),
    Mutant(
        "clipped-for-all", "ope/importance.py", "which = np.flatnonzero(case.clips == clipped)",
        "which, clipped = np.arange(len(own)), bool(case.clips.any())",
        "a policy without probabilities at the bounds is divided by a model that has them, beside one that has",
        ("ope/test_case.py::test_policies_are_divided_by_models_of_their_own_kind_whatever_the_unit",),
    ),
    Mutant(
        "last-step-lost", "ope/linear.py", "last = self._last(sums, weight, ridge)\n", "pass\n",
        "a row of which nobody knows what follows teaches nothing, though nothing that follows counts",
        ("ope/test_cut.py::test_the_last_step_of_a_horizon_counts_though_nobody_knows_what_follows_it",),
    ),
    Mutant(
        "alone-lost", "ope/evaluated.py", "return self.discount == 0.0 or self.estimand.horizon == 1", "return False",
        "with a discount of zero rows are lost of which nobody knows what follows",
        ("ope/test_cut.py::test_of_rewards_that_nothing_follows_no_row_is_lost",),
    ),
    Mutant(
        "unsaid-learned", "dynamics/model.py", "known = ~jnp.isnan(target)\n", "known = jnp.ones_like(target, bool)\n    "
        "target = jnp.nan_to_num(target)\n",
        "models learn that nothing changes where a log does not say what an end led to",
        ("dynamics/test_ensemble.py::test_ends_of_which_a_log_does_not_say_what_they_led_to_teach_no_change",),
    ),
    Mutant(
        "marks-all-illegal", "dynamics/model.py", "legal = (marks > 0.5) | (marks == marks.max(-1, keepdims=True))",
        "legal = marks > 0.5", "a made-up observation in which no action is legal",
        ("ope/test_legal.py",),
    ),
    Mutant(
        "temperature-endless", "agents/sac.py", "jnp.minimum(value, math.log(HOTTEST))", "value",
        "the temperature of a target that no policy reaches rises for ever",
        ("agents/test_offline_mbrl.py::test_a_temperature_that_no_target_stops_has_an_end",),
    ),
    Mutant(
        "drawn-alike", "policies/table_predict.py", "rng = self.drawing if seed is None else np.random.default_rng(seed)",
        "rng = np.random.default_rng(0 if seed is None else seed)",
        "sampled actions without a seed are drawn alike in each call",
        ("policies/test_table_predict.py::test_sampled_actions_without_a_seed_are_drawn_anew_in_each_call",),
    ),
    Mutant(
        "estimate-beyond-range", "runs/realised.py", "if least >= high:\n", "if False:\n",
        "no return speaks against an estimate above the range",
        ("runs/test_monitor.py::test_an_estimate_above_the_range_of_the_reference_is_refuted",),
    ),
    Mutant(
        "memorised-drift", "runs/monitor.py", "compared.some(unseen if fresh else every,", "compared.some(every,",
        "actions in use are compared with those in rows that taught the policy",
        ("runs/test_monitor.py::test_what_a_policy_has_memorised_is_no_drift",),
    ),
    Mutant(
        "decision-outdated", "runs/decision_record.py", "return bool(own) and not any(is_same(policy, place) for place in own)",
        "return not own",
        "a page says DEPLOY of a policy that was trained further since it was judged",
        ("report/test_decision.py::test_a_policy_that_was_trained_further_is_not_deployed_by_what_was_judged",),
    ),
    Mutant(
        "digest-of-devices", "files.py", "    with opened(path) as file:",
        "    with open(path, \"rb\") as file:",
        "a decision from elsewhere has devices and pipes read",
        ("runs/test_decision_record.py::test_a_decision_from_elsewhere_opens_nothing_but_files",),
    ),
    Mutant(
        "alarm-lost", "cli/monitor.py", "            if not found.alarm:\n                raise\n",
        "            raise\n",
        "an alarm is lost where the page cannot be written",
        ("cli/test_monitor.py::test_an_alarm_is_told_where_the_page_cannot_be_written",),
    ),
    Mutant(
        "crash-is-alarm", "cli/main.py", "_FAILED = 70",
        "_FAILED = 1",
        "a command that fails has the exit code of an alarm",
        ("cli/test_monitor.py::test_a_command_that_fails_is_no_alarm",),
    ),
    Mutant(
        "proposals-sign", "mbo/designer.py", "seconds=seconds, minimise=data.minimise)",
        "seconds=seconds)",
        "predictions of a target to be made small are shown with the other sign",
        ("report/test_notebook.py::test_proposals_for_a_target_to_be_made_small_have_its_sign",),
    ),
    Mutant(
        "number-as-level", "runs/explain.py", "if each.role == \"observation\" and each.kind == \"category\":",
        "if each.role == \"observation\":",
        "a number is explained as a level",
        ("runs/test_explain.py::test_a_number_whose_column_is_called_as_a_level_keeps_its_threshold",),
    ),
    Mutant(
        "log-decades", "mbo/repair.py", "if step is not None and i not in self.loose:",
        "if step is not None:",
        "a column on a log scale loses its small decades where a rule is about it",
        ("mbo/test_rules.py::test_rules_leave_a_variable_on_a_log_scale_all_its_decades",),
    ),
    Mutant(
        "distance-of-runs", "mbo/nn_distance.py", "if (alike := data.recipes).max() + 1 < len(z):",
        "if (alike := data.recipes).max() + 1 < 0:",
        "the usual distance is that of runs of one recipe",
        ("mbo/test_nn_distance.py::test_runs_of_a_recipe_whose_settings_are_logged_do_not_shrink_the_unit",),
    ),
    Mutant(
        "failed-again", "mbo/nn_distance.py",
        "return data.x if data.unscored is None else np.concatenate([data.x, data.unscored])", "return data.x",
        "runs that failed are proposed again",
        ("mbo/test_design_tables.py::test_runs_without_a_score_are_not_proposed_again",),
    ),
    Mutant(
        "slack-absolute", "mbo/effects.py", "size = terms.sum(0), np.maximum(np.abs(terms).sum(0), abs(bound))",
        "size = terms.sum(0), np.maximum(1.0, abs(bound))",
        "a rule in a small unit counts for nothing",
        ("mbo/test_effects.py::test_rules_count_in_any_unit",),
    ),
    Mutant(
        "batch-unranked", "mbo/designer.py", "value = value or order",
        "pass",
        "designs that coincide are replaced by any neighbours",
        ("mbo/test_batch.py::test_a_method_that_predicts_an_order_alone_fills_its_batch_by_it",),
    ),
    Mutant(
        "log-ends", "report/design_edges.py", "if v.log else found",
        "if False else found",
        "ends on a log scale are told by differences",
        ("report/test_design_page.py::test_ends_on_a_log_scale_are_told_by_its_decades",),
    ),
    Mutant(
        "factor-shared", "ope/linear_sums.py",
        "return int(policy == self.logged and not np.array_equal(self.lost_rows[:, 0], self.lost_rows[:, 1]))",
        "return int(self.lacks_rows(policy))", "the behaviour policy is solved with the factor of more rows",
        ("ope/test_cut.py::test_the_behaviour_policy_has_a_factor_of_its_own_rows",),
    ),
    Mutant(
        "imputed-zeros", "dynamics/autoregressive.py", "jax.lax.cond(known.all(), lambda: target, drawn)", "0.0",
        "ends and rewards of unknown successors are conditioned on no change",
        ("dynamics/test_ensemble.py::test_such_ends_are_drawn_as_often_as_they_happen",),
    ),
    Mutant(
        "history-moves-on", "data/history.py", "self._before(self.log.ends + known, ", "self._before(self.log.ends + 1, ",
        "histories move on where it is not known what followed",
        ("data/test_history.py::test_what_follows_repeats_the_last_row_where_it_is_not_known",),
    ),
    Mutant(
        "unknown-learned", "ope/critics.py", 'error * extra["known"].T if "known" in extra else error', "error",
        "critics of the behaviour policy learn that its last action goes on",
        ("ope/test_cut.py::test_what_the_behaviour_policy_would_do_next",),
    ),
    Mutant(
        "returns-unrounded", "runs/realised.py",
        "x = np.where(np.abs(x - edge) <= ROUNDING * (given[1] - given[0]), edge, x)", "x = x + 0.0",
        "a return that rounding puts beyond its range opens the interval",
        ("runs/test_monitor.py::test_a_return_at_the_end_of_its_range_is_within_it",),
    ),
    Mutant(
        "estimate-normal", "runs/realised.py", 'told[0].get("judged", {}).get("units", np.inf) - 1', "np.inf",
        "an estimate from few episodes is widened for its choice as if they were many",
        ("runs/test_monitor.py::test_the_estimate_of_one_of_many_is_taken_as_that_of_the_chosen",),
    ),
    Mutant(
        "single-certain", "stats/crossed.py", "elif 1 in (len(a), len(b)):", "elif len(a) == len(b) == 1:",
        "one seed in one episode counts as certain", ("stats/test_means.py::test_one_value_does_not_say_how_it_varies",),
    ),
    Mutant(
        "equal-ranked", "bench/tune.py", "min(np.ptp(means), np.ptp(standing)) > 0", "len(trials) > 1",
        "a search whose settings all score the same dies at its end",
        ("bench/test_tune.py::test_settings_of_equal_scores_have_no_order_that_estimates_could_find",),
    ),
    Mutant(
        "own-steps-fresh", "runs/online.py", "np.unique(np.concatenate([given, *own]))", "given",
        "an online run's own steps pass for episodes that it was not trained on",
        ("runs/test_online.py::test_its_own_steps_are_episodes_that_it_was_trained_on",),
    ),
    Mutant(
        "replay-fresh", "runs/gather.py", "made.seed == 0", "made.seed is None",
        "the training of the package's snapshots passes for a log that they have not seen",
        ("runs/test_offline.py::test_snapshots_have_seen_the_training_that_a_replay_log_repeats",),
    ),
    Mutant(
        "log-unread", "runs/gather.py", 'run.config["data"].get("provenance") or run.config.get("log_read")',
        'run.config["data"].get("provenance")',
        "how the log in an online run's replay was read is not known",
        ("runs/test_fine_tuned.py::test_how_its_log_was_read_and_what_was_held_out_together_are_known",),
    ),
    Mutant(
        "evaluations-stay", "runs/folder.py", 'for kind in ("metrics", "evaluations"):', 'for kind in ("metrics",):',
        "a run that ends sooner after its resume has an evaluation of a policy that is gone",
        ("runs/test_folder.py::test_what_is_beyond_the_checkpoint_is_forgotten",),
    ),
    Mutant(
        "seed-ignored", "runs/online.py", "if wanted != start.run.seeds:",
        "if seeds is not None and wanted != start.run.seeds:",
        "another seed of a fine-tuned run is ignored",
        ("runs/test_fine_tuned.py::test_other_seeds_than_those_of_the_run_are_refused",),
    ),
    Mutant(
        "hardly-begun", "runs/attempt.py", 'elif run.config["steps"] < FEWEST:', "elif False:",
        "a candidate of 60 updates is evaluated beside others",
        ("runs/test_recommend.py::test_a_candidate_that_hardly_began_is_left_out_beside_others",),
    ),
    Mutant(
        "noise-of-a-bad-row", "mbo/process.py",
        "float(np.average(np.square(data.std_error), weights=row_weights(data)))", "float(np.square(data.std_error).mean())",
        "one row with a very large standard error takes the noise from all others",
        ("mbo/test_gp.py::test_one_row_with_a_very_large_error_leaves_the_fit_to_the_others",),
    ),
    Mutant(
        "scale-of-a-bad-row", "mbo/process.py", "    weight = row_weights(data)\n", "    weight = np.ones(len(data))\n",
        "scores are standardised by one whose standard error is very large",
        ("mbo/test_gp.py::test_one_row_with_a_very_large_error_leaves_the_fit_to_the_others",),
    ),
    Mutant(
        "r2-of-a-bad-row", "mbo/validation.py",
        "np.average(np.square(y - of), weights=weight)", "np.average(np.square(y - of))",
        "R2 out of fold is that of one row with a very large standard error",
        ("mbo/test_gp.py::test_one_row_with_a_very_large_error_leaves_the_fit_to_the_others",),
    ),
    Mutant(
        "birge-ratio", "mbo/replicates.py", "return (chi2 / freedom) ** 0.5 if", "return 1.0 if",
        "standard errors that are too small for the scatter of replicates are believed",
        ("mbo/test_batch.py::test_standard_errors_are_not_believed_against_the_scatter_of_replicates",),
    ),
    Mutant(
        "errors-of-zero", "mbo/replicates.py", "return np.where(zero, used, error),", "return error,",
        "a measurement with the standard error 0 is exact",
        ("mbo/test_batch.py::test_a_standard_error_of_zero_is_unknown",),
    ),
    Mutant(
        "gain-over-the-luckiest", "report/design_advice.py", "row, expected = most_expected(data, made.fitted)",
        "row, expected = best_permitted(data), float(data.y[best_permitted(data)])",
        "a prediction is compared with the luckiest measurement, so that no gain is ever predicted in noise",
        ("report/test_design_page.py::test_a_gain_is_one_over_predictions_for_measured_designs_and_not_over_a_lucky_measurement",),
    ),
    Mutant(
        "member-of-each-call", "policies/table_predict.py", "if self.names is None:",
        "if True:",
        "each request of one episode gets another member of a mixture",
        ("policies/test_table_predict.py::test_a_mixture_keeps_its_member_for_an_episode",),
    ),
    Mutant(
        "greedy-beside-sampled", "runs/player.py",
        "for folder in (owner, owner.parent, *records_beside(owner, ESTIMATES)):",
        "for folder in (owner,):",
        "a run whose sampled actions were evaluated beside it acts greedily without a word",
        ("cli/test_predict.py::test_a_run_whose_sampled_actions_were_evaluated_beside_it_is_not_used_greedily_without_a_word",),
    ),
    Mutant(
        "diverged-steps-for-updates", "bench/claims.py", "scores.setdefault(ends[cell], scores[max(scores)])",
        "scores.setdefault(max(scores) + 1, scores[max(scores)])",
        "a run that diverged counts its last score for no time",
        ("bench/test_claims.py::test_an_online_run_that_diverged_keeps_its_last_score_for_all_of_its_updates",),
    ),
    Mutant(
        "half-cloned-lane", "online/demonstrated.py",
        "return jnp.where(failed.reshape(-1, *[1] * (leaf.ndim - 1)), jnp.nan, leaf)",
        "return leaf",
        "a lane whose cloning diverged runs on as if it had cloned",
        ("agents/test_dapg.py::test_a_lane_whose_cloning_diverges_stops_and_the_other_goes_on",),
    ),
    Mutant(
        "rates-in-one-decimal", "report/text.py",
        "digits = 1 if max(map(abs, together)) >= 10 or not any(together) else decimals(*together)",
        "digits = 1",
        "a success rate and both ends of its interval read 0.7",
        ("report/test_text.py",),
    ),
    Mutant(
        "one-draw-for-all", "collect/rollouts.py",
        "np.random.default_rng([*self.seed, int(self.episode[copy]), int(self.age[copy]) + 1])",
        "np.random.default_rng(self.seed)",
        "a function that collects a log draws the same action in every row",
        ("collect/test_rollouts.py::test_a_policy_of_ones_own_draws_by_seed_episode_and_step",),
    ),
    Mutant(
        "density-before-clipping", "collect/rollouts.py",
        "if isinstance(policy.inner, Gaussian) and not isinstance(policy.inner, ClippedGaussian):",
        "if False:",
        "actions that were clipped to a bound are logged with the density before clipping",
        ("collect/test_rollouts.py::test_densities_of_actions_that_are_clipped_afterwards_are_not_logged",),
    ),
    Mutant(
        "collected-in-whole-numbers", "collect/rollouts.py",
        'if self.low.dtype.kind == "i" and (wrong := (actions != given)[alive]).any():',
        'if self.low.dtype.kind == "i" and (wrong := (actions != actions)[alive]).any():',
        "a discrete action of 0.9 is logged as 0",
        ("collect/test_rollouts.py::test_discrete_actions_that_are_no_whole_numbers_are_refused",),
    ),
    Mutant(
        "nan-after-end", "runs/evaluate.py", "np.where(alive, rewards, 0.0)", "alive * rewards",
        "a reward that is no number, after an episode's end, makes its return none",
        ("runs/test_evaluate.py::test_rewards_after_an_episodes_end_are_not_looked_at",),
    ),
    Mutant(
        "near-repeats", "mbo/batch.py", "chosen.add(usable, n, apart, away)", "chosen.add(usable, n, apart)",
        "designs that are nearly measured ones are proposed as new",
        ("mbo/test_batch.py::test_near_repeats_of_the_table_are_proposed_only_where_asked_or_where_there_are_no_others",),
    ),
    Mutant(
        "log-moved-by-decades", "mbo/repair.py", "return np.where(self.logs, np.abs(x) * self.ratio, self.scale)",
        "return self.scale + 0.0 * x",
        "rules move a variable on a log scale by decades",
        ("mbo/test_rules.py::test_rules_move_a_variable_on_a_log_scale_by_shares_of_its_value",),
    ),
    Mutant(
        "log-moved-at-once", "mbo/projection.py", "share = 1.0 / far[:, None] if i < PASSES - 1 else 1.0", "share = 1.0",
        "rules move a variable on a log scale as far as they would by its first value",
        ("mbo/test_rules.py::test_rules_move_a_variable_on_a_log_scale_by_shares_of_its_value",),
    ),
    Mutant(
        "gain-beside-the-lucky", "mbo/front.py", "data[0].x[contenders(data[0], processes)]", "data[0].x[rows]",
        "the gain of a batch for several targets is that over the rows that were measured best, by noise too",
        ("mbo/test_front.py::test_rows_beside_the_measured_front_count_in_what_is_gained",),
    ),
    Mutant(
        "gain-without-doubt", "mbo/front.py", "if r2 < EXPLAINED]", "if r2 < 0.0]",
        "a gain among noise is stated without a word",
        ("report/test_design_page.py::test_a_gain_is_said_to_be_too_high_where_a_model_explains_little",),
    ),
    Mutant(
        "confounded-logs", "report/design_doubts.py",
        "seen = data.coordinates.encode(data.x)[:, : len(numeric)][:, varied]", "seen = data.x[:, columns]",
        "variables whose logarithms vary together pass for separate ones",
        ("report/test_design_page.py::test_variables_on_log_scales_that_vary_together_are_told",),
    ),
    Mutant(
        "costs-that-vary-a-little", "ope/costs.py",
        "ends[:, 2] += [shift for _, shift in rare]",
        "ends[:, 2] += [0.0 for _ in rare]",
        "rare costs that a policy's rows lack by chance count only where all other costs are equal",
        ("ope/test_losses.py::test_rare_costs_are_added_to_the_upper_end_also_where_costs_vary",),
    ),
    Mutant(
        "costs-of-the-lost", "ope/costs.py",
        "reliable = doubted(told, support)[1]",
        "reliable = np.ones(len(told.names), bool)",
        "a candidate whose weights are lost widens the cost intervals of all",
        ("ope/test_losses.py::test_a_cost_of_one_policy_does_not_depend_on_a_candidate_whose_weights_are_lost",),
    ),
    Mutant(
        "confounding-of-the-lost", "ope/confounding.py",
        "] if degenerate\n            else",
        "] if False\n            else",
        "bounds under confounding are stated for a policy without weights",
        ("ope/test_demands.py::test_bounds_of_a_policy_do_not_depend_on_one_whose_weights_are_lost",),
    ),
    Mutant(
        "converged-together", "ope/fits.py",
        "settled, worst = change <= SETTLED",
        "settled, worst = np.full(len(names), (change <= SETTLED).all())",
        "one policy whose critics still change keeps all from being deployed",
        ("ope/test_case.py::test_a_fit_has_converged_for_each_policy_by_itself",),
    ),
    Mutant(
        "stopped-by-nothing", "ope/critics.py",
        "jnp.where(known, rate * (loss - self.running), 0.0)",
        "rate * (loss - self.running)",
        "batches without rows of early stopping count as without loss",
        ("ope/test_case.py::test_batches_without_rows_of_early_stopping_say_nothing_about_the_loss",),
    ),
    Mutant(
        "stopped-by-few-rows", "ope/behavior.py",
        "if some >= CHECKED / 2 * total:",
        "if True:",
        "early stopping rests on a few rows where clusters are of unequal sizes",
        ("ope/test_case.py::test_early_stopping_has_half_of_its_share_of_the_rows_where_clusters_are_of_unequal_sizes",),
    ),
    Mutant(
        "episodes-of-a-second", "policies/table_predict.py",
        "texts = np.datetime_as_string(moments).tolist()",
        'texts = np.datetime_as_string(moments, unit="s").tolist()',
        "episodes that begin within one second are one",
        ("policies/test_table_predict.py::test_the_name_of_an_episode_is_the_whole_time_and_not_that_of_other_rows",),
    ),
    Mutant(
        "words-for-true", "policies/table_columns.py",
        'word_of_truth if self.places.keys() <= {"true", "false"} else str',
        "str",
        "a policy whose actions are yes and no cannot be used with legal actions",
        ("data/test_legal.py::test_actions_that_are_words_for_true_and_false",),
    ),
    Mutant(
        "constant-dimensions", "runs/explain.py",
        "/ max(int(np.isfinite(scale).sum()), 1)",
        "/ max(len(scale), 1)",
        "the effect of a column is divided by actions that never change",
        ("runs/test_explain.py::test_of_continuous_actions_it_is_the_share_of_their_variance",),
    ),
    Mutant(
        "ticks-of-three-digits", "report/axes.py",
        "max(3, _digits(tick, apart))",
        "3",
        "ticks of an axis are rounded to equal numbers",
        ("report/test_picture.py::test_ticks_are_told_apart",),
    ),
    Mutant(
        "alarm-in-a-closed-pipe", "cli/monitor.py",
        "    outcome(found)  # before",
        "    print(found, flush=True)  # before",
        "a reader that has gone makes an alarm a success",
        ("cli/test_monitor.py::test_a_reader_that_has_gone_does_not_change_the_exit_code",),
    ),
    Mutant(
        "longer-but-finished", "runs/folder.py",
        '"steps": config["steps"], "finished": False})',
        '"steps": config["steps"], "finished": True})',
        "a run that was killed while it was made longer counts as finished",
        ("runs/test_folder.py::test_what_follows_from_the_length_of_a_run_is_told_where_it_is_made_longer",),
    ),
    Mutant(
        "mixture-lost", "runs/crossfit.py",
        "        _begin(path, config, asked.resume)\n",
        """        _begin(path, config, asked.resume)
        for each in path.glob("mixture*.npz"):
            each.unlink()
""",
        "settings that are refused remove a finished mixture",
        ("runs/test_crossfit.py::test_what_is_refused_leaves_the_finished_mixture",),
    ),
    Mutant(
        "masks-of-jaxrl", "data/columns.py",
        '    if key == "masks":',
        "    if False:",
        "masks of JaxRL become an extra, and every termination a timeout",
        ("data/test_columns.py::test_end_flags_under_other_names_are_no_mere_extras",),
    ),
    Mutant(
        "levels-of-a-large-csv", "data/formats/spool.py",
        "self._typed(column, convert, kinds.get(name))",
        "self._typed(column, convert, None)",
        "levels such as 01 become numbers when a large CSV is read by parts, and match no level",
        ("data/formats/test_spool.py::test_levels_of_a_schema_that_look_like_numbers_stay_texts",),
    ),
    Mutant(
        "levels-of-a-large-parquet", "data/formats/stream.py",
        'with_dates(table, dates, levels_in({"schema": schema}).texts)',
        "with_dates(table, dates)",
        "levels that look like dates become timestamps in a table converted by parts",
        ("data/formats/test_stream.py::test_levels_of_a_schema_that_look_like_dates_stay_texts",),
    ),
    Mutant(
        "minari-integers-with-gaps", "data/formats/minari_rows.py",
        "return levels[:, None] if (np.diff(levels) == 1).all() else None",
        "return levels[:, None]",
        "integers with gaps are written to Minari outside of their space",
        ("data/formats/test_minari.py::test_integers_of_a_table_are_written_where_gymnasium_has_a_space_for_them",),
    ),
    Mutant(
        "times-of-texts", "data/draft.py",
        'able = [column for column in found if role != "time" or self.orders(column)] or found',
        "able = found",
        "a text named like a time takes the place of the step that orders the rows",
        ("data/test_frame.py::test_of_several_times_the_first_that_is_none_of_texts_orders_the_rows",),
    ),
    Mutant(
        "table-of-a-schema-replaced", "data/formats/io.py",
        "if exists and Path(table).exists() and place.samefile(table):",
        "if exists and Path(source).exists() and place.samefile(source):",
        "convert --force overwrites the table that the schema stands for",
        ("data/formats/test_io.py::test_convert_does_not_replace_the_table_that_a_schema_stands_for",),
    ),
    Mutant(
        "schema-of-a-large-table", "data/formats/stream.py",
        "table, ways = table_of(source)",
        "table, ways = source, None",
        "no advice is given about a table larger than memory if its schema's file is named",
        ("data/formats/test_spool.py::test_a_schema_in_the_place_of_a_large_table_is_converted_by_parts",),
    ),
    Mutant(
        "wide-header-without-commas", "data/formats/open_bandit.py",
        "except csv.Error:",
        "except UnicodeError:",
        "a wide table of semicolons or tabs is an uncaught error of the csv library",
        ("data/formats/test_vw.py::test_very_many_names_are_not_those_of_open_bandit",),
    ),
    Mutant(
        "newest-with-the-oldest", "data/formats/layout_rows.py",
        "    return order[1:]\n\n\ndef tianshou",
        "    return order\n\n\ndef tianshou",
        "the newest observation of a memory-saving buffer is paired with the oldest action",
        ("data/formats/test_layouts.py::test_a_buffer_that_keeps_no_next_observations_ends_with_the_one_written_last",),
    ),
    Mutant(
        "bounds-of-a-constant", "data/checks.py",
        "np.maximum(1.0, 1e-6 * np.abs(low))",
        "1.0",
        "a large action that never moves makes all training inputs NaN",
        ("data/test_dataset.py::test_an_action_that_never_moves_has_bounds_that_float32_holds",),
    ),
    Mutant(
        "empty-next-legal", "data/legal_columns.py",
        'last & (role == "next_legal")',
        "last & False",
        "legal actions have to be invented where nothing follows",
        ("data/test_legal.py::test_next_legal_columns",),
    ),
    Mutant(
        "horizon-and-unknown-ends", "data/formats/build.py",
        'given["final_known"] = known[last_rows(given | {"timeouts": timeouts}, rows)]',
        'given["final_known"] = known[last_rows(given, rows)]',
        "a horizon cuts no log whose last observations are not known",
        ("data/formats/test_tables.py::test_names_of_ours_with_texts_gaps_and_a_horizon",),
    ),
    Mutant(
        "ends-of-other-robots", "bench/plan.py",
        "None if rule is None else rule.name]",
        "None]",
        "logs of robots whose models end episodes by other rules are packed into one program",
        ("bench/test_filling.py::test_robots_of_one_shape_share_a_program_where_their_ends_have_no_part",),
    ),
    Mutant(
        "discounts-of-one-program", "bench/plan.py",
        "or [job.on, job.data], gamma, job.options",
        "or [job.on, job.data], None, job.options",
        "settings whose batches have other discounts are packed into one program",
        ("bench/test_filling.py::test_settings_share_a_program_unless_their_batches_have_discounts_of_their_own",),
    ),
    Mutant(
        "limits-not-passed-on", "runs/recommend.py",
        'options += ["--cost-limit", *named] if named else []',
        "options += []",
        "the command that evaluates trained candidates has no cost limit",
        ("runs/test_recommend.py::test_the_command_that_goes_on_decides_by_the_same_settings",),
    ),
    Mutant(
        "expectile-of-xql", "agents/xql.py",
        "if self.expectile != IQL.expectile:",
        "if False:",
        "a setting of XQL is taken and has no effect",
        ("agents/test_rivals.py::test_xql_refuses_an_expectile_which_it_has_no_use_for",),
    ),
    Mutant(
        "rare-costs-as-in-the-log", "ope/losses.py",
        "most = max(most, mean * units / count * float(limit))",
        "most = mean",
        "a limit holds only if rare costs are as frequent as this log happens to have them",
        ("ope/test_losses.py::test_by_hand",),
    ),
    Mutant(
        "baseline-that-changes", "ope/select.py",
        "settled[found.names.index(LOGGED)] < 1:",
        "False:",
        "gains count from a behaviour policy's value whose fit has not converged",
        ("ope/test_select.py::test_gains_over_a_behaviour_policy_whose_fit_has_not_converged_are_not_known",),
    ),
    Mutant(
        "judged-on-what-taught", "runs/offline.py", "held=episodes.held,",
        "held=None,",
        "policies are judged on the episodes that taught them, too",
        (
            "runs/test_offline.py::test_a_policy_is_judged_without_the_episodes_that_taught_it_or_else_not_deployed",
            "runs/test_recommend.py::test_policies_learn_from_one_part_and_are_judged_by_the_other",
        ),
    ),
    Mutant(
        "taught-and-deployed", "runs/offline.py", "case, estimators, seen=episodes.against, alpha=current.alpha,",
        "case, estimators, alpha=current.alpha,",
        "a policy is deployed by an estimate of the episodes that taught it",
        ("runs/test_offline.py::test_a_policy_is_judged_without_the_episodes_that_taught_it_or_else_not_deployed",),
    ),
    Mutant(
        "level-of-a-choice", "ope/select.py", "every = gains(first, alpha, known)",
        "every = gains(first, ALPHA, known)",
        "policies are chosen at 95 %, whatever level is asked for",
        ("ope/test_select.py::test_the_level_that_is_asked_for_decides",),
    ),
    Mutant(
        "level-of-a-decision", "ope/decide.py", "accept_model_based=accept_model_based, alpha=alpha)",
        "accept_model_based=accept_model_based)",
        "a decision does not hand its level on",
        ("ope/test_demands.py::test_the_level_of_a_decision_is_that_of_its_gains",),
    ),
    Mutant(
        "gains-bonferroni", "ope/select.py", "each = alpha / max(len(found.names) - 1, 1)",
        "each = alpha",
        "intervals of gains by draws, and of critics' errors, hold for one policy at a time",
        ("ope/test_select.py::test_intervals_by_draws_share_the_level_among_all_policies",),
    ),
    Mutant(
        "bootstrap-bonferroni", "ope/select.py", "min(found.ess[i], units), each)",
        "min(found.ess[i], units), alpha)",
        "intervals of gains by the bootstrap hold for one policy at a time",
        ("ope/test_select.py::test_intervals_by_draws_share_the_level_among_all_policies",),
    ),
    Mutant(
        "ensemble-bonferroni", "ope/select.py", "ensemble_interval(own, each)",
        "ensemble_interval(own, alpha)",
        "intervals of gains by an ensemble hold for one policy at a time",
        ("ope/test_select.py::test_intervals_by_draws_share_the_level_among_all_policies",),
    ),
    Mutant(
        "nuisance-bonferroni", "ope/select.py", "found.nuisance - found.nuisance[:, [logged]], each)",
        "found.nuisance - found.nuisance[:, [logged]], alpha)",
        "errors of critics are widened for one policy at a time",
        ("ope/test_select.py::test_errors_of_fitted_models_share_the_level_among_all_policies",),
    ),
    Mutant(
        "gains-level", "stats/inference.py", "simultaneous(paired[:, others], alpha, seed)",
        "simultaneous(paired[:, others], 2 * alpha, seed)",
        "gains of nothing are above zero twice as often as promised",
        ("ope/test_decide.py::test_gains_of_nothing_are_above_zero_as_often_as_promised",),
    ),
    Mutant(
        "tail-short", "ope/tail.py", "case.inflation[which] * pulls[:, None]",
        "0.1 * pulls[:, None]",
        "the interval of a tail is a tenth of what it should be",
        ("ope/test_demands.py::test_the_interval_of_a_tail_is_students_of_paired_influences",),
    ),
    Mutant(
        "tail-unpaired", "ope/tail.py", "episodes.means(own.influence - logged.influence)",
        "episodes.means(own.influence)",
        "the tail of the behaviour policy counts as known",
        ("ope/test_demands.py::test_the_interval_of_a_tail_is_students_of_paired_influences",),
    ),
    Mutant(
        "confounding-short", "ope/confounding.py", "error = self.case.inflation[which] * inference.errors",
        "error = 0.1 * inference.errors",
        "bounds for confounding have a tenth of their sampling error",
        ("ope/test_demands.py::test_no_confounding_is_the_gain_itself",),
    ),
    Mutant(
        "confounding-not-wider", "ope/confounding.py",
        "float(ends[0] - error[0] - self.wider), float(ends[1] + error[1] + self.wider)",
        "float(ends[0] - error[0]), float(ends[1] + error[1])",
        "bounds for confounding take learned propensities for right",
        (
            "ope/test_demands.py::test_learned_propensities_that_do_not_fit_widen_all_that_rests_on_whole_episodes",
            "ope/test_demands.py::test_no_confounding_is_the_gain_itself",
        ),
    ),
    Mutant(
        "costs-bonferroni", "ope/costs.py", "share = alpha / len(limits)",
        "share = alpha",
        "intervals hold for one cost at a time",
        ("ope/test_costs.py::test_several_costs_share_the_level",),
    ),
    Mutant(
        "costs-not-wider", "ope/costs.py", "np.append(own, 0.0) for name, own in found.diagnostics.items()}",
        "np.append(own, 0.0) for name, own in found.diagnostics.items() if name != \"normalising\"}",
        "totals of costs take learned propensities for right",
        ("ope/test_demands.py::test_learned_propensities_that_do_not_fit_widen_what_does_not_normalise",),
    ),
    Mutant(
        "demands-not-wider", "ope/decide.py", "return MOVED * moved_most(plain, doubted(plain, checked)[1])[1]",
        "return 0.0",
        "groups, tails and bounds take learned propensities for right where the estimator that decides normalises",
        ("ope/test_demands.py::test_learned_propensities_that_do_not_fit_widen_all_that_rests_on_whole_episodes",),
    ),
    Mutant(
        "groups-not-wider", "ope/groups.py", "np.maximum(factor, student) + wider",
        "np.maximum(factor, student)",
        "gains of groups take learned propensities for right",
        ("ope/test_demands.py::test_learned_propensities_that_do_not_fit_widen_all_that_rests_on_whole_episodes",),
    ),
    Mutant(
        "groups-without-student", "ope/groups.py", "parts.errors * np.maximum(factor, student)",
        "parts.errors * factor",
        "intervals of small groups have the degrees of freedom of the whole log",
        ("ope/test_demands.py::test_the_interval_of_a_group_is_by_the_larger_of_two_factors",),
    ),
    Mutant(
        "groups-students-alone", "ope/groups.py", "parts.errors * np.maximum(factor, student)",
        "parts.errors * student",
        "intervals of groups whose scores are skewed are too short to hold at once",
        ("ope/test_demands.py::test_the_interval_of_a_group_is_by_the_larger_of_two_factors",),
    ),
    Mutant(
        "groups-bonferroni", "ope/groups.py", "parts.student(level / max(int(known.sum()), 1))",
        "parts.student(level)",
        "intervals of small groups hold for one group at a time",
        ("ope/test_demands.py::test_the_interval_of_a_group_is_by_the_larger_of_two_factors",),
    ),
    Mutant(
        "guarantee-unpaired", "ope/guarantee.py", "lower((weights - 1.0) * gained",
        "lower(weights * gained",
        "a guarantee is of the value, not of the gain",
        ("ope/test_demands.py::test_a_guarantee_by_hand",),
    ),
    Mutant(
        "monitor-alarms", "runs/monitor.py", "VALUE, DRIFT, OUTSIDE = 0.5, 0.4, 0.1",
        "VALUE, DRIFT, OUTSIDE = 1.0, 1.0, 1.0",
        "the value, drift and what lies outside have the chance of a false alarm of all three, each",
        ("runs/test_monitor.py::test_all_that_may_be_reported_shares_the_chance_of_a_false_alarm",),
    ),
    Mutant(
        "monitor-sides", "runs/monitor.py", "DRIFT * alpha * len(own) / len(which)",
        "DRIFT * alpha",
        "drift of observations and of actions has the chance of a false alarm of both, each",
        ("runs/test_monitor.py::test_all_that_may_be_reported_shares_the_chance_of_a_false_alarm",),
    ),
    Mutant(
        "monitor-sequence", "runs/realised.py", "confidence_sequence(parts, given, 2 * alpha)",
        "confidence_sequence(parts, given, alpha)",
        "the realised value is shown at half of its level",
        ("runs/test_monitor.py::test_all_that_may_be_reported_shares_the_chance_of_a_false_alarm",),
    ),
    Mutant(
        "outside-bonferroni", "runs/compared.py", "epoch.alpha / len(names)",
        "epoch.alpha",
        "what lies outside is tested for one column at a time",
        ("runs/test_compared.py::test_what_lies_outside_is_tested_for_all_columns_at_once",),
    ),
    Mutant(
        "explain-rows", "runs/explain.py", "    return unit if len(np.unique(unit)) >= FEWEST else",
        "    return np.arange(len(rows)) if len(np.unique(unit)) >= FEWEST else",
        "rows of one episode count as fresh ones of each other",
        ("runs/test_explain.py::test_rows_of_an_episode_are_no_fresh_ones_of_each_other",),
    ),
    Mutant(
        "effective-floor", "stats/clusters.py", "    return float(n / (1.0 + (np.square(size).sum() / n - 1.0) * shared))",
        "    return max(n / (1.0 + (np.square(size).sum() / n - 1.0) * shared), float((size > 0).sum()))",
        "a few large clusters of like rows are worth as much as their number",
        ("stats/test_clusters.py::test_large_clusters_of_like_rows_are_worth_less_than_their_number",),
    ),
    Mutant(
        "atoms-apart", "stats/drift.py",
        "    cuts = np.unique(cuts + np.abs(cuts) * ROUNDING + np.minimum(SAME * usual, OWN * np.abs(cuts)))\n", "",
        "a bound that one sample has with fewer decimals counts as a change",
        ("stats/test_drift.py::test_an_atom_with_fewer_decimals_is_no_change",),
    ),
    Mutant(
        "walks-on", "theory/tabular.py", "state = np.where(alive, following, state)",
        "state = np.where(ends, state, following)",
        "episodes of tabular worlds walk on after their end",
        ("theory/test_tabular.py::test_an_episode_that_has_ended_stays_where_it_was",),
    ),
    Mutant(
        "last-elites", "dynamics/rollout.py", "jax.random.permutation(k_elites, elites) if n % elites else None", "None",
        "of few rows the last elites never predict any",
        ("dynamics/test_rollout.py::test_elites_predict_equally_often_where_rows_do_not_divide",),
    ),
    Mutant(
        "curve-of-log", "bench/claims.py", "ends = {cell: curve_end(job) for",
        "ends = {cell: curve_end(job) + job.options.get('log', {}).get('offline', 0) for",
        "the last score of a run that diverged counts for updates on a log before its curve began",
        ("bench/test_claims.py::test_the_curve_of_a_run_that_goes_on_from_a_log_ends_without_the_updates_on_it",),
    ),
    Mutant(
        "beside-others", "bench/claims_file.py", "other = [method for method in own if ways[0][method] != ways[1][method]]",
        "other = []",
        "two agents of one name are compared across suites as if they were one",
        ("bench/test_claims.py::test_what_is_compared_across_suites_is_the_same_method_by_the_same_protocol",),
    ),
    Mutant(
        "full-then-small", "bench/filling.py",
        "        if whole:  # what is done at full size needs no other\n", "        if False:\n",
        "a device runs at the CPU's size what is done at full size",
        ("bench/test_filling.py::test_what_is_done_at_full_size_is_not_run_at_the_other",),
    ),
    Mutant(
        "tuned-nan", "bench/tuned.py", "return -np.inf if trial.failure or not np.isfinite(mean) else mean", "return mean",
        "settings without a finite estimate have a place among the others",
        ("bench/test_tune.py::test_what_diverged_is_not_chosen",),
    ),
    Mutant(
        "offline-thrice", "bench/times.py",
        "(updates(job) / max(curve_end(job), 1) if offline and known_agent(job.agent) else 1.0)", "1.0",
        "longer runs are expected to learn from their log for longer",
        ("bench/test_ledger.py::test_longer_runs_that_go_on_from_a_log_learn_from_it_once",),
    ),
    Mutant(
        "fields-as-written", "bench/plan.py",
        "    fields = dict(sorted(with_field_names(type(designer(method.agent)), method.fields).items()))",
        "    fields = method.fields",
        "cells of designs have other names where a field is called otherwise",
        ("bench/test_suite.py::test_cells_are_the_same_by_whatever_name_of_a_field",),
    ),
    Mutant(
        "parts-renumbered", "runs/reading.py", "        if part and (alike := alike_in(data, read.episodes)).mean() > ALIKE:\n",
        "        if part and (alike := alike_in(data, read.episodes)).mean() > 1:\n",
        "training episodes in a file of their own look held out where episodes are equal",
        ("runs/test_equal_episodes.py::test_a_part_of_a_log_with_equal_episodes_is_not_taken_for_held_out",),
    ),
    Mutant(
        "unseen-by-chance", "runs/gather.py", "    own = _covers(g.read.episodes, data) if unseen else fold.max() >= 0",
        "    own = fold.max() >= 0",
        "of a new log a cross-fit is evaluated on what equals its own episodes alone",
        ("runs/test_equal_episodes.py::test_a_cross_fit_is_evaluated_on_all_of_another_log_whatever_equals_its_episodes",),
    ),
    Mutant(
        "mixture-whole", "runs/gather.py", '        if cross.config["deliver"] != "mixture":\n            return g.acting\n',
        "        return g.acting\n",
        "the mixture of a cross-fit cannot be evaluated on a new log",
        ("runs/test_equal_episodes.py::test_the_mixture_of_a_cross_fit_is_evaluated_on_another_log",),
    ),
    Mutant(
        "looks-by-chance", "runs/looks.py", "return shared > (min(self.alike, other.alike, MOSTLY) if two_logs else 0.0)",
        "return shared > 0.0",
        "looks at one log of few contexts count as looks at every other",
        ("runs/test_equal_episodes.py::test_looks_at_unrelated_logs_are_no_looks_at_each_other",),
    ),
    Mutant(
        "chances-as-given", "ope/tables.py", "told / told.sum(1, keepdims=True)", "told",
        "probabilities that sum to a little more than one make a policy better",
        ("ope/test_rounding.py::test_probabilities_that_sum_to_nearly_one_are_normalised",),
    ),
    Mutant(
        "rounding-gains", "ope/select.py", "low, high = np.minimum(low, middle - least), np.maximum(high, middle + least)",
        "pass",
        "a rounding error is a gain",
        ("ope/test_select.py::test_a_gain_that_is_a_rounding_error_is_not_above_zero",),
    ),
    Mutant(
        "log-probs-ignored", "ope/tables.py", 'if tells is None and not getattr(self.policies[which], "has_log_prob", False):',
        "if tells is None:",
        "log-probabilities that a policy gives of discrete actions are not used",
        ("ope/test_rounding.py::test_log_probabilities_of_discrete_actions_are_used",),
    ),
    Mutant(
        "bound-is-atom", "ope/case.py", "        if not self.clips.any():\n            return self.log_probs\n",
        "        if True:\n            return self.log_probs\n",
        "weights at the greatest and the least action depend on the unit of actions",
        ("ope/test_rounding.py::test_weights_do_not_depend_on_the_unit_of_actions",),
    ),
    Mutant(
        "atom-is-bound", "ope/case.py", "((logged == end).sum(0) == 1)", "((logged == end).sum(0) >= 1)",
        "where actions are clipped, their bounds have densities and no probabilities",
        ("ope/test_rounding.py::test_where_many_actions_are_clipped_a_bound_keeps_its_probability",),
    ),
    Mutant(
        "ties-fill-tails", "ope/tail.py", "np.square(below).sum() + left * np.square(at).sum()",
        "np.square(below).sum() + left**2 * np.square(at).sum()",
        "a tail rests on all episodes that are equal at its edge",
        ("ope/test_tail.py::test_a_tail_rests_on_as_many_episodes_as_fill_it_also_where_many_are_at_the_quantile",),
    ),
    Mutant(
        "sure-values", "ope/losses.py", "low[i] = min(low[i], found.value[i] - share * (own.min() - rewards.min()))", "pass",
        "the value of an arm none of whose rows has failed is certain",
        ("ope/test_losses.py::test_intervals_of_values_hold_where_successes_are_nearly_certain",),
    ),
    Mutant(
        "whole-losses", "ope/losses.py", "or case.data.successors is not None or not case.complete):",
        "or case.data.successors is not None or True):",
        "losses that a policy's episodes of several steps lack by chance are praised",
        ("ope/test_losses.py::test_losses_that_whole_episodes_lack_by_chance_are_not_praised",),
    ),
    Mutant(
        "one-row-of-others", "policies/table_rows.py",
        "            given and not any(map(_is_many, given.values()))\n", "            False\n",
        "a single row by none of the policy's columns is an internal error",
        ("policies/test_table_predict.py::test_a_mixture_keeps_its_member_for_an_episode",),
    ),
    Mutant(
        "order-of-equal-scores", "mbo/ram.py", "jnp.where(ordered, jnp.corrcoef(out, y)[0, 1], 0.0)",
        "jnp.corrcoef(out, y)[0, 1]",
        "a list of designs with the same score is taken for a fit that diverged",
        ("mbo/test_parts.py::test_a_list_whose_scores_are_all_the_same_has_no_order_and_is_no_failure",),
    ),
    Mutant(
        "auto-ends-with-one", "mbo/auto.py", "except DivergedError as error:", "except ZeroDivisionError as error:",
        "the default method ends with an error where one of the methods that it compares diverges",
        ("mbo/test_auto.py::test_a_method_that_diverges_is_left_out",),
    ),
    Mutant(
        "untested-is-sure", "mbo/fitted.py", "return mean, None\n        mean, factor",
        "return mean, covariance\n        mean, factor",
        "effects of a model that was not tested are called significant",
        (
            "mbo/test_effects.py::test_an_effect_is_told_from_none_or_depends_on_others",
            "report/test_design_page.py::test_of_a_model_that_was_not_tested_neither_effects_nor_intervals_are_known",
        ),
    ),
    Mutant(
        "untested-interval", "mbo/first_choice.py", "return None if made.quality is None else made.predicted_std",
        "return made.predicted_std", "the one to try has a 95 % interval that was never tested",
        (
            "mbo/test_effects.py::test_the_one_to_try_is_that_of_the_best_lower_end_near_the_data",
            "report/test_design_page.py::test_of_a_model_that_was_not_tested_neither_effects_nor_intervals_are_known",
        ),
    ),
    Mutant(
        "untested-gain", "mbo/front.py", "if made.quality is None or made.by_chance]", "if made.by_chance]",
        "a gain is stated for several targets, though a model was not tested",
        ("report/test_design_page.py::test_where_a_model_was_not_tested_no_gain_is_stated",),
    ),
    Mutant(
        "sums-of-indices", "mbo/doubts.py", "numbers = measured(variables, x)", "numbers = x",
        "a true sum with levels that are numbers is called false, and a false one passes",
        ("mbo/test_effects.py::test_sums_and_relations_of_a_table_count_levels_by_their_values_too",),
    ),
    Mutant(
        "hint-of-indices", "mbo/repair.py", "np.median(self.measured(self.data.x)[", "np.median(self.data.x[",
        "the hint to require a sum of 100 adds indices of levels",
        ("mbo/test_effects.py::test_sums_and_relations_of_a_table_count_levels_by_their_values_too",),
    ),
    Mutant(
        "taken-without-skill", "mbo/auto.py", "if best == 0 or 0 not in skilled:", "if best == 0:",
        "the process is taken though its order may be chance and that of another method is not",
        ("mbo/test_auto.py::test_a_method_without_skill_is_not_taken_where_another_has_skill",),
    ),
    Mutant(
        "best-without-skill", "mbo/auto.py", "best = max(skilled, key=lambda i: rank[i])", "best = int(np.argmax(rank))",
        "a method is taken whose predictions fall as the scores rise",
        ("mbo/test_auto.py::test_a_method_without_skill_is_not_taken_where_another_has_skill",),
    ),
    Mutant(
        "cuts-move-the-fixed", "mbo/effects.py", "column, values, fixed)", "column, values)",
        "curves around a proposal are of designs in which fixed values have changed",
        ("mbo/test_effects.py::test_cuts_move_nothing_that_is_fixed",),
    ),
    Mutant(
        "fixed-at-will", "mbo/effects.py", "good &= at_value(x[:, column], fixed)", "good &= True",
        "designs with other values than the fixed ones are drawn as allowed",
        ("mbo/test_effects.py::test_cuts_move_nothing_that_is_fixed", "mbo/test_effects.py::test_rules_count_in_any_unit"),
    ),
    Mutant(
        "low-scores-left-out", "mbo/designs.py", "drawn = rest[-len(drawn) :]", "pass",
        "a large table with few low scores is refused, as if all its scores were the same",
        ("mbo/test_gp.py::test_of_many_rows_with_few_low_scores_some_of_these_are_used",),
    ),
    Mutant(
        "one-fold-tests-nothing", "mbo/gp.py", "if self.folds == 1:", "if False:",
        "one fold of a cross-validation silently means that nothing is tested",
        ("mbo/test_gp.py::test_settings_of_the_process_that_test_nothing_are_refused",),
    ),
    Mutant(
        "no-seed-in-a-program", "mbo/protocol.py", "if together is not None and together < 1:", "if False:",
        "a negative number of seeds per program ends in an internal error",
        ("mbo/test_protocol.py::test_fewer_than_one_seed_in_a_program_are_refused",),
    ),
    Mutant(
        "constants-in-whole-numbers", "mbo/program.py", "if i in self.fixed or v.low == v.high:", "if i in self.fixed:",
        "a constant meets a condition by a whole number beside its value",
        ("mbo/test_rules.py::test_a_constant_that_is_no_whole_number_meets_a_condition_by_its_value",),
    ),
    Mutant(
        "pulled-off-fixed-values", "mbo/batch.py", "found[:, fixed] = here[:, fixed]", "pass",
        "designs that are moved near the data leave the fixed values, and are then dropped",
        ("mbo/test_batch.py::test_designs_that_are_moved_near_the_data_keep_fixed_values",),
    ),
    Mutant(
        "pulled-to-rows-out-of-reach", "mbo/batch.py", "nearest_scored(data, x, np.flatnonzero(room >= 0))",
        "nearest_scored(data, x)", "designs are moved towards rows that are too far by their fixed values alone",
        ("mbo/test_batch.py::test_designs_that_are_moved_near_the_data_keep_fixed_values",),
    ),
    Mutant(
        "pulled-beyond-constraints", "mbo/local_search.py", "x = data.repair.nearly(pulled(data, x, limit))",
        "x = pulled(data, x, limit).astype(np.float64)", "a search near the data leaves the linear constraints",
        ("mbo/test_batch.py::test_the_best_design_near_the_data_is_found_within_the_rules",),
    ),
    Mutant(
        "percent-as-it-was-written", "mbo/repair.py",
        "percent = sum_of([self.variables[column].name for column, _ in rule.weights], 100)",
        'percent = rule.text.removesuffix("= 1") + "= 100"',
        "the constraint that a message names for percentages cannot be read",
        ("mbo/test_design_tables.py::test_a_sum_of_percentages_that_a_message_names_can_be_said",),
    ),
    Mutant(
        "read-by-planned-runs", "mbo/design_table.py", "table, told = by_scored(table, dialect, told, targets, known)", "pass",
        "a word in a planned run makes a column of numbers one of texts",
        ("mbo/test_design_tables.py::test_rows_without_a_score_do_not_decide_how_a_column_is_read",),
    ),
    Mutant(
        "codes-as-numbers", "mbo/variables.py", r"""re.compile(r"[-+]?(?:(?:0|[1-9]\d*)(""", r"""re.compile(r"[-+]?(?:\d+(""",
        "codes such as 007 become numbers",
        ("mbo/test_design_tables.py::test_texts_that_are_all_numbers_are_read_as_numbers",),
    ),
    Mutant(
        "schema-names-the-data", "mbo/design_schema.py", 'asked.pop("name", name_of(path))', "name_of(path)",
        "a name of the data that a call gives beside a schema ends in a TypeError",
        ("mbo/test_design_schema.py::test_a_name_and_earlier_messages_may_be_given",),
    ),
    Mutant(
        "bench-finds-out-late", "cli/design.py",
        'check_known(name, **({"path": options.paths[name]} if name in options.paths else {}))', "pass",
        "an unknown problem is found after the problems before it were run",
        ("cli/test_design.py::test_bad_input_in_one_line",),
    ),
    Mutant(
        "oracle-of-no-score", "mbo/problems/gfp.py", 'y = numbers_of(str(place), table, "score", rows)',
        'y = np.asarray(table.column("score"), np.float64)[rows]',
        "scores of a problem's file that are no numbers end in a traceback",
        ("mbo/test_problems.py::test_no_oracle_is_trained_on_scores_that_are_missing",),
    ),
    Mutant(
        "oracle-before-designs", "mbo/problems/superconductor.py",
        'full = Designs(x, y, variables, "superconductor", "critical temperature, K")\n'
        '    judge = ORACLES[oracle](f"superconductor-{form}", x, y)',
        'judge = ORACLES[oracle](f"superconductor-{form}", x, y)\n'
        '    full = Designs(x, y, variables, "superconductor", "critical temperature, K")',
        "an oracle is trained on temperatures that are no numbers",
        ("mbo/test_problems.py::test_no_oracle_is_trained_on_scores_that_are_missing",),
    ),
    Mutant(
        "percentiles-unchecked", "mbo/problems/problem.py", "if not 0 <= least <= most <= 100:", "if False:",
        "percentiles of a problem beyond 100 end in a traceback",
        ("mbo/test_problems.py::test_names_options_and_missing_files",),
    ),
    Mutant(
        "fixed-values-compared", "mbo/constraints.py", '_fraction(right, v, name, "is fixed at")', "_fraction(right, v, name)",
        "a fixed value that is no number is refused as if it were a condition",
        ("mbo/test_rules.py::test_numbers_as_people_write_them",),
    ),
    Mutant(
        "edge-of-what-is-fixed", "report/design_edges.py", "for c, w in rule.weights if c not in fixed]",
        "for c, w in rule.weights]",
        "proposals at the edge of a rule are not told of, where one of its variables is fixed",
        ("report/test_design_page.py::test_the_edge_of_a_rule_is_where_no_step_of_what_is_free_fits",),
    ),
    Mutant(
        "levels-without-steps", "report/design_edges.py", "    if not v.leveled:\n        return np.full",
        "    if True:\n        return np.full",
        "proposals at the edge of a rule are not told of, where the next level is beyond it",
        ("report/test_design_page.py::test_the_edge_of_a_rule_is_where_no_step_of_what_is_free_fits",),
    ),
    Mutant(
        "ignored-and-described", "mbo/designs.py", "if column in {*ignore} - {*targets}]", "if False]",
        "options about ignored columns are accepted, whatever they say",
        ("mbo/test_design_schema.py::test_what_a_call_says_of_a_column_that_is_ignored_is_refused",),
    ),
    Mutant(
        "ignored-and-missing", "mbo/design_schema.py", 'asked["ignore"] = [*here, *strangers]',
        'asked["ignore"] = [*asked["ignore"], *strangers]', "a column that a schema ignores must be in every table",
        ("mbo/test_design_schema.py::test_a_column_that_the_schema_ignores_need_not_be_in_the_file",),
    ),
    Mutant(
        "no-interval-is-one", "ope/select.py",
        "low, high = np.minimum(low, middle - least), np.maximum(high, middle + least)",
        "low, high = np.fmin(low, middle - least), np.fmax(high, middle + least)",
        "an estimate without an interval has a narrow one",
        ("ope/test_select.py::test_an_estimate_without_an_interval_is_not_conclusive",),
    ),
    Mutant(
        "small-beside-large", "stats/drift.py", "np.minimum(SAME * usual, OWN * np.abs(cuts))", "SAME * np.ptp(pooled)",
        "a change of small values is no drift where some are large",
        ("stats/test_drift.py::test_large_values_hide_no_change_of_the_others",),
    ),
    Mutant(
        "looks-at-others", "runs/looks.py", "(min(self.alike, other.alike, MOSTLY) if two_logs else 0.0)",
        "(min(self.alike, other.alike) if two_logs else 0.0)",
        "a look at a file from which a row is gone is the first one where all episodes have equal ones",
        ("runs/test_equal_episodes.py::test_looks_at_nearly_the_same_episodes_count_whatever_equals_what",),
    ),
    Mutant(
        "parts-are-others", "runs/gather.py", "if data.selected or len(np.unique(episodes)) == data.episodes:",
        "if len(np.unique(episodes)) == data.episodes:",
        "on a part of its own log a cross-fit is evaluated by policies that were trained on it",
        ("runs/test_equal_episodes.py::test_a_part_of_its_own_log_is_no_other_log_for_a_cross_fit",),
    ),
    Mutant(
        "bounds-there-and-back", "ope/case.py",
        "within = np.where(lone[rows], view.from_unit(np.sign(unit[rows]) * WITHIN), actions[rows])",
        "within = view.from_unit(np.where(lone[rows], np.sign(unit[rows]) * WITHIN, unit[rows]))",
        "a clipped number of an action loses its probability beside one at an end of the data",
        ("ope/test_rounding.py::test_other_numbers_of_an_action_at_the_end_of_the_data_keep_their_probabilities",),
    ),
    Mutant(
        "nobody-follows", "ope/losses.py", "np.isfinite(every[:, 1]) & rows.any(1)", "np.isfinite(every[:, 1])",
        "a policy that no whole episode follows is an internal error",
        ("ope/test_losses.py::test_a_policy_that_no_whole_episode_follows_is_no_error",),
    ),
    Mutant(
        "collected-in-any-task-of-the-name", "collect/in_task.py",
        'extra |= {"task_fields": own} if (own := own_fields(task)) else {}',
        "own_fields(task)",
        "a killed log goes on in a task with another horizon",
        ("collect/test_rollouts.py::test_a_killed_log_is_gone_on_with_in_a_task_of_the_same_fields_alone",),
    ),
    Mutant(
        "resumed-in-any-task-of-the-name", "runs/folder.py",
        '"task", "task_fields", "seeds"',
        '"task", "seeds"',
        "an online run goes on in a task with another horizon",
        ("runs/test_online.py::test_a_run_is_gone_on_with_in_a_task_of_the_same_fields_alone",),
    ),
    Mutant(
        "evaluated-in-the-task-of-the-name", "runs/gather.py",
        'task = None if unnamed else run.config["task"]',
        'task = run.config["task"]',
        "a run in a task with other fields is evaluated in the one that its name finds, without a word",
        ("runs/test_online.py::test_a_run_is_gone_on_with_in_a_task_of_the_same_fields_alone",),
    ),
    Mutant(
        "wrappers-by-name-alone", "runs/online.py",
        'config["task_fields"] = own | task.described',
        'config["task_fields"] = own',
        "an online run goes on in wrappers with other arguments",
        ("runs/test_gymnasium_runs.py::test_wrappers_are_told_apart_by_their_arguments_when_a_run_is_gone_on_with",),
    ),
    Mutant(
        "task-fields-all-or-none", "tasks/registry.py",
        "if name not in found or found[name] != value}",
        "if name not in found}",
        "no field tells a changed task from the one of its name",
        ("tasks/test_gymnasium.py::test_fields_that_a_name_does_not_tell",),
    ),
    Mutant(
        "shared-in-new-wrappers", "tasks/gymnasium_task.py",
        "if other.unwrapped is made.unwrapped:",
        "if other is made:",
        "one environment in new wrappers is taken for new environments, and all copies step it",
        ("tasks/test_gymnasium.py::test_what_is_no_task_is_refused_in_one_line",),
    ),
    Mutant(
        "horizon-of-a-task-ignored", "tasks/gymnasium_task.py",
        "return keeping_horizon(made, limit)",
        "return made",
        "another horizon is ignored where a function gives a task",
        ("tasks/test_gymnasium.py::test_a_task_keeps_its_horizon_however_it_is_named",),
    ),
    Mutant(
        "options-of-a-task-ignored", "tasks/gymnasium_task.py",
        "        if options:\n            raise UserError(f\"task {path} is a Task",
        "        if not options:\n            raise UserError(f\"task {path} is a Task",
        "options of a task are ignored, and a task without them is refused",
        ("tasks/test_gymnasium.py::test_a_task_keeps_its_horizon_however_it_is_named",),
    ),
    Mutant(
        "choices-handed-out", "tasks/gymnasium_spaces.py",
        "return copy.deepcopy(self.choices[int(action)])",
        "return self.choices[int(action)]",
        "an environment that changes its action in place changes that action for good",
        ("tasks/test_gymnasium.py::test_environments_may_change_their_actions_in_place",),
    ),
    Mutant(
        "returns-for-scores", "tasks/antmaze.py",
        'gym_id="deadreckon/AntReach-v0", reference=None,',
        'gym_id="deadreckon/AntReach-v0", reference=Reference(0.0, 1.0, "returns as they are"),',
        "a return of 530 on open ground is shown as a score of 53,000",
        ("tasks/test_antmaze.py::test_returns_on_open_ground_have_no_scale",),
    ),
    Mutant(
        "ramp-drawn", "tasks/flow_env.py",
        "if np.isnan(place):",
        "if place < 0:",
        "the merge cannot be drawn while cars are on its ramp",
        ("tasks/test_gymnasium.py::test_flow_draws_a_merge_without_the_cars_on_its_ramp",),
    ),
    Mutant(
        "sumo-without-a-version", "tasks/flow.py",
        'return installed("libsumo")',
        "return {}",
        "logs and runs of Flow do not say which SUMO made them",
        ("tasks/test_simulators.py::test_versions_are_of_the_package_that_the_world_is_from",),
    ),
    Mutant(
        "buffer-left-large", "tasks/copies.py",
        "buffer.offheight, buffer.offwidth, model.vis.quality.offsamples = height, width, samples",
        "model.vis.quality.offsamples = samples",
        "a large picture enlarges the buffer of all pictures of the shared model",
        ("tasks/test_pixels.py::test_pictures_may_be_larger_than_the_models_own_buffer",),
    ),
    Mutant(
        "buffer-of-the-model", "tasks/copies.py",
        "max(height, size[0]), max(width, size[1])",
        "height, width",
        "pictures of more than 640 x 480 are refused as if OpenGL were missing",
        ("tasks/test_pixels.py::test_pictures_may_be_larger_than_the_models_own_buffer",),
    ),
    Mutant(
        "ids-without-a-horizon", "tasks/envs.py",
        'SimulatorEnv"\n        register(_task.gym_id, where, max_episode_steps=_task.horizon, ',
        'SimulatorEnv"\n        register(_task.gym_id, where, ',
        "environments of Adroit and others are said to have no time limit",
        ("tasks/test_gymnasium.py::test_our_own_say_their_horizon_and_end_there",),
    ),
    Mutant(
        "flat-images", "tasks/gymnasium_spaces.py",
        "picture = len(pixels) == 3 and min(pixels[:2]) >= PICTURE",
        "picture = min((*pixels, 0)[:2]) >= PICTURE",
        "an image without channels becomes a task that no agent can use",
        ("tasks/test_gymnasium.py::test_what_is_no_task_is_refused_in_one_line",),
    ),
    Mutant(
        "left-open", "tasks/turns.py",
        '        if hasattr(simulator, "close"):',
        '        if not hasattr(simulator, "close"):',
        "simulators, and a CARLA server's cars, are left open where a log has been collected",
        ("collect/test_rollouts.py::test_the_simulator_is_closed_whatever_ends_a_collection",),
    ),
    Mutant(
        "texts-written-as-numbers", "tasks/gymnasium_names.py",
        "type(found := _value(text)) is type(value) and found == value:",
        "str(_value(text)) == text:",
        "the option '1' of an environment comes back as the number 1",
        ("tasks/test_gymnasium.py::test_options_are_read_as_they_were_written",),
    ),
    Mutant(
        "not-reset-yet", "tasks/simulator_env.py",
        "        if self.simulator is None:\n            raise UserError(",
        "        if self.simulator is self:\n            raise UserError(",
        "an environment that has not been reset is said to be one that nothing draws",
        ("tasks/test_gymnasium.py::test_before_its_first_episode_an_environment_is_not_rendered",),
    ),
    Mutant(
        "wrappers-behind-options", "tasks/gymnasium_task.py",
        "name = PREFIX + spec.id + wrapped + written(own)",
        "name = PREFIX + spec.id + written(own) + wrapped",
        "the name of an environment in wrappers is read as an option of another value",
        ("tasks/test_gymnasium.py::test_wrappers_are_kept",),
    ),
    Mutant(
        "bodies-of-zeros", "tasks/morphology.py",
        "np.tile(task.usual, (copies, 1)) if designs is None",
        "np.zeros((copies, len(task.usual))) if designs is None",
        "the state of robots that have not been reset yet cannot be taken",
        ("tasks/test_morphology.py::test_goes_on_from_a_state_before_the_first_reset",),
    ),
    Mutant(
        "tuned-on-training-tasks-alone", "bench/tune.py",
        'if task.split == "evaluation":',
        'if task.split != "training":',
        "settings cannot be tuned in tasks that the thesis's Table D.3 does not split",
        ("tasks/test_simulators.py::test_tasks_that_the_thesis_does_not_split_belong_to_neither_part",),
    ),
    Mutant(
        "all-tasks-are-training", "tasks/task.py",
        'split: str = ""',
        'split: str = "training"',
        "tasks that the thesis's Table D.3 does not split are shown as training tasks",
        ("tasks/test_simulators.py::test_tasks_that_the_thesis_does_not_split_belong_to_neither_part",),
    ),
    Mutant(
        "unnamed-tasks-beside-named-ones", "runs/gather.py",
        'folder.policy(seed), read, task, unnamed)',
        "folder.policy(seed), read, task)",
        "a run in a task with other fields is evaluated in the task of the run beside it",
        ("runs/test_online.py::test_a_run_in_a_task_that_its_name_does_not_find_is_not_evaluated_in_the_task_of_another_run",),
    ),
    Mutant(
        "opened-again-in-any-task", "runs/online.py",
        'if task is None and "task_fields" in config:',
        "if False:",
        "a run that is to be opened again in the task of its name is not told which one is needed",
        ("runs/test_online.py::test_a_run_is_opened_again_in_its_own_task_alone",),
    ),
    Mutant(
        "opened-again-in-another-task", "runs/online.py",
        'differences(config, noted, ("task", "task_fields", "task_registered"))',
        'differences(config, noted, ("task",))',
        "a run is opened again in a task with another horizon",
        ("runs/test_online.py::test_a_run_is_opened_again_in_its_own_task_alone",),
    ),
    Mutant(
        "command-for-another-task", "report/provenance.py",
        'if "task_fields" in entry.config:',
        "if False:",
        "the command on a page makes a run in another task than the page's",
        ("report/test_online_runs.py::test_no_command_makes_a_run_in_a_task_that_its_name_does_not_find",),
    ),
    Mutant(
        "page-of-two-horizons", "report/entries.py",
        '(config["task"], json.dumps(config.get("task_fields"), sort_keys=True))',
        'config["task"]',
        "a report shows runs of two horizons as runs of one task",
        ("report/test_online_runs.py::test_runs_in_tasks_of_one_name_with_different_fields_are_not_shown_as_one_task",),
    ),
    Mutant(
        "page-in-the-task-of-the-name", "report/entries.py",
        'self.task_name in registry.names() and "task_fields" not in self.entries[0].config',
        "self.task_name in registry.names()",
        "a page shows runs in a changed task on the scale, or in the maze, of the unchanged one",
        ("report/test_online_runs.py::test_no_command_makes_a_run_in_a_task_that_its_name_does_not_find",),
    ),
    Mutant(
        "resumed-in-any-registered-task", "runs/folder.py",
        '"task_registered", "steps"',
        '"steps"',
        "an online run goes on in a task that was registered under the same name with another horizon",
        ("runs/test_online.py::test_a_registered_task_with_another_horizon_is_another_task",),
    ),
    Mutant(
        "collected-in-any-registered-task", "collect/in_task.py",
        'extra |= {"task_registered": registered} if (registered := registered_fields(task)) else {}',
        "registered_fields(task)",
        "a killed log goes on in a task that was registered under the same name with another horizon",
        ("collect/test_rollouts.py::test_a_killed_log_is_not_gone_on_with_in_another_registered_task_of_the_same_name",),
    ),
    Mutant(
        "environments-that-nothing-tells", "runs/online.py",
        'own.get("domain") == "gymnasium" and SPEC not in own',
        "False",
        "an online run goes on in an environment that may be another one, without a warning",
        ("runs/test_gymnasium_runs.py::test_going_on_in_an_environment_that_nothing_tells_from_others_is_warned_about",),
    ),
    Mutant(
        "horizon-beyond-a-simulators-own", "tasks/gymnasium_task.py",
        "limits = [env.unwrapped.task.horizon] if isinstance(env.unwrapped, SimulatorEnv) else []",
        "limits = []",
        "a task has a horizon of 500 steps whose episodes end after 200",
        ("tasks/test_gymnasium.py::test_a_horizon_is_within_a_time_limit_that_stays",),
    ),
    Mutant(
        "threads-for-every-task", "tasks/turns.py",
        "chosen = () if threads is None else (threads,)",
        "chosen = (threads,)",
        "a user's task whose simulate takes seeds alone cannot be evaluated",
        ("runs/test_evaluate.py::test_a_users_task_may_take_seeds_alone",),
    ),
    Mutant(
        "equal-horizons-accepted", "tasks/task.py",
        "if horizon is not None:\n        raise UserError(f\"{task.name} has a horizon of its own",
        "if horizon not in (None, task.horizon):\n        raise UserError(f\"{task.name} has a horizon of its own",
        "a task that has a horizon takes one, if it is equal",
        ("tasks/test_gymnasium.py::test_a_task_keeps_its_horizon_however_it_is_named",),
    ),
    Mutant(
        "classes-opened-twice", "tasks/gymnasium_task.py",
        "if isinstance(make, type):",
        "if False:",
        "looking up a class of environments opens two of them",
        ("tasks/test_gymnasium.py::test_a_class_is_opened_once_for_a_task",),
    ),
    # ---- D: the first four REPLACE entries of the same names, whose original text is gone; the others are new
    Mutant(
        "whole-numbers-lost", "mbo/designs.py",
        "table, restored = whole_again(table, [each for each in unsaid if each in floats])",
        "restored = []", "whole numbers of a data frame become others, where a planned run has an empty cell",
        ("mbo/test_design_tables.py::test_whole_numbers_stay_so_beside_the_missing_cell_of_a_planned_run",),
    ),
    Mutant(
        "numbers-as-levels", "mbo/variables.py", "else _kind_of_texts(filled(name, table, column, rows))",
        'else "categorical"', "numbers that are written as texts become categories",
        ("mbo/test_design_tables.py::test_texts_that_are_all_numbers_are_read_as_numbers",),
    ),
    Mutant(
        "measured-as-predicted", "mbo/baselines.py", "nan, seed, measured=True)", "nan, seed)",
        "measured scores of the best designs of the data are called predictions",
        ("report/test_design_page.py::test_scores_that_were_measured_are_not_called_predictions",),
    ),
    Mutant(
        "slack-of-bounds-absolute", "mbo/designs.py", "np.select([end == 0, np.isfinite(end)], [wide, np.abs(end)], 0.0)",
        "np.ones(len(end))",
        "bounds of small quantities are not checked", ("mbo/test_designs.py::test_proposals_of_people_are_checked",),
    ),
    Mutant(
        "slack-of-the-other-bound", "mbo/designs.py", "0.0) for end in (low, high))",
        "0.0) for end in (high, high))",
        "the lower bound of a variable over several decades is not checked",
        ("mbo/test_designs.py::test_proposals_of_people_are_checked",),
    ),
    Mutant(
        "planned-cells-of-another-form", "mbo/design_table.py", "yield alone | apart(sorted(planned - alone))",
        "yield planned",
        "all cells of planned runs are lost where one is a number of another form",
        ("mbo/test_design_tables.py::test_cells_of_planned_runs_are_kept_where_others_are_words",),
    ),
    Mutant(
        "levels-lost-by-planned-runs", "mbo/design_table.py", "known = known._replace(texts=known.texts | {*texts})", "pass",
        "a level that is no number is lost where it is in planned runs alone",
        ("mbo/test_design_tables.py::test_the_levels_that_are_said_decide_how_planned_runs_are_read",),
    ),
    Mutant(
        "numbered-levels-as-texts", "mbo/design_table.py",
        "for name, some in given.items() if not all(map(stored, some))}",
        "for name, some in given.items()}",
        "levels that are numbers are unknown where a planned run has a word",
        ("mbo/test_design_tables.py::test_the_levels_that_are_said_decide_how_planned_runs_are_read",),
    ),
    Mutant(
        "parquet-by-planned-runs", "mbo/design_table.py", 'if converts := kind != "parquet":', "if converts := True:",
        "texts of a Parquet file become numbers or not by what planned runs hold",
        ("mbo/test_design_tables.py::test_texts_of_parquet_are_not_converted_for_the_sake_of_planned_runs",),
    ),
    Mutant(
        "versions-as-numbers", "mbo/variables.py", '"categorical" if converted else _kind_of_texts',
        "_kind_of_texts", "versions such as 1.1 and 1.10 in a file with decimal commas become numbers",
        ("mbo/test_design_tables.py::test_what_a_reader_leaves_as_texts_is_no_number",),
    ),
    Mutant(
        "long-codes-refused", "mbo/variables.py", "if largest > (WHOLE if whole else float(np.finfo(np.float32).max)):",
        "if False:", "codes of many digits are refused as whole numbers that are too large",
        ("mbo/test_design_tables.py::test_codes_of_more_digits_than_designs_hold_stay_texts",),
    ),
    Mutant(
        "steps-of-whole-numbers", "mbo/designs.py", "numpy_floats(frame) - _not_whole(", "numpy_floats(frame) or _not_whole(",
        "numbers with half steps become whole ones by a missing cell, and the steps are refused",
        ("mbo/test_design_tables.py::test_what_is_said_of_other_numbers_makes_them_no_whole_numbers",),
    ),
    Mutant(
        "floats-of-python-as-whole", "mbo/design_table.py",
        "if isinstance(stored, np.dtype) and stored.kind == \"f\"}", "}",
        "Python's floats become whole numbers by a missing cell",
        ("mbo/test_design_tables.py::test_whole_numbers_stay_so_beside_the_missing_cell_of_a_planned_run",),
    ),
    Mutant(
        "asked-as-measured", "mbo/proposal_table.py", "elif made.measured:", "elif made.predicts:",
        "the score for which a diffusion model makes its designs is called measured",
        ("report/test_design_page.py::test_a_score_for_which_designs_are_made_is_not_called_measured",),
    ),
    Mutant(
        "measured-in-notebooks", "report/notebook.py", "how, what = made.how,", 'how, what = "predicted",',
        "a notebook calls the measured scores of the best designs predictions",
        ("report/test_notebook.py::test_proposals_for_a_target_to_be_made_small_have_its_sign",),
    ),
    Mutant(
        "best-of-one", "mbo/auto.py", "    if len(compared) == 1:\n", "    if False:\n",
        "of a single method it is said that it ranks best",
        ("mbo/test_auto.py::test_of_a_single_method_no_order_among_methods_is_told",),
    ),
    Mutant(
        "truths-as-texts", "mbo/design_table.py", "text := str(level).strip()).lower() in truths or is_number(text)",
        "text := str(level).strip()).lower() in () or is_number(text)",
        "a drafted schema is refused by its own file where a planned run has a word among truth values",
        ("mbo/test_design_tables.py::test_a_draft_of_a_schema_reads_its_file_whatever_planned_runs_hold",),
    ),
    Mutant(
        "fixed-read-once", "mbo/designs.py", 'rules["fixed"] = tuple(rules["fixed"] or ())',
        'rules["fixed"] = rules["fixed"] or ()',
        "fixed values from an iterator are lost",
        ("mbo/test_design_tables.py::test_fixed_values_may_come_from_an_iterator",),
    ),
    Mutant(
        "no-slack-at-zero", "mbo/designs.py", "[wide, np.abs(end)]", "[0.0 * wide, np.abs(end)]",
        "a rounding error at a bound of zero is refused",
        ("mbo/test_designs.py::test_rounding_at_a_bound_of_zero_is_no_error",),
    ),
    Mutant(
        "pareto-tail-size", "ope/pareto.py",
        "]))[1]), tail\n",
        "]))[1]), int(3 * np.sqrt(n)) if n > 225 else n // 5\n",
        "the lower bound of a tail's shape rests on weights that equal the threshold, to which nothing was fitted",
        ("ope/test_pareto.py::test_the_bound_rests_on_the_weights_that_the_tail_was_fitted_to",),
    ),
    Mutant(
        "range-with-a-fraction", "cli/tune.py", r'r"([^,]+?)\.\.', r'r"([^.,]+(?:\.\d+)?)\.\.',
        "a range whose low end has a fraction and an exponent is tried as one text",
        ("bench/test_sampler.py::test_ranges_are_read_and_checked",),
    ),
    Mutant(
        "best-of-one-evaluated", "report/simulated.py", 'tag("strong", found.standing,',
        'tag("strong", "Best in the simulator" if len(page.entries) > 1 else "In the simulator",',
        "a page stamps a run as the best though no other is evaluated",
        ("report/test_rows.py::test_a_run_that_is_not_evaluated_yet_is_not_beaten",),
    ),
    Mutant(
        "headline-of-other-runs", "report/decision.py",
        "if not any(is_from(of, place) for place in places(page)):", "if False:",
        "a decision on a policy of other runs is told of these",
        ("report/test_decision.py::test_estimates_of_other_runs_are_refused",),
    ),
    Mutant(
        "letters-by-locale", "files.py", 'temporary.write_text(text, encoding="utf-8")', "temporary.write_text(text)",
        "files are written in the encoding of the system, which other programs take for UTF-8",
        ("report/test_picture.py::test_letters_do_not_depend_on_the_locale",),
    ),
    Mutant(
        "page-replaces-a-table", "report/page.py", "    check_page(out)\n    return write_text(out, text)",
        "    return write_text(out, text)", "a page replaces a file that is no page",
        ("report/test_log_page.py::test_what_is_no_page_is_not_replaced",),
    ),
    Mutant(
        "requested-as-predicted", "report/design.py",
        "    if made.requested:\n        what, above", "    if False:\n        what, above",
        "scores for which designs are made are drawn as predictions",
        ("report/test_design_page.py::test_a_score_for_which_designs_are_made_is_not_called_measured",),
    ),
    Mutant(
        "state-without-words", "runs/recommend.py",
        '    "too few updates": "stopped after too few updates for an evaluation",\n', "",
        "the page of a recommendation shows an internal name of a state",
        ("runs/test_recommend.py::test_a_candidate_that_hardly_began_is_left_out_beside_others",),
    ),
    Mutant(
        "sequences-of-other-length", "mbo/problems/tfbind8.py", "if len(x) != len(y):", "if False:",
        "x and y of different lengths in a file of sequences end in a traceback",
        ("mbo/test_problems.py::test_arrays_that_are_no_sequences_of_dna",),
    ),
    Mutant(
        "numbers-as-texts-of-a-problem", "mbo/problems/problem.py",
        "if not (is_text(cells.type) or pa.types.is_null(cells.type)):", "if False:",
        "a column of numbers where a problem's file needs texts ends in a traceback",
        ("mbo/test_problems.py::test_files_that_hold_something_else",),
    ),
    Mutant(
        "long-ways-not-found", "collect/planner.py", "while (value != before).any():", "for _ in range(50):",
        "cells more than 49 moves from a goal count as cells that cannot reach it",
        ("collect/test_collect_maze2d.py::test_ways_may_be_long",),
    ),
    Mutant(
        "empty-rollouts-not-told", "online/branched_rollouts.py", "np.stack([read_array(self._file(path, t))",
        "np.stack([np.load(self._file(path, t), allow_pickle=False)",
        "an empty file of MBPO's rollouts ends in a traceback",
        ("online/test_branched_rollouts.py::test_damaged_rollouts_are_told",),
    ),
    Mutant(
        "sampled-beside-fixed-values", "mbo/ddom.py", "for b, e in zip(view.bounds, (seen.min(0), seen.max(0))))",
        "for b, e in ((view.low, seen.min(0)), (view.high, seen.max(0))))",
        "diffusion samples designs with any values of fixed variables, which are only replaced afterwards",
        ("mbo/test_parts.py::test_sampled_designs_have_the_fixed_values",),
    ),
    Mutant(
        "original-in-our-environment", "data/entries.py",
        "found is None or (found.elsewhere and version == ORIGINAL)", "found is None",
        "the Minari export of an original of another world names our environment",
        ("data/formats/test_flat_pictures.py::test_the_original_is_not_of_our_environment",),
    ),
    Mutant(
        "any-number-is-a-flag", "data/legal.py",
        'timeouts = flags(log, "timeouts", columns["timeouts"], rows).copy()',
        'timeouts = np.array(columns["timeouts"], bool).reshape(rows)',
        "beside legal actions a 2, or a number that is missing, ends an episode",
        ("data/test_legal.py::test_what_contradicts_is_refused",),
    ),
    Mutant(
        "any-number-is-a-known-end", "data/checks.py",
        'return flags(log, "final_known", columns["final_known"], episodes) if',
        'return np.array(columns["final_known"], bool) if',
        "a missing number, or one of another episode, says that a final observation is known",
        ("data/test_legal.py::test_what_contradicts_is_refused",),
    ),
    Mutant(
        "unknown-is-nan", "runs/recommend.py", '"-" if math.isnan(x) else', '"-" if x is None else',
        "the card of a recommendation shows nan where a value is not known",
        ("runs/test_recommend.py::test_estimates_that_are_there_are_the_card_even_if_the_check_hangs",),
    ),
    Mutant(
        "times-need-no-next-one", "data/draft.py",
        "(named or c in times or not roles.not_observed(c))", "(named or not roles.not_observed(c))",
        "a table with next observations and a time, but no episodes, is refused for want of the time's next observation",
        ("data/test_misreadings.py::test_a_time_without_episodes_is_an_observation_that_needs_a_next_one",),
    ),
    Mutant(
        "propensity-of-ours-left-out", "data/draft.py",
        'elif column == "propensity" and of_ours:', "elif False:",
        "a frame with our names loses the propensities that a file with the same names keeps",
        ("data/test_frame.py::test_a_propensity_beside_names_of_ours_is_one_as_in_a_file",),
    ),
    Mutant(
        "old-transformers-unread", "policies/portable.py", '("DecisionTransformerPolicy", {"wanted": "target_return"})',
        '("DecisionTransformerPolicy", {})', "policy files of the Decision Transformer from before are not read",
        ("policies/test_policies.py::test_files_with_old_names_are_read",),
    ),
    Mutant(
        "diverged-clone-goes-on", "collect/adroit.py", 'complete(job, f"{log.name}: its clone", lambda done: None, advice="")',
        "list(job.chunks())", "a clone that diverged collects a log",
        ("collect/test_collect_adroit.py::test_a_clone_that_diverges_ends_the_collection",),
    ),
    Mutant(
        "mixture-as-cross-fit", "ope/estimator.py",
        "differ = CROSSED if (case.cross_fitted & several).any() else MIXED", "differ = CROSSED",
        "a mixture that is drawn on another log is refused as policies of folds",
        ("ope/test_decide.py::test_a_mixture_over_folds_is_judged_by_the_policy_that_has_not_seen_the_episode",),
    ),
    Mutant(
        "baseline-anywhere", "ope/select.py", "if LOGGED in found.names[:-1]:", "if False:",
        "where the behaviour policy is not the last of an estimate, gains are told of other policies",
        ("ope/test_select.py::test_the_behaviour_policy_is_the_last_of_an_estimate",),
    ),
    Mutant(
        "effective-of-nothing", "ope/weights.py",
        "np.exp(log_weights - np.where(np.isfinite(top), top, 0.0))", "np.exp(log_weights - top)",
        "weights of which all are zero have no effective size",
        ("ope/test_pareto.py::test_effective_sizes_of_logarithms",),
    ),
    Mutant(
        "propensity-of-another-action", "data/draft.py", "of_ours = theirs and roles.ours", "of_ours = roles.ours",
        "the probability of a column called action is taken for that of another action",
        ("data/test_frame.py::test_a_propensity_beside_names_of_ours_is_one_as_in_a_file",),
    ),
    Mutant(
        "unclear-episodes-observed", "data/draft.py",
        "(named or c in times or not roles.not_observed(c))", "True",
        "columns of two episodes become observations beside next observations, in silence",
        ("data/test_misreadings.py::test_a_time_without_episodes_is_an_observation_that_needs_a_next_one",),
    ),
    Mutant(
        "stray-checkpoints", "training/checkpoint.py",
        "    if checkpoints(folder):\n", '    if any(folder.glob("[0-9]*.npz")):\n',
        "a copy of a file in a fit's folder keeps it from going on from a shorter one",
        ("training/test_fit.py::test_a_longer_fit_goes_on_from_a_shorter_one_whatever_else_lies_there",),
    ),
    Mutant(
        "later-logarithms-in-a-range", "bench/claims_file.py",
        'if first.range is not None and said.get("log", False):', "if False:",
        "the range of scores is that of their logarithms in a later stage of a claim",
        ("bench/test_claims_again.py::test_no_later_stage_of_a_test_with_a_range_takes_logarithms",),
    ),
    Mutant(
        "any-shift", "bench/methods.py", 'table.get("shift", 0), least=0)', "0, least=0)",
        "a shift that no run accepts is found in every job alone",
        ("bench/test_suite.py::test_a_shift_of_a_method_is_checked_when_the_suite_is_read",),
    ),
    Mutant(
        "one-choice-twice", "bench/sampler.py", "list(dict.fromkeys(values))", "list(values)",
        "the sampler takes equal values for different choices",
        ("bench/test_sampler.py::test_a_value_that_stands_twice_is_one_choice",),
    ),
    Mutant(
        "few-updates-untold", "runs/recommend.py", '(_few_updates(state, clock) if told["results"] else [])', "[]",
        "a card does not say that its candidates are hardly trained",
        ("runs/test_recommend.py::test_estimates_that_are_there_are_the_card_even_if_the_check_hangs",),
    ),
    Mutant(
        "battery-any-chances", "tasks/battery.py", "np.abs(chances.sum(-1) - 1.0).max() <= 1e-3", "True",
        "values are computed for probabilities that sum to more than 1",
        ("tasks/test_battery.py::test_probabilities_that_are_none_are_refused",),
    ),
    Mutant(
        "changes-of-rows-in-clusters", "stats/products.py", "    number = np.unique(cluster, return_inverse=True)[1]",
        "    number = np.arange(len(cluster))", "the users of a log are a change along it, because rows count and not clusters",
        ("ope/test_over_time.py::test_clusters_and_not_rows_count",),
    ),
    Mutant(
        "changes-in-many-tests", "stats/products.py", "min(min(found) * max(len(found) - 1, 1), 1.0)", "min(found)",
        "tests of changes along the log have no correction for their number",
        ("ope/test_over_time.py::test_the_p_value_is_that_of_a_regression_with_robust_errors",),
    ),
    Mutant(
        "changes-of-the-other-side", "ope/over_time.py",
        "    both = both - given @ np.linalg.solve(gram, given.T @ both)\n",
        "    both[:, time.shape[1] :] -= given @ np.linalg.solve(gram, given.T @ columns)\n",
        "a change along the log is tested against waves that other columns explain",
        ("ope/test_over_time.py::test_the_p_value_is_that_of_a_regression_with_robust_errors",),
    ),
    Mutant(
        "changes-with-many-regressors", "ope/over_time.py", "freedom=1 - given.shape[1] / rows", "freedom=1.0",
        "the errors of a test along the log do not count what its regressions have fitted",
        ("ope/test_over_time.py::test_the_p_value_is_that_of_a_regression_with_robust_errors",),
    ),
    Mutant(
        "tested-rows-at-equal-distances", "ope/over_time.py", "np.sort(rng.choice(len(log), most, replace=False))",
        "np.linspace(0, len(log) - 1, most).astype(int)", "the steps of long logs' episodes are taken for times",
        ("ope/test_over_time.py::test_steps_of_episodes_are_no_times",),
    ),
    Mutant(
        "a-table-of-every-row", "ope/over_time.py", "if table is not None and ROWS * len(table.seen) <= len(rows):",
        "if table is not None:", "a small log is never tested, because each of its rows has an indicator",
        ("ope/test_over_time.py::test_a_small_log_is_tested_too",),
    ),
    Mutant(
        "few-observations-in-a-line", "ope/over_time.py", "if table is not None and ROWS * len(table.seen) <= len(rows):",
        "if False:", "numbers of states are regressed on as if they had a size",
        ("ope/test_over_time.py::test_few_observations_are_regressed_on_one_by_one",),
    ),
    Mutant(
        "spreads-that-change", "ope/over_time.py", "np.concatenate([unit, np.square(unit)], 1)", "np.concatenate([unit], 1)",
        "a change of the spread of continuous actions is not seen",
        ("ope/test_over_time.py::test_the_behaviour_policy_may_change_in_continuous_actions",),
    ),
    Mutant(
        "a-stationary-system-is-adjusted", "ope/over_time.py", "if stationary or case.positions:", "if case.positions:",
        "what is said of a stationary system is ignored",
        ("ope/test_over_time.py::test_what_needs_no_adjustment_is_left",),
    ),
    Mutant(
        "positions-of-a-part", "ope/case.py", "return self._again(self.given, policies, held, self.positions)",
        "return self._again(self.given, policies, held, False)",
        "models of the whole log do not see the positions that they are evaluated with",
        ("ope/test_over_time.py::test_policies_do_not_see_positions_and_models_do",),
    ),
    Mutant(
        "tables-of-positions", "ope/evaluated.py", "return None if self.positions else self.once(", "return self.once(",
        "a small log has a cell for each position, of which a critic learns nothing",
        ("ope/test_over_time.py::test_a_small_log_is_tested_too",),
    ),
    Mutant(
        "habits-without-positions", "ope/evaluated.py", "Table.of(self.plain) if self.positions else self.table", "self.table",
        "what the behaviour policy does next is forgotten where models see positions",
        ("ope/test_over_time.py::test_next_actions_that_the_log_does_not_show_are_known_by_the_state_with_positions_too",),
    ),
    Mutant(
        "positions-by-the-start", "ope/positions.py", "log.starts[episodes] + 0.5 * log.lengths[episodes]",
        "log.starts[episodes]",
        "the position of an episode is that of its first row",
        ("ope/test_over_time.py::test_waves_are_cosines_of_the_middle_of_each_episode",),
    ),
    Mutant(
        "policies-see-positions", "ope/positions.py", "slice(more + part.start, more + part.stop)",
        "slice(part.start, part.stop)",
        "policies act on positions that only models should see",
        ("ope/test_over_time.py::test_policies_do_not_see_positions_and_models_do",),
    ),
    Mutant(
        "simulators-change", "runs/offline.py", "    if _simulated(data):\n", "    if False:\n",
        "logs of simulators are adjusted for changes along the log",
        ("ope/test_over_time.py::test_a_log_of_the_catalogue_is_that_of_a_simulator_and_stationary",),
    ),
    Mutant(
        "one-look-with-and-without-positions", "runs/offline.py", '(["positions"] if case.positions else [])', "[]",
        "the same episodes evaluated again as stationary are no other look",
        ("ope/test_over_time.py::test_a_log_of_the_catalogue_is_that_of_a_simulator_and_stationary",),
    ),
    Mutant(
        "changes-are-not-told", "ope/decide.py", "warnings=(*choice.warnings, change.words))", "warnings=choice.warnings)",
        "the card does not say that estimates are adjusted for changes along the log",
        ("ope/test_over_time.py::test_an_action_of_good_times_is_not_praised",),
    ),
    Mutant(
        "copies-split", "data/split.py", "if (found := log.copied) is None:", "if (found := log.copied) is not False:",
        "copies of an episode are in training and in held-out data",
        ("data/test_split.py::test_copies_are_held_out_together",),
    ),
    Mutant(
        "copies-by-chance", "data/repeats.py",
        "if len(often) >= _OWN * len(episodes) and (often > 1)[which].sum() <= _SHARED * many:",
        "if len(often) > 0:",
        "episodes that are equal by chance are one cluster",
        ("data/test_split.py::test_episodes_that_are_equal_by_chance_are_not_copies",),
    ),
    Mutant(
        "copies-first-in-time", "data/split.py", "np.maximum.at(last, cluster, np.arange(len(cluster)))",
        "last[cluster[::-1]] = np.arange(len(cluster))[::-1]",
        "where copies are held out by time, the first copy of an episode counts",
        ("data/test_split.py::test_copies_are_held_out_together",),
    ),
    Mutant(
        "copies-independent", "ope/evaluated.py", "return clusters_of(log)", "return np.arange(log.episodes)",
        "copies of an episode narrow intervals as independent ones do",
        ("ope/test_case.py::test_copies_of_episodes_add_nothing",),
    ),
    Mutant(
        "copies-untold", "runs/offline.py", 'if cluster is None and count is not None and count < judged["episodes"]:',
        "if False:", "a card does not say that episodes are copies",
        ("runs/test_offline.py::test_copies_of_episodes_are_counted_as_one",),
    ),
    Mutant(
        "neighbours-of-a-group", "data/neighbours.py", "None if group_of(log) is not None else ", "",
        "a group column is asked for where there is one",
        ("data/test_info.py::test_users_whose_rows_follow_each_other_are_told_if_no_column_names_them",),
    ),
    Mutant(
        "neighbours-in-any-order", "data/neighbours.py", "spearman(column[:-1], column[1:])",
        "spearman(column[1:], column[1:])",
        "episodes in random order are taken for those of users",
        ("data/test_info.py::test_users_whose_rows_follow_each_other_are_told_if_no_column_names_them",),
    ),
    Mutant(
        "order-in-sample", "mbo/over_time.py", "/ np.maximum(1.0 - np.square(vectors) @ kept, 1e-9)[:, None]", "",
        "whether a table changed is asked of rows that inputs were fitted to",
        ("mbo/test_over_time.py::test_errors_of_left_out_units_are_those_of_fits_to_the_others",),
    ),
    Mutant(
        "order-of-scores", "mbo/over_time.py", " or sorted_by(data.y):", ":",
        "a table in the order of its scores is said to have changed",
        ("mbo/test_over_time.py::test_other_tables_give_no_message",),
    ),
    Mutant(
        "order-by-chance", "mbo/over_time.py", "(p_value := p_of_change(data, moved)) >= LEVEL",
        "(p_value := p_of_change(data, moved)) >= 1.0",
        "any table whose inputs changed along its rows is said to have changed",
        ("mbo/test_over_time.py::test_other_tables_give_no_message",),
    ),
    Mutant(
        "order-unmoved", "mbo/over_time.py", "return order[found[order] > limit]", "return order",
        "a drift is reported although no input changed along with it",
        ("mbo/test_over_time.py::test_a_drift_without_a_change_of_inputs_biases_nothing",),
    ),
    Mutant(
        "weights-of-rows-ignored", "ope/decide.py", "if (weights := weights_of(case.given)) is not None:", "if False:",
        "policies are deployed by rows whose weights say that they are no sample of the population",
        ("ope/test_decide.py::test_rows_of_different_weights_deploy_nothing",),
    ),
    Mutant(
        "order-of-replicates", "mbo/over_time.py", "errors[rows] = np.linalg.solve(part, fitted[rows])", "pass",
        "replicates tell each other's time, so that a drift is not seen",
        ("mbo/test_over_time.py::test_errors_of_left_out_units_are_those_of_fits_to_the_others",),
    ),
    Mutant(
        "copies-of-empty-cells", "data/repeats.py", "return often[which] == 1", "return often[which] > 0",
        "episodes without known values are copies of each other",
        ("data/test_split.py::test_rows_of_empty_cells_are_not_copies",),
    ),
    Mutant(
        "copies-in-turns", "data/repeats.py", " and self.many <= _OFTEN * self.different", "",
        "contexts that take turns are a table that was stored often",
        ("data/test_split.py::test_contexts_that_take_turns_are_not_copies",),
    ),
    Mutant(
        "copies-of-training-are-fresh", "runs/gather.py", "return ~np.isin(alike, alike[~unseen])", "return unseen",
        "policies are evaluated on copies of their training episodes",
        ("runs/test_equal_episodes.py::test_copies_of_training_episodes_are_not_fresh",),
    ),
    Mutant(
        "copies-between-folds", "runs/gather.py", "left &= (fold >= 0) & _together(data, fold)", "left &= fold >= 0",
        "policies of folds are evaluated on copies of their training episodes",
        ("runs/test_equal_episodes.py::test_copies_of_training_episodes_are_not_fresh",),
    ),
    Mutant(
        "copies-of-older-runs", "runs/holdout.py", 'known.get("different") != different', "False",
        "an older run is continued on copies of its held-out episodes",
        ("runs/test_equal_episodes.py::test_an_older_run_is_not_continued_on_copies_of_its_held_out_episodes",),
    ),
    Mutant(
        "order-by-one-distance", "mbo/over_time.py", "if 0 < counts.sum() < len(counts):", "if False:",
        "with many inputs, a change with one of them is a change of the process",
        ("mbo/test_over_time.py::test_other_tables_give_no_message",),
    ),
    Mutant(
        "order-of-numbers-alone", "mbo/coordinates.py", "*(np.repeat(columns, n) for columns, n in self.groups)",
        "*(0 * np.repeat(columns, n) for columns, n in self.groups)", "a drift is blamed on another input than the category",
        ("mbo/test_over_time.py::test_a_category_is_named",),
    ),
    Mutant(
        "order-of-few-groups", "mbo/over_time.py", "if len(np.unique(cluster)) < GROUPS or units", "if units",
        "five groups tell a drift", ("mbo/test_over_time.py::test_few_groups_say_nothing_and_many_do",),
    ),
    Mutant(
        "products-of-few-clusters", "stats/products.py", "if centred and count > 1 else", "if False else",
        "a drift is not seen in rows of twenty groups",
        ("mbo/test_over_time.py::test_products_by_hand",),
    ),
    Mutant(
        "neighbours-exactly", "data/neighbours.py", "if again > _AGAIN and", "if False and",
        "users whose rows are mixed are not reported",
        ("data/test_info.py::test_users_with_the_same_features_in_all_their_rows_are_told",),
    ),
    Mutant(
        "copies-of-who-comes-again", "data/repeats.py", " and (often > 1)[which].sum() <= _SHARED * many:", ":",
        "visitors who come again are copies where they do the same",
        ("data/test_split.py::test_visitors_who_come_again_are_not_copies",),
    ),
    Mutant(
        "balance-untested", "ope/decide.py", "if (confounder := unbalanced(case, model)) is not None:", "if False:",
        "noise is deployed if the model of the behaviour policy has not learned a confounder",
        ("ope/test_balance.py::test_a_confounder_that_the_model_has_not_learned_deploys_nothing",),
    ),
    Mutant(
        "balance-of-few-events", "ope/balance.py", "np.sqrt(np.maximum(count * sums.var(0, ddof=1), known))",
        "np.sqrt(count * sums.var(0, ddof=1))",
        "propensities near one are said to be wrong where by chance all rows have the action",
        ("ope/test_balance.py::test_the_statistics_by_hand",),
    ),
    Mutant(
        "balance-of-impossible-actions", "ope/balance.py",
        "p_values += np.where(mean >= WEAK, stdtr(count - 1, -t), 1.0).tolist()",
        "p_values += stdtr(count - 1, -np.abs(t)).tolist()", "propensities are said to be wrong where an action is impossible",
        ("ope/test_balance.py::test_the_statistics_by_hand",),
    ),
    Mutant(
        "balance-however-weak", "ope/balance.py", "WEAK = 0.1\n", "WEAK = 0.0\n",
        "a dependence that is too weak to matter is an objection where there are many rows",
        ("ope/test_balance.py::test_a_weak_dependence_is_no_objection_however_many_rows_show_it",),
    ),
    Mutant(
        "balance-of-one-row", "ope/parts.py",
        "np.maximum(np.square(sums).sum(0), np.bincount(part, variance))",
        "np.square(sums).sum(0)", "learned probabilities of rare actions are said to be wrong for few events",
        ("ope/test_balance.py::test_rare_actions_are_not_accused",),
    ),
    Mutant(
        "dependence-untested", "ope/decide.py", "if (together := dependent(case, model)) is not None:", "if False:",
        "rows of users are independent if no column names them",
        ("ope/test_balance.py::test_rows_of_users_without_a_column_are_told",),
    ),
    Mutant(
        "dependence-on-effects", "ope/balance.py", "score -= score.mean()", "score -= 0.0",
        "an effect of the action is dependence", ("ope/test_balance.py::test_independent_rows_are_none",),
    ),
    Mutant(
        "dependence-of-sorted-rows", "ope/balance.py",
        "if (np.diff(taken == often) != 0).sum() < len(taken) / 50 or sorted_by(rewards):", "if False:",
        "rows that were sorted by their rewards are dependent", ("ope/test_balance.py::test_independent_rows_are_none",),
    ),
    Mutant(
        "monitored-neighbours", "runs/monitor.py", "lengths = compared.lengths_of(old, which, first, acts)",
        "lengths = {}",
        "rows of a slowly changing system are tested for drift as if they were independent",
        ("runs/test_monitor.py::test_rows_of_a_slowly_changing_system_are_compared_in_parts",),
    ),
    Mutant(
        "gains-of-the-past", "ope/decide.py", "choice = _demanded(choice, recent.low, line)", "pass",
        "a policy that was good in the past alone is deployed",
        ("ope/test_latest.py::test_what_was_good_only_before_is_not_deployed",),
    ),
    Mutant(
        "a-system-that-never-changes-has-a-latest-third", "ope/decide.py",
        "aged = not settings.stationary and bool(np.isfinite(choice.low))", "aged = bool(np.isfinite(choice.low))",
        "the gain in the latest third counts although the order of rows says nothing of time",
        ("ope/test_latest.py::test_what_was_good_only_before_is_not_deployed",),
    ),
    Mutant(
        "latest-of-a-list", "ope/latest.py",
        'place = np.argsort(np.argsort(case.held, kind="stable"), kind="stable")', "place = np.arange(count)",
        "the latest episodes are those that are named last",
        ("ope/test_latest.py::test_the_latest_are_those_of_the_log_and_not_of_the_list_of_held_out_episodes",),
    ),
    Mutant(
        "latest-always-counts", "ope/latest.py", "if not self.p_value < LEVEL:", "if self.why:",
        "a gain that has not changed must be significant in the latest third, too",
        ("ope/test_latest.py::test_what_does_not_change_is_left",),
    ),
    Mutant(
        "latest-apart-as-if-alone", "ope/latest.py", "change = parts.influence[:, 1:] - parts.influence[:, :1]",
        "change = parts.influence[:, 1:]",
        "the test of a change ignores the error of the gain before",
        ("ope/test_latest.py::test_the_test_and_the_interval_are_those_of_two_samples",),
    ),
    Mutant(
        "latest-of-the-chosen", "ope/latest.py", "alpha / len(case.policies)", "alpha",
        "the interval of the latest gain does not know among how many policies its policy was chosen",
        ("ope/test_latest.py::test_the_test_and_the_interval_are_those_of_two_samples",),
    ),
    Mutant(
        "latest-of-a-few", "ope/latest.py", 'if doubt := next(filter(None, parts.why), ""):', "if doubt := (not count):",
        "a gain of a few latest episodes decides",
        ("ope/test_latest.py::test_too_few_episodes_or_degenerate_weights_say_nothing",),
    ),
    Mutant(
        "zeros-of-any-length", "data/late.py", "or count <= _LONGER * longest", "",
        "as many zeros at the end as in other places are said to be rewards that are not known yet",
        ("data/test_leaks.py::test_other_zeros_at_the_end_are_not_said_to_be_unknown",),
    ),
    Mutant(
        "zeros-by-chance", "data/late.py", "if chance > math.log(level) or ", "if ",
        "a few zeros at the end are said to be rewards that are not known yet",
        ("data/test_leaks.py::test_other_zeros_at_the_end_are_not_said_to_be_unknown",),
    ),
    Mutant(
        "zeros-of-a-sorted-table", "data/late.py", "or (np.diff(before) <= 0).all()", "",
        "the zeros of a table in the order of its rewards are said to be rewards that are not known yet",
        ("data/test_leaks.py::test_other_zeros_at_the_end_are_not_said_to_be_unknown",),
    ),
    Mutant(
        "rewards-to-come-in-use", "runs/monitor.py", "if by_policy and (line := rewards_to_come(new, RARE)) is not None:",
        "if (line := None) is not None:",
        "a policy in use seems to fail where rewards are not known yet, and nothing says so",
        ("runs/test_monitor.py::test_rewards_that_are_not_known_yet_are_told",),
    ),
    Mutant(
        "latest-of-given-up-actions", "ope/latest.py", "return Latest(parts.lacking[1], before=before, gain=gain)",
        "return Latest(parts.lacking[1])",
        "an action that was given up is deployed by what it did before",
        ("ope/test_latest.py::test_an_action_that_was_given_up_is_not_deployed",),
    ),
    Mutant(
        "latest-of-cross-fits", "ope/latest.py", "(parts.inflation * parts.correction).max()", "parts.correction.max()",
        "the test of a change takes cross-fitted policies for policies of other episodes",
        ("ope/test_latest.py::test_cross_fitted_policies_have_larger_errors",),
    ),
    Mutant(
        "continuous-columns-untested", "ope/balance.py", "or not (case.data.spec.discrete or learns(case, \"auto\"))",
        "or not case.data.spec.discrete",
        "learned densities of continuous actions are never tested for a dependence that they do not show",
        ("ope/test_balance.py::test_a_confounder_of_continuous_actions_is_named",),
    ),
    Mutant(
        "ranks-of-another-shape", "ope/balance.py", "out[a] = rank - rank.mean(),", "out[a] = rank - 0.5,",
        "actions whose distribution is skewed seem to depend on every column",
        ("ope/test_balance.py::test_other_shapes_of_continuous_actions_are_no_dependence",),
    ),
    Mutant(
        "densities-not-smoothed", "ope/behavior.py", "np.append((1.0 - smooth) * shares, smooth)", "np.append(shares, 0.0)",
        "one row of a small log has all of the weight, because a network finds its action impossible",
        ("ope/test_densities.py::test_densities_are_smoothed_towards_the_overall_density",),
    ),
    Mutant(
        "ranks-of-clipped", "policies/behavior.py", "action >= EDGE, 0.5 * (1.0 + below)", "action >= EDGE, below",
        "clipped actions seem to be too large wherever there are many",
        ("ope/test_densities.py::test_ranks_of_a_clipped_gaussian_have_their_middle_at_one_half",),
    ),
    Mutant(
        "one-model-of-densities", "ope/propensities.py",
        "shares = (_softmax(each.T, np.ones(each.T.shape, bool)).sum(0) + prior / count) / (n + prior)",
        "shares = (log_densities.sum(1) >= log_densities.sum(1).max()) + 1e-9",
        "a network that extrapolates finds an action impossible, and its row has all of the weight",
        ("ope/test_densities.py::test_shares_of_models_are_those_of_the_highest_likelihood",),
    ),
    Mutant(
        "ends-not-moved", "ope/behavior.py", "within_bounds(whole.data) if gaussian else whole.data", "whole.data",
        "a model of densities learns the least and the greatest action of a log, and of the others less",
        ("ope/test_densities.py::test_the_least_and_the_greatest_action_do_not_disturb_what_is_learned_of_the_others",),
    ),
    Mutant(
        "ends-of-many", "ope/ends.py", "max(FEW * len(log), ROWS)", "len(log)",
        "actions that are usual at a bound are taken for others",
        ("ope/test_densities.py::test_a_few_actions_near_a_bound_are_moved_and_many_are_left",),
    ),
    Mutant(
        "weights-at-the-bounds", "ope/importance.py", "own = case.learned_log_probs", "pass",
        "a row at a bound of the actions has all of the weight",
        ("ope/test_densities.py::test_no_row_has_all_of_the_weight_of_a_policy_as_wide_as_the_log_or_wider",),
    ),
    Mutant(
        "balance-of-another-model", "ope/balance.py", "clipped=bool(case.clips.all())", "clipped=False",
        "clipped actions are tested by a model that no weight uses",
        ("ope/test_balance.py::test_clipped_policies_are_tested_by_the_model_that_their_weights_use",),
    ),
    Mutant(
        "one-zero-at-the-end", "data/late.py", "if count < _LEAST or ", "if count < 1 or ",
        "a single return of 0 at the end is a reward that is not known yet",
        ("data/test_leaks.py::test_other_zeros_at_the_end_are_not_said_to_be_unknown",),
    ),
    Mutant(
        "spread-of-one-episode", "ope/estimates.py", "LEAST_ESS = 2.0", "LEAST_ESS = 1e-9",
        "a policy whose normalised weights rest on one episode has an interval of length zero",
        ("ope/test_select.py::test_weights_of_one_episode_tell_no_interval",),
    ),
    Mutant(
        "steepest-tail", "ope/pareto.py", "if above[-1] - above[(len(above) + 2) // 4 - 1] > STEEP:", "if False:",
        "weights that differ by more than floats can hold seem to have a light tail",
        ("ope/test_pareto.py::test_a_tail_beyond_floats_is_the_heaviest",),
    ),
    Mutant(
        "step-confounder", "ope/markov.py",
        '(_at_step, "the step of the episode", "add the step as a column"),',
        '',
        "a step of the episode by which actions and rewards change is no objection to ratios of occupancies",
        ("ope/test_markov.py::test_a_step_that_decides_actions_and_rewards_is_a_confounder",),
    ),
    Mutant(
        "step-without-actions", "ope/markov.py",
        'if p_too * len(groups) * len(actions) < TOO:',
        'if True:',
        "rewards that change with the step are an objection, although actions do not",
        ("ope/test_markov.py::test_a_step_that_actions_do_not_depend_on_and_one_that_is_observed_are_none",),
    ),
    Mutant(
        "errors-of-the-step", "ope/markov.py",
        'beyond[known] = own[known] - means_of(place, own[known])',
        'beyond[known] = own[known]',
        "rewards that change with the step seem to be effects of the previous action",
        ("ope/test_markov.py::test_a_step_that_actions_do_not_depend_on_and_one_that_is_observed_are_none",),
    ),
    Mutant(
        "rewards-left-out", "ope/markov.py",
        'if case.estimand.horizon is None and lost.sum() >= ROWS and p_value < LEVEL and abs(strength) >= WEAK:',
        'if False:',
        "rewards of rows without a known successor are left out, however they differ",
        ("ope/test_markov.py::test_rows_that_are_left_out_must_be_like_the_others",),
    ),
    Mutant(
        "ends-by-actions", "ope/markov.py",
        'if p_value * len(actions) < LEVEL and strength > 0 and seen >= OFTEN * expected:',
        'if False:',
        "an action that ends episodes without a terminal seems to have no such effect",
        ("ope/test_markov.py::test_rows_that_are_left_out_must_be_like_the_others",),
    ),
    Mutant(
        "rare-losses-of-occupancies", "ope/decide.py",
        'ratios = None if predicted is None else predicted.weights',
        'ratios = None',
        "a gain by ratios of occupancies may be that of losses which the policy's rows lack by chance",
        ("ope/test_markov.py::test_losses_that_rows_of_longer_episodes_lack_by_chance",),
    ),
    Mutant(
        "horizon-of-all-timeouts", "ope/estimand.py",
        'FIXED = 0.95',
        'FIXED = 1.0',
        "one recording that is a row shorter takes away the horizon of all others",
        ("ope/test_markov.py::test_a_few_shorter_recordings_do_not_change_the_horizon",),
    ),
    Mutant(
        "changes-of-level", "stats/serial.py",
        '1.0 + 2.0 * float((steps[1:] * steps[:-1]).mean() / np.square(steps).mean())',
        'spearman(values[:-1], values[1:])',
        "a change of level within the new log looks like rows that follow each other, and is not tested",
        ("runs/test_monitor.py::test_a_change_within_the_new_log_is_found_and_stays_found",),
    ),
    Mutant(
        "slow-dependence", "stats/serial.py",
        ' or _parts_differ(values)',
        '',
        "a slow dependence that noise hides is tested for drift as if there were none",
        ("stats/test_serial.py::test_slow_dependence_that_noise_hides_is_found_by_parts",),
    ),
    Mutant(
        "mixed-reference", "runs/compared.py",
        'left = [i for i in left if not order.follows(which[i], epoch.stop)]',
        'left = left',
        "rows that follow each other are compared with a reference whose rows were mixed",
        ("runs/test_monitor.py::test_a_log_whose_rows_were_mixed_says_nothing_of_their_order",),
    ),
    Mutant(
        "outside-in-parts", "runs/compared.py",
        'origin(log) // length if length else units_of(log)',
        'units_of(log)',
        "rows that follow each other are outside the log more often than chance explains",
        ("runs/test_compared.py::test_what_lies_outside_is_counted_in_parts_where_rows_follow_each_other",),
    ),
    Mutant(
        "threshold-of-four-digits", "runs/explained_tree.py", "if ((values <= each) == low).all()", "",
        "a threshold is rounded past values that the tree has on its other side",
        ("runs/test_explain.py::test_a_threshold_as_it_is_shown_divides_the_rows_as_the_tree_does",),
    ),
    Mutant(
        "skill-by-order-alone", "mbo/validation.py", "(self.rank_correlation > self.limit or self._close)",
        "(self.rank_correlation > self.limit)",
        "predictions of scores most of which are about zero are said to be chance, because the order of those is",
        ("mbo/test_validation.py::test_predictions_of_scores_most_of_which_are_nothing_are_no_chance",),
    ),
    Mutant(
        "offset-of-single-steps", "data/sizes.py", "mean = seen.mean if log.lengths.max() == 1 else np.zeros_like(seen.mean)",
        "mean = np.zeros_like(seen.mean)",
        "an offset of the rewards of single steps leaves differences too small to learn from",
        ("runs/test_sizes.py::test_an_offset_of_the_rewards_of_single_steps_changes_no_decision",),
    ),
    Mutant(
        "values-one-by-one", "runs/realised.py", "if serial.follows(returns, serial.ERRORS) else 1", "if False else 1",
        "returns that follow each other count as independent ones, and a value seems to be below its estimate",
        ("runs/test_monitor.py::test_the_value_of_a_slowly_changing_system_is_that_of_its_parts",),
    ),
    Mutant(
        "effects-that-cancel", "ope/markov.py",
        'groups = [known, *(known & (rows.taken == action) for action in frequent(rows.taken, ACTIONS, ROWS))]',
        'groups = [known]',
        "effects of the previous action that cancel over actions are not seen",
        ("ope/test_markov.py::test_effects_of_the_previous_action_that_cancel_over_actions_are_found",),
    ),
    Mutant(
        "steps-that-cancel", "ope/markov.py",
        '[case.followed, *parts],',
        '[case.followed],',
        "effects of the step that cancel over observations are not seen",
        ("ope/test_markov.py::test_effects_of_the_step_that_cancel_over_observations_are_found",),
    ),
    Mutant(
        "memory-of-the-behaviour", "ope/markov.py",
        'errors[: len(case.policies)]), default',
        'errors), default',
        "a behaviour policy with a memory is taken for a hidden state",
        ("ope/test_markov.py::test_a_behaviour_policy_with_a_memory_is_no_hidden_state",),
    ),
    Mutant(
        "losses-by-cluster", "ope/losses.py",
        'chance=max(lacks.chance, (1.0 - hit) ** Basis.of(found, i).rest[0])',
        'chance=lacks.chance',
        "losses of whole episodes that few episodes lack by chance are a gain",
        ("ope/test_markov.py::test_losses_of_whole_episodes_that_few_episodes_lack_by_chance",),
    ),
    Mutant(
        "later-rows-evaluated", "ope/carry_over.py", "(place[before] >= 0)", "(place[before] >= 0) & (place[after] >= 0)",
        "only evaluated rows are looked for behind evaluated rows, of which a fifth of a log has few",
        ("ope/test_carry_over.py::test_rows_are_followed_beyond_those_that_are_evaluated",),
    ),
    Mutant(
        "rows-that-take-turns", "ope/carry_over.py", "LAGS = 3", "LAGS = 1",
        "only the next row is looked at, which is another machine's where machines take turns",
        ("ope/test_carry_over.py::test_machines_that_take_turns_and_rewards_that_come_late",),
    ),
    Mutant(
        "later-rows-of-clusters", "ope/carry_over.py", "orders.append((rows[own], cluster[own]))", "pass",
        "the later rows of a user are not looked at where users take turns",
        ("ope/test_carry_over.py::test_machines_that_take_turns_and_rewards_that_come_late",),
    ),
    Mutant(
        "slow-effects", "ope/carry_over.py",
        "less(next_, standard(own)).T", "(next_ - next_.mean(0)).T",
        "a slow effect of an action on the next observation is hidden by the observation before",
        ("ope/test_carry_over.py::test_a_slow_effect_is_seen_behind_what_a_row_tells_of_the_next",),
    ),
    Mutant(
        "rewards-of-the-next-action", "ope/carry_over.py",
        "for name, part in later[follows:]:", "for name, part in later:",
        "where actions take turns, the effect of the next action seems to be one of the action before",
        ("ope/test_carry_over.py::test_what_follows_without_the_action_is_no_objection",),
    ),
    Mutant(
        "sorted-by-actions", "ope/carry_over.py", "if not _sorted(case.given, order, taken):", "if True:",
        "a log that is sorted by its actions seems to have actions that change what comes next",
        ("ope/test_carry_over.py::test_what_follows_without_the_action_is_no_objection",),
    ),
    Mutant(
        "marks-of-the-log", "data/formats/tables.py",
        "from_anybody(path, table, mapping, horizon, dialect=dialect)", "from_anybody(path, table, mapping, horizon)",
        "a policy forgets its log's decimal marks, and reads 6.096 of the next file as 6.096 instead of 6096",
        ("data/test_schema.py::test_a_drafted_schema_pins_the_dialect",),
    ),
    Mutant(
        "marks-of-no-cell", "data/formats/dialect.py",
        "None if self.unmarked else self.decimal", "self.decimal",
        "whole numbers beside semicolons settle that the next file has decimal points",
        ("data/formats/test_dialects.py::test_the_dialect_that_was_found",),
    ),
    Mutant(
        "earlier-doses", "runs/explain.py", "    shown = _in_units(data, steps, x)", "    shown = x",
        "an explanation's thresholds of earlier actions are those of the network, beside units of the log",
        ("runs/test_explain.py::test_thresholds_of_earlier_actions_have_the_logs_units",),
    ),
    Mutant(
        "rows-without-a-value", "runs/explained_tree.py",
        "np.float32(fills[which]) <= threshold", "np.float32(fills[which]) > threshold",
        "an explanation tells the wrong answer of rows without a value",
        ("runs/test_explain.py::test_a_question_says_how_rows_without_a_value_answer_it",),
    ),
    Mutant(
        "rows-of-pandas", "policies/table_rows.py", "    count, rows = None, _named(rows)", "    count = None",
        "a row of pandas is read by the position of its values, and not by their names",
        ("policies/test_table_encoder.py::test_a_row_with_names_is_read_by_them",),
    ),
    Mutant(
        "rows-of-sqlite", "policies/table_rows.py",
        "rows = list(map(_named, rows)) if isinstance(_named(rows[0]), Mapping) else rows", "rows = list(rows)",
        "rows of sqlite3 are read by the position of their values, and not by their names",
        ("policies/test_table_encoder.py::test_the_logs_own_rows_are_encoded_as_in_training",),
    ),
    Mutant(
        "masked-cells", "policies/table_rows.py", "        out[np.ma.getmaskarray(values)] = None\n", "",
        "values that are masked are taken for known",
        ("policies/test_table_encoder.py::test_the_logs_own_rows_are_encoded_as_in_training",),
    ),
    Mutant(
        "names-of-episodes", "policies/table_predict.py", "name = text_of(name)  # a request", "pass  # a request",
        "an episode 1 whose next request calls it \"1\" begins anew",
        ("policies/test_table_predict.py::test_an_episode_goes_on_whether_its_name_is_a_number_or_a_text",),
    ),
    Mutant(
        "no-spread-evaluated", "stats/crossed.py",
        "    if same(values):", "    if False:",
        "a policy that never succeeds in ten episodes is certain never to succeed",
        ("runs/test_train.py::test_interval_of_a_mean_by_hand",),
    ),
    Mutant(
        "episodes-of-the-log", "runs/diagnostics.py",
        "(returns - each * lengths)", "(returns - returns.mean())",
        "the interval of a log's mean reward per step is that of its episodes' returns",
        ("runs/test_train.py::test_logged_value_of_whole_episodes_and_of_cut_ones",),
    ),
    Mutant(
        "variance-of-tasks", "stats/comparison.py",
        "_moments(runs)[1] / len(tasks) ** 2", "_moments(runs)[1] / len(tasks)",
        "the interval of a mean over tasks is as wide as that of one",
        ("stats/test_scores.py::test_the_mean_over_tasks_has_students_interval",),
    ),
    Mutant(
        "same-but-for-rounding", "stats/interval.py", "ROUNDING = 1e-12", "ROUNDING = 0.0",
        "differences that are the same but for rounding decide a claim",
        ("stats/test_scores.py::test_differences_that_are_the_same_but_for_rounding_are_the_same",),
    ),
    Mutant(
        "logged-chances-of-later-rows", "ope/carry_over.py",
        "not log.spec.discrete or learns(case, \"auto\")\n", "True\n",
        "rows of users of two kinds, which logged propensities know, are an objection",
        ("ope/test_carry_over.py::test_logged_propensities_account_for_what_is_not_in_the_log",),
    ),
    Mutant(
        "marks-of-another-file", "data/formats/any_table.py", "        own = alone\n", "        pass\n",
        "a file with another separator, which is named, is read with the decimal marks of the log",
        ("data/test_schema.py::test_a_drafted_schema_pins_the_dialect",),
    ),
    Mutant(
        "rewards-that-are-empty", "data/encode.py", "(empty[[each == level for each in values]].mean()", "(empty.mean()",
        "an error about empty rewards tells the same share of them after all actions",
        ("data/formats/test_tables.py::test_empty_rewards_are_told_by_action",),
    ),
    Mutant(
        "newest-first", "data/row_order.py",
        "if not steps or any((each >= 0).all() for each in steps.values()):", "if not steps or True:",
        "nothing is said of single decisions of which the newest come first",
        ("data/test_misreadings.py::test_single_decisions_that_are_not_in_the_order_of_their_dates",),
    ),
    Mutant(
        "piles-by-action", "data/info.py", "rewards[taken == i]) for i, name", "rewards) for i, name",
        "rewards that were cut off are told as the same share of all actions",
        ("data/test_info.py::test_rewards_that_pile_up_at_a_value_are_told_by_action",),
    ),
    Mutant(
        "clusters-without-places", "ope/over_time.py", "(waves(log, episode), places(case.clusters, episode))",
        "(waves(log, episode),)", "an action of first contacts is praised, since no test looks along clusters",
        ("ope/test_over_time.py::test_an_action_of_first_contacts_is_not_praised",),
    ),
    Mutant(
        "models-without-places", "ope/positions.py", "np.concatenate([waves(log, each), places(clusters, each)], 1)",
        "waves(log, each)", "models do not see the position of an episode in its cluster",
        ("ope/test_over_time.py::test_places_are_cosines_of_their_ranks",),
    ),
    Mutant(
        "places-along-the-log", "ope/positions.py", "    place[order] = np.arange", "    place[:] = np.arange",
        "the positions in clusters are those of a sorted log",
        ("ope/test_over_time.py::test_places_are_cosines_of_their_ranks",),
    ),
    Mutant(
        "changes-along-clusters-untold", "ope/over_time.py",
        "within=min(found) < found[0] * (CLEARLY", "within=min(found) < 0.0 * (CLEARLY",
        "a change along clusters is told as one along the log",
        ("ope/test_over_time.py::test_an_action_of_first_contacts_is_not_praised",),
    ),
    Mutant(
        "changes-along-the-log-of-clusters", "ope/over_time.py", "CLEARLY = 1e-3", "CLEARLY = 1e9",
        "a change along the log is told as one along clusters",
        ("ope/test_over_time.py::test_a_change_along_the_log_is_told_where_users_come_in_turns",),
    ),
    Mutant(
        "failures-of-replicates", "mbo/unscored.py",
        "np.unique(data.unscored if data.passed is None else data.unscored[data.passed], axis=0)",
        "(data.unscored if data.passed is None else data.unscored[data.passed])",
        "each replicate of a design that failed counts as a failure",
        ("mbo/test_misfits.py::test_replicates_of_a_design_that_failed_are_one_failure",),
    ),
    Mutant(
        "errors-of-exact-scores", "mbo/misfits.py", "    beyond &= error > LARGE * ", "    beyond &= error > 0.0 * ",
        "the largest of tiny errors is told as an error",
        ("mbo/test_misfits.py::test_a_score_that_no_other_row_predicts_is_told",),
    ),
    Mutant(
        "totals-of-states-at-rest", "data/info.py", "return bool(slope > -_SURE * error)", "return True",
        "rewards of states that begin at rest are taken for running totals",
        ("data/test_info.py::test_running_totals_are_told",),
    ),
    Mutant(
        "names-behind-positions", "ope/row_order.py", "observation_names(case.plain)[-seen.count :]",
        "observation_names(log)[-seen.count :]", "a column is named by its place behind positions",
        ("ope/test_row_order.py::test_rows_whose_newest_comes_first_are_an_objection",),
    ),
    Mutant(
        "failures-untold", "mbo/unscored.py", "    if count <= MANY * (len(x) - 1):", "    if True:",
        "proposals among failed runs are told nowhere",
        ("mbo/test_misfits.py::test_proposals_among_failed_runs_are_told_on_the_card",),
    ),
    Mutant(
        "failures-not-on-the-card", "report/design_advice.py",
        "{_compared(data, made, chosen)}{_without_score(data, made, chosen)}",
        "{_compared(data, made, chosen)}",
        "the card does not say that rows without a score prevail around the proposal to try",
        ("mbo/test_misfits.py::test_proposals_among_failed_runs_are_told_on_the_card",),
    ),
    Mutant(
        "failures-of-one-row", "mbo/unscored.py", 'around = (near > 1) & (', 'around = (near > 0) & (',
        "a single row without a score counts as a region of failures",
        ("mbo/test_misfits.py::test_rows_without_a_score_are_counted_among_the_nearest",),
    ),
    Mutant(
        "errors-at-a-cliff", "mbo/misfits.py", '    beyond[beyond] = _apart(data, rows[beyond]) > FAR * usual\n', '',
        "rows at a cliff are told as errors",
        ("mbo/test_misfits.py::test_a_score_that_no_other_row_predicts_is_told",),
    ),
    Mutant(
        "errors-of-long-tails", "mbo/misfits.py", '<= max(FEW * len(error), 1)', '<= len(error)',
        "a tenth of all rows are told as single errors",
        ("mbo/test_misfits.py::test_rows_are_those_of_the_table_and_at_most_three",),
    ),
    Mutant(
        "errors-of-held-out-rows", "mbo/misfits.py",
        "np.arange(len(error)) if quality.rows is None else quality.rows",
        "np.arange(len(data))",
        "held-out rows are told by other numbers",
        ("mbo/test_misfits.py::test_rows_are_those_of_the_table_and_at_most_three",),
    ),
    Mutant(
        "growing-errors-untold", "mbo/misfits.py", '< SURE / np.sqrt(len(sizes) - 1):', '< 1.0:',
        "errors that grow with predictions are not told",
        ("mbo/test_misfits.py::test_errors_that_grow_with_predictions_are_told_and_no_rows_then",),
    ),
    Mutant(
        "driven-inputs-exactly", "mbo/driven_inputs.py", 'if left < 1.0 - EXPLAINED:', 'if left < 1e-6:',
        "an input that follows from others with some noise is not told",
        ("mbo/test_design_tables.py::test_an_input_that_others_determine_is_told",),
    ),
    Mutant(
        "decades-on-a-log-scale", "mbo/doubts.py",
        "if not v.leveled and not v.log and spans_decades",
        "if not v.leveled and v.log and spans_decades",
        "numbers over decades are told only if they are on a log scale already",
        ("mbo/test_design_tables.py::test_numbers_over_decades_are_told_and_drafted_on_a_log_scale",),
    ),
    Mutant(
        "limits-of-the-worst", "mbo/doubts.py", 'best = 0 if minimise else len(values) - 1', 'best = len(values) - 1',
        "best scores of a target that is minimised are sought at the wrong end",
        ("mbo/test_design_tables.py::test_placeholders_and_scores_at_a_limit_are_told",),
    ),
    Mutant(
        "ignored-days", "mbo/designs.py", '*([] if groups else doubts.of_ignored(table, left))', '*[]',
        "an ignored date that several rows share is not told",
        ("mbo/test_design_tables.py::test_ignored_columns_that_may_tell_which_rows_belong_together_are_told",),
    ),
    Mutant(
        "newest-rows-first", "ope/decide.py",
        "for test in (carried_over, out_of_order):",
        "for test in (carried_over,):",
        "rows whose newest comes first are no objection",
        ("ope/test_row_order.py::test_rows_whose_newest_comes_first_are_an_objection",),
    ),
    Mutant(
        "weak-order", "ope/row_order.py",
        "    if earlier.p_value < LEVEL and earlier.strength >= SHARE * later.strength:\n        name",
        "    if earlier.p_value < LEVEL:\n        name",
        "weak dependences on the row before count as much as those on the row after",
        ("ope/test_row_order.py::test_a_behaviour_policy_that_reacts_to_the_last_reward_needs_it_as_a_column",),
    ),
    Mutant(
        "last-actions-out-of-order", "ope/row_order.py",
        "known = np.column_stack([now, acted])",
        "known, acted = now, acted[:, :0]",
        "a behaviour policy that keeps to its last action is taken for rows out of order",
        ("ope/test_row_order.py::test_what_goes_with_the_last_action_alone_is_not_of_earlier_rows",),
    ),
    Mutant(
        "rewards-of-the-row-after", "ope/row_order.py",
        "unit, rewards[rows - 1], ",
        "unit, rewards[rows], ",
        "rewards are compared with the row after instead of the row before",
        ("ope/test_row_order.py::test_rewards_that_stand_one_row_early_are_an_objection",),
    ),
    Mutant(
        "own-next-observations-in-order", "ope/row_order.py",
        "or case.data.successors is not None or case.degenerate.all()",
        "or case.degenerate.all()",
        "rows of next observations of their own are taken for out of order",
        ("ope/test_row_order.py::test_where_nothing_can_be_said",),
    ),
    Mutant(
        "earlier-actions-forgotten", "ope/markov.py",
        "            yield len(errors) * len(actions) * p_value if abs(strength) >= WEAK else 1.0\n",
        "            yield 1.0\n",
        "effects of actions before the previous one are no hidden state",
        ("ope/test_markov.py::test_effects_of_earlier_actions_need_them_as_columns",),
    ),
    Mutant(
        "earlier-actions-of-the-log", "ope/markov.py",
        "(earlier - np.repeat(earlier[case.data.starts], case.data.lengths))[known]",
        "earlier[known]",
        "the number of earlier actions is that of the whole log",
        ("ope/test_markov.py::test_effects_of_earlier_actions_need_them_as_columns",),
    ),
    Mutant(
        "ends-of-recordings", "ope/markov.py",
        "    open_ = rows.step < longest if (rows.step[lost] == longest).mean() > USUAL else np.ones(len(lost), bool)\n",
        "    open_ = np.ones(len(lost), bool)\n",
        "few ends after an action are hidden by those of all recordings",
        ("ope/test_markov.py::test_few_ends_after_an_action_among_those_of_recordings_are_found",),
    ),
    Mutant(
        "reversed-in-long-episodes", "ope/decide.py",
        "None if ratios is None else predicted)\n",
        "None)\n",
        "gains that reversed in long episodes are not compared",
        ("ope/test_latest.py::test_of_long_episodes_parts_are_compared_by_ratios_of_occupancies",),
    ),
    Mutant(
        "clusters-of-both-parts", "ope/latest.py", "(pulls, pulls - pulls_was)", "(pulls, np.hypot(pulls, pulls_was))",
        "the errors of a change do not know that users of both parts are the same",
        ("ope/test_latest.py::test_users_of_both_parts_are_paired",),
    ),
    Mutant(
        "outcomes-untold", "data/leaks.py", "    out += _outcomes(part, sample)\n", "",
        "the outcome of an episode in all of its rows is not told",
        ("data/test_leaks.py::test_the_outcome_of_an_episode_in_all_of_its_rows_is_told",),
    ),
    Mutant(
        "outcomes-known-at-the-start", "data/leaks.py", " or _explained(part, before) > told * EARLIER:", ":",
        "what matters from the start on is taken for an outcome",
        ("data/test_leaks.py::test_the_outcome_of_an_episode_in_all_of_its_rows_is_told",),
    ),
    Mutant(
        "running-totals-untold", "data/info.py", "    if _running_totals(log):", "    if False:",
        "rewards that add up within episodes are not told",
        ("data/test_info.py::test_running_totals_are_told",),
    ),
    Mutant(
        "mixed-rows", "ope/row_order.py", "WEAK = 0.05", "WEAK = 0.2",
        "rows that are mixed within episodes are no objection, as few follow each other",
        ("ope/test_row_order.py::test_rows_that_are_mixed_within_many_episodes_are_an_objection",),
    ),
    Mutant(
        "ends-of-common-actions", "ope/markov.py", "_correlated(beyond, (taken == action) - chance, unit, least)",
        "_correlated(beyond, (taken == action) - chance, unit)",
        "few ends that all come after a common action by chance are an objection",
        ("ope/test_markov.py::test_few_ends_that_do_not_depend_on_a_common_action_are_none",),
    ),
    Mutant(
        "ends-of-a-step", "ope/markov.py", "rows.cell[open_] * (longest + 1) + rows.step[open_]", "rows.cell[open_]",
        "ends of long episodes are those of an action that is taken late",
        ("ope/test_markov.py::test_ends_of_a_state_and_of_a_step_are_not_those_of_their_action",),
    ),
    Mutant(
        "planned-runs-failed", "mbo/designs.py", "passed=None if kept is None else kept < rows[-1]", "passed=None",
        "proposals that were added to their table are taken for failed runs",
        ("mbo/test_misfits.py::test_planned_runs_at_the_end_of_a_table_are_no_failures",),
    ),
    Mutant(
        "errors-of-rows-of-groups", "mbo/misfits.py", "np.arange(len(error)) if quality.units is None else quality.units",
        "np.arange(len(error))", "rows of one group count as independent errors",
        ("mbo/test_misfits.py::test_errors_of_rows_of_one_group_count_once",),
    ),
    Mutant(
        "rounding-out-of-order", "ope/row_order.py", "if left.std() <= EXACT * own.std():", "if False:",
        "the rounding of a column that never changes is taken for rows out of order",
        ("ope/test_row_order.py::test_a_column_that_is_the_same_in_all_rows_of_an_episode_tells_no_order",),
    ),
    Mutant(
        "lasting-noise-out-of-order", "ope/row_order.py", " if log.spec.discrete else NOTHING", "",
        "continuous actions with a noise that lasts are taken for rows out of order",
        ("ope/test_row_order.py::test_continuous_actions_with_a_noise_that_lasts_are_not_doubted",),
    ),
    Mutant(
        "failures-in-no-direction", "mbo/unscored.py", "around | (_expected(data, x) >=", "around & (_expected(data, x) <",
        "a direction in which runs fail is not found",
        ("mbo/test_misfits.py::test_a_direction_in_which_runs_fail_is_found",),
    ),
    Mutant(
        "held-back-untold", "ope/select.py", "if held_back := [names[i] for i in range(len(names)) if every[i, 1] > 0]:",
        "if held_back := []:", "a card does not name the policy that only objections hold back",
        ("ope/test_select.py::test_a_policy_that_objections_hold_back_is_named",),
    ),
    Mutant(
        "highest-of-all", "ope/select.py", '" of the policies without objections" if any(objections) else ""', '""',
        "the best of the policies without objections is said to be the best of all",
        ("ope/test_select.py::test_a_policy_that_objections_hold_back_is_named",),
    ),
    Mutant(
        "json-late-key", "data/formats/json_table.py", "columns[name] = [None] * len(places)", "columns[name] = []",
        "the values of a key that the first objects lack move up to these", ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-sparse", "data/formats/json_table.py", "len(columns) * len(places) * _CELL", "len(places) * _CELL",
        "a small file of objects with different keys fills the memory", ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-twice", "data/formats/json_table.py", "if len(found) < len(pairs):", "if False:",
        "of two values with one name in an object the first is lost", ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-uneven", "data/formats/json_table.py", "alone and len(sizes) == 1 and 0 <", "alone and 0 <",
        "lists of several lengths become columns", ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-is-rllib", "data/formats/rllib.py", "return bool(arrays) and all(", "return bool(arrays) and any(",
        "a row with a list is taken for a batch of rows", ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "blocks-of-candidates", "policies/portable.py",
        "starts = range(0, max(len(x), 1), rows)",
        "starts = range(0, max(len(x), 1), len(x))",
        "candidates of many rows are compared at once, by numpy",
        ("policies/test_policies.py",),
    ),
    Mutant(
        "one-number-broadcast", "policies/deployed.py",
        "            if size is not None:\n                check_size(x, size, mask)\n",
        "",
        "one number is taken for all numbers of an observation",
        ("policies/test_policies.py",),
    ),
    Mutant(
        "one-number-numpy", "policies/portable.py",
        "            check_size(x, self._array(mean).shape[-1], net.get(\"mask\", 0) if inner[\"kind\"] in _CHOOSING else 0)\n",
        "",
        "one number is taken for all numbers of an observation, by numpy",
        ("policies/test_policies.py",),
    ),
    Mutant(
        "marks-of-another-program", "data/formats/any_table.py",
        "if own.keys() & {\"decimal\", \"thousands\"} and (odd :=",
        "if False and (odd :=",
        "rows whose numbers are written with other marks than the log's are read a thousand times as large",
        ("data/test_schema.py",),
    ),
    Mutant(
        "digits-as-floats", "data/formats/cells.py",
        "        return _compute.cast(plain, pa.int64()), told\n",
        "        return _compute.cast(plain, pa.float64()), told\n",
        "texts of many digits become floats, of which some are equal",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "groups-rounded", "data/frame.py",
        "        if column.role == \"group\":\n            encoder.exact(column.name, \"groups\")\n",
        "",
        "groups are told apart by rounded numbers",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-legal", "data/formats/json_table.py",
        "if actions and alone and",
        "if False and alone and",
        "legal actions in lists of one length become observations",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-legal-asked", "data/formats/words.py",
        "lists=frozenset().union(*map(_names, lists)) or None",
        "lists=None",
        "lists of legal actions are known by the column's name alone",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "rllib-count", "data/formats/rllib.py",
        "if key.partition(\"/\")[0] not in _NO_ARRAYS]\n    return",
        "]\n    return",
        "a batch of RLlib's with a count is taken for a table",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-long-row", "data/formats/kind.py",
        "            head += content.read(_ROW)\n",
        "            pass\n",
        "the format of a long object is detected by its first value",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-frame", "data/formats/json_table.py",
        "if columns or only.keys()",
        "if only.keys()",
        "a data frame in JSON by columns becomes a table of one row",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "json-null-object", "data/formats/json_table.py",
        "                continue  # it is missing, and so are its parts\n",
        "                pass\n",
        "objects that are null make a column without values",
        ("data/formats/test_json_table.py",),
    ),
    Mutant(
        "unequal-folds", "runs/crossfit.py",
        "if None in steps or len({*steps}) > 1 or",
        "if None in steps or",
        "an interrupted cross-fit has folds of unequal lengths",
        ("runs/test_crossfit.py",),
    ),
    Mutant(
        "refit-not-asked", "runs/crossfit.py",
        "folds if config[\"deliver\"] == \"mixture\" else [*folds, path / REFIT]",
        "folds",
        "the policy of an interrupted cross-fit was trained for less than its folds",
        ("runs/test_crossfit.py",),
    ),
    Mutant(
        "lock-by-spelling", "runs/folder.py",
        "place = Path(os.path.realpath(self.path))",
        "place = Path(os.path.abspath(self.path))",
        "a run is locked by the link through which its folder is reached",
        ("runs/test_alone.py",),
    ),
    Mutant(
        "hub-race", "runs/hub.py",
        "            if not (root / commit).is_dir():  # else another process was faster\n                raise\n",
        "            raise\n",
        "of two downloads of one commit the slower fails",
        ("runs/test_hub.py",),
    ),
    Mutant(
        "serve-blocks", "runs/service.py",
        "await run_in_threadpool(service.predict, body, request.query_params)",
        "service.predict(body, request.query_params)",
        "while a service computes actions it answers nothing else",
        ("runs/test_service.py",),
    ),
    Mutant(
        "serve-at-once", "runs/service.py",
        "            async with turn:\n                return",
        "            if True:\n                return",
        "large requests are computed at once, and together exceed the memory",
        ("runs/test_service.py",),
    ),
    Mutant(
        "guarded-levels", "mbo/design_table.py",
        "table = _plain(table) if kind == \"csv\" else table",
        "table = table",
        "appended proposals have levels of their own, with an apostrophe",
        ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "planned-unknown-level", "mbo/variables.py",
        "            if odd:\n                what",
        "            if False:\n                what",
        "planned runs with an unknown level are dropped without a word",
        ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "mixture-twice", "mbo/rules.py",
        "            if twice := repeated(group):",
        "            if False:",
        "a variable that is in a mixture twice counts twice",
        ("mbo/test_batch.py",),
    ),
    Mutant(
        "notebook-rows", "report/notebook.py",
        "str(data.numbered(i))",
        "str(i)",
        "designs in a notebook have the numbers of rows with a score",
        ("report/test_notebook.py",),
    ),
    Mutant(
        "best-of-complete", "bench/tables.py",
        "complete = all(cell.sound for row in self.cells",
        "complete = True or all(cell.sound for row in self.cells",
        "the best of the complete methods is called the best of all",
        ("bench/test_runner.py",),
    ),
    Mutant(
        "latex-braces", "bench/forms.py",
        "return re.sub(r\"[\\\\&%_#${}^~]\"",
        "return re.sub(r\"[&%_#$^~]\"",
        "names of methods are commands in LaTeX",
        ("bench/test_tables.py",),
    ),
    Mutant(
        "notes-of-lines", "bench/tables.py",
        "tuple(\" \".join(line.split()) for line in notes)",
        "tuple(notes)",
        "the second line of an error in a study is live LaTeX",
        ("bench/test_tables.py",),
    ),
    Mutant(
        "same-resamples", "bench/tables.py",
        "getattr(one, \"members\", 1) > 1",
        "getattr(one, \"members\", 1) < 0",
        "intervals over seeds of one bootstrap do not say so",
        ("bench/test_tables.py",),
    ),
    Mutant(
        "beside-steps", "bench/claims_file.py",
        "if {*one.steps.values()} != {*two.steps.values()}",
        "if False",
        "suites of other numbers of updates are compared",
        ("bench/test_claims.py",),
    ),
    Mutant(
        "beside-full", "bench/claims_file.py",
        "if suite.full != beside.full else []",
        "if False else []",
        "a suite at full size is compared with one at a small size",
        ("bench/test_claims.py",),
    ),
    Mutant(
        "beyond-untold", "cli/predict.py",
        "        if beyond.any():\n            count",
        "        if False:\n            count",
        "rows beyond the log's ranges are not told by predict",
        ("cli/test_predict.py",),
    ),
    Mutant(
        "groups-kept", "ope/evaluated.py",
        "return Episodes(self.data.select(np.flatnonzero(part)), self.discount, self.seed, units)",
        "found = Episodes(self.data.select(np.flatnonzero(part)), self.discount, self.seed, units)\n"
        "        found.log_uncensored = self.episodes.log_uncensored[part[self.data.episode_of]]\n        return found",
        "episodes of a group are weighted by how likely any episode of the log is cut off",
        ("ope/test_cut.py::test_groups_that_are_recorded_for_different_times_have_their_own_chances_of_a_cut_off",),
    ),
    Mutant(
        "simulated-apart", "runs/offline.py", "differences = returns[:, None] - returns",
        "differences = np.sqrt(np.square(returns[:, None] - returns.mean(1)[:, None, None]) + np.square(returns))",
        "errors of differences in the simulator are those of independent episodes",
        ("runs/test_offline.py::test_differences_in_the_simulator_are_of_episodes_that_begin_alike",),
    ),
    Mutant(
        "apart-shown", "ope/case.py", "unseen = self.data.is_end | self._apart", "unseen = self.data.is_end",
        "the log's policy does after a row what the next row says, whatever that follows", ("ope/test_cut.py",),
    ),
    Mutant(
        "average-unweighted", "bench/claims.py", "weights=np.diff(steps, prepend=0)", "weights=None",
        "the evaluation as a run ends counts as much in its learning curve as others", ("bench/test_claims.py",),
    ),
    Mutant(
        "held-negative", "ope/evaluated.py", "found.min() < 0 or ", "", "a judged episode teaches under a negative index",
        ("ope/test_asked.py",),
    ),
    Mutant(
        "teaching-draws", "ope/case.py", "dataclasses.replace(found.actor, seed=own)", "found.actor",
        "rows that teach have the draws of judged ones", ("ope/test_asked.py",),
    ),
    Mutant(
        "csv-empty-text", "data/formats/cells.py", 'values = keep(without(values, ("",)))', "values = keep(values)",
        "an empty cell of a text column is a level", ("data/formats/test_tables.py",),
    ),
    # ---- databases
    Mutant(
        "sqlite-writes", "data/formats/database.py", "            base.set_authorizer(allowed)\n", "",
        "a query of SQLite writes files by VACUUM INTO", ("data/formats/test_database.py",),
    ),
    Mutant(
        "duckdb-reads", "data/formats/database.py", '"enable_external_access": False', '"enable_external_access": True',
        "a query of DuckDB reads any file", ("data/formats/test_database.py",),
    ),
    # ---- tables of any dialect
    Mutant(
        "dialect-cp1252", "data/formats/dialect.py",
        '("utf-8", "cp1252", "latin-1")', '("utf-8", "latin-1")',
        "Windows-1252 is read as Latin-1", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-utf16", "data/formats/dialect.py",
        'return "utf-16-le"', 'return "utf-16-be"',
        "UTF-16 without a mark is read in the wrong order", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-cut-letter", "data/formats/dialect.py",
        "codecs.getincrementaldecoder(name)().decode(head, final=whole)", "head.decode(name)",
        "a letter that is cut at the end of the head makes a file Latin-1", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-sep-line", "data/formats/dialect.py",
        "start, separator = 1, separator or said[1]", "start = 1",
        "the separator in Excel's first line is not honoured", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-cut-row", "data/formats/dialect.py",
        "            if not whole and len(rows) > 1:\n                rows.pop()  # it may be cut\n", "            pass\n",
        "a row that is cut at the end of the head counts", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-preamble", "data/formats/dialect.py",
        "rows = rows[first:] if loose and first <= _PREAMBLE else rows", "rows = rows",
        "a title above the names is taken for them", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-names-lost", "data/formats/dialect.py",
        "return self.named, self.share > 0.5, -self.skip, self.share, self.columns", "return self.share, self.columns",
        "a name without commas is taken for a title", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-rivals", "data/formats/dialect.py",
        "    if rivals:", "    if False:",
        "two separators that fit are not told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-numbers-as-names", "data/formats/dialect.py",
        "if not layout.named and all(", "if False and all(",
        "a row of numbers becomes the names", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-counted", "data/formats/dialect.py",
        "not any(map(_NUMBER.fullmatch, names)) or _counted(names)", "not any(map(_NUMBER.fullmatch, names))",
        "columns that are counted are no names", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-quote", "data/formats/dialect.py",
        "(\"'\" if _single_quotes(text) else '\"')", "'\"'",
        "single quotes are part of texts", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dialect-encoding-silent", "data/formats/dialect.py",
        'if asked.encoding is None and encoding != "utf-8":', "if False:",
        "another encoding is not told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-votes", "data/formats/marks.py",
        'decimal = "," if votes[","] > votes["."] or tie else "."', 'decimal = "."',
        "decimal commas are not found", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-thousands-vote", "data/formats/marks.py",
        "votes[other] += len(", "votes[mark] += len(",
        "1.234.567 speaks for decimal points", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-tie", "data/formats/marks.py",
        'separator == ";" and (evident or self.open[","])', "False",
        "a lone comma beside semicolons is one of thousands", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-open-silent", "data/formats/marks.py",
        'if not evident and separator != ",":', "if False:",
        "1.234 beside semicolons is not told as open", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-open-thousands", "data/formats/marks.py",
        'else other if self.open[other] else ""', 'else ""',
        "groups of three beside other decimals are no thousands", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-shown", "data/formats/marks.py",
        "if mark != decimal})", "})",
        "the mark of decimals is one of thousands too", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "marks-mixed-silent", "data/formats/marks.py",
        "if asked == (None, None) and self.decimals[other]:", "if False:",
        "numbers of two marks are not told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-all-flags", "data/formats/cells.py",
        "for some in (texts[:SAMPLE], texts):\n        words", "for some in (texts[:2],):\n        words",
        "the first rows decide what is a flag", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-lone", "data/formats/cells.py",
        "(known or words <= set(_LONE))", "True",
        "a column of one letter is a flag", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-thousands-all", "data/formats/cells.py",
        "(?:\\d{{1,3}}|[1-9]\\d{{0,2}}(?:", "(?:\\d+|[1-9]\\d*(?:",
        "numbers with and without marks of thousands pass for numbers", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-sign-behind", "data/formats/cells.py",
        "_compute.if_else(behind, _compute", "_compute.if_else(_compute.invert(behind), _compute",
        "signs behind numbers turn", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-dash-text", "data/formats/cells.py",
        "pa.array((*MISSING[1:], DASH), values.type)", "pa.array((DASH,), values.type)",
        "NA among texts is not told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-dashes", "data/formats/cells.py",
        "without(trimmed, (*MISSING, DASH)), dialect", "without(trimmed, MISSING), dialect",
        "a dash makes numbers texts", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "cells-looks", "data/formats/cells.py",
        "if found.alike and (found.row < 0 or found.numbers):", "if False:",
        "texts that look like numbers are not told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dates-order", "data/formats/dates.py",
        'None if above[0] == above[1] else "day-first" if above[0] else "month-first"', "None",
        "the days do not tell their order", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dates-common", "data/formats/dates.py",
        "asked or each.order or common or (", "asked or each.order or (",
        "columns of dates do not tell each other", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dates-european", "data/formats/dates.py",
        'if each.mark == "." or european else', 'if each.mark == "." else',
        "dates beside semicolons are American", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dates-unsure", "data/formats/dates.py",
        "if unsure else", "if not unsure else",
        "dates that no cell tells are not told as open", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dates-asked", "data/formats/dates.py",
        'elif asked != "iso" and', "elif",
        "dates other than ISO's are read though they are not to be", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "dates-half", "data/formats/dates.py",
        "_compute.if_else(_compute.equal(number, 12), 0, number)", "number",
        "half an hour past midnight is past noon", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "tried-on-nothing", "policies/file.py", "play(np.ones((rows, *shape), kind))", "play(np.zeros((rows, *shape), kind))",
        "policies with legal actions are refused as damaged",
        ("policies/test_file.py::test_policies_that_obey_legal_actions_are_played",),
    ),
    Mutant(
        "dates-month", "policies/table_times.py",
        'day, month = (first, second) if order == "day-first" else (second, first)', "day, month = second, first",
        "the month is read first in all dates of rows", ("policies/test_table_times.py::test_texts_are_read_as_in_logs",),
    ),
    Mutant(
        "flags-words", "policies/table_rows.py", "_TRUTHS.get(text.lower(), text)", "_TRUTHS.get(text, text)",
        "words of truth values are taken in lower case alone",
        ("policies/test_table_encoder.py::test_flags_as_people_and_libraries_write_them",),
    ),
    Mutant(
        "one-action", "runs/together.py", 'if len(levels) < 2 and', 'if len(levels) < 1 and',
        "a second action is invented for logs of a single one",
        ("runs/test_predict.py::test_a_log_of_one_action_has_nothing_to_choose_between",),
    ),
    Mutant(
        "dates-frames", "data/text_columns.py",
        "if all_match(_texts(values[:SAMPLE]), _WRITTEN)", "if False",
        "dates as texts in data frames order episodes alphabetically", ("data/test_misreadings.py",),
    ),
    Mutant(
        "placeholder-far", "data/placeholders.py",
        "0 < high - low < max(low - end, end - high)", "True",
        "values that end in -999 are taken for placeholders", ("data/test_misreadings.py",),
    ),
    Mutant(
        "actions-that-nobody-took", "data/encode.py",
        "if found == list(range(len(found))):",
        "if found[0] >= 0 and found[-1] < 2 * len(found):",
        "numbers between the actions of a table become actions", ("data/test_frame.py",),
    ),
    Mutant(
        "steps-out-of-order", "data/row_order.py",
        "if (falls & inside).any() and",
        "if not (falls & inside).any() and",
        "shuffled steps are not told by the column that counts them", ("data/test_misreadings.py",),
    ),
    Mutant(
        "backwards-rises", "data/row_order.py",
        " and not (steps > 0).any()", "",
        "dates in any order are taken for reversed ones", ("data/test_misreadings.py",),
    ),
    Mutant(
        "dates-first-wrong", "data/formats/dates.py",
        "(low, middle) if _moments(some, month, day) is None else (middle, high)",
        "(low, middle) if _moments(some, month, day) is not None else (middle, high)",
        "a date that there is not is told of another row", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-newlines", "data/formats/delimited.py",
        "newlines_in_values=True", "newlines_in_values=False",
        "a line end in quotes breaks a row at the end of a block", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-decimal", "data/formats/delimited.py",
        '"decimal_point": dialect.decimal, ', "",
        "decimal commas are found and not used", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-nulls", "data/formats/delimited.py",
        '"null_values": _NULLS', '"null_values": [""]',
        "words for missing make numbers texts", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-open-quote", "data/formats/delimited.py",
        "    if last:  #", "    if False:  #",
        "a quote that nothing closes swallows the rest", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-swallowed", "data/formats/delimited.py",
        "            if inner:", "            if False:",
        "quotes that swallow rows are not told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-twice", "data/formats/delimited.py",
        "first.setdefault(name, index) != index", "False",
        "a name stands for two columns", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-clean", "data/formats/delimited.py",
        'return " ".join(name.split())', "return name",
        "blanks around names stay", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-no-name", "data/formats/delimited.py",
        "not _counts(table.column(column))", "False",
        "a column without a name is taken for row numbers", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-late-latin", "data/formats/delimited.py",
        "known=asked.encoding is not None or not head.isascii()", "known=False",
        "broken UTF-8 becomes Latin-1", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-empty-rows", "data/formats/delimited.py",
        'not cell.is_valid or (pa.types', 'cell.is_valid and (pa.types',
        "rows of empty cells stay", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-gz", "foreign/door.py",
        'packed = file.read(2) == b"\\x1f\\x8b"', "packed = False",
        "packed files are not unpacked", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "csv-line", "data/formats/delimited.py",
        "line = reader.line_num + 1\n            cells", "line = reader.line_num\n            cells",
        "the line before the wrong one is told", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "kind-options", "data/formats/kind.py",
        "if key in READING and kind not in READING[key]:", "if False:",
        "options of other formats are ignored", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "kind-table", "data/formats/kind.py",
        '("csv",), "thousands"', '("csv", "parquet"), "thousands"',
        "decimals of Parquet are taken and ignored", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "tables-mapping", "data/formats/tables.py",
        "mapping.pop(key) for key in READING if key in mapping",
        "mapping[key] for key in READING if key in mapping",
        "a separator counts as a mapping", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "likeness-refuse", "data/likeness.py",
        "if found.mistaken:", "if False:",
        "an odd text makes numbers a category", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "likeness-few", "data/likeness.py",
        "many = self.distinct > FEW", "many = True",
        "levels that are numbers are refused beside a text", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "excel-sheet-base", "data/formats/excel.py",
        "names[int(sheet) - 1]", "names[int(sheet) % len(names)]",
        "sheets are counted from 0", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "excel-hidden", "data/formats/excel.py",
        "and each.visible == calamine.SheetVisibleEnum.Visible", "",
        "hidden sheets are shown", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "excel-cell", "data/formats/excel.py",
        "enumerate(cells, 1)", "enumerate(cells)",
        "the cell above is told", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "excel-gaps", "data/formats/excel.py",
        'if any(cell != "" for cell in row)', "",
        "empty rows stay", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "excel-unnamed", "data/formats/excel.py",
        "            if filled is None:", "            if True:",
        "a column without a name is dropped with its values", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "values-mistake", "data/formats/values.py",
        'and usual != "text":', "and False:",
        "a text among numbers makes them texts", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "values-missing", "data/formats/values.py",
        "if texts and texts <= {*MISSING, DASH}:", "if False:",
        "words for missing make numbers texts", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "values-moment", "data/formats/values.py",
        "if type(value) is datetime.date else value", "if isinstance(value, datetime.date) else value",
        "times of moments are lost", ("data/formats/test_excel.py",),
    ),
    Mutant(
        "database-read-only", "data/formats/database.py",
        '?mode=ro"', '"',
        "a database is opened for writing", ("data/formats/test_database.py",),
    ),
    Mutant(
        "database-only", "data/formats/database.py",
        "len(known) != 1:", "not known:",
        "the first of several tables is taken", ("data/formats/test_database.py",),
    ),
    Mutant(
        "database-select", "data/formats/database.py",
        "len(statements) != 1 or", "False or",
        "the last of several statements is run", ("data/formats/test_database.py",),
    ),
    Mutant(
        "database-twice", "data/formats/database.py",
        "if twice := repeated(found.column_names):", "if twice := []:",
        "a query gives two columns one name", ("data/formats/test_database.py",),
    ),
    Mutant(
        "database-quoted", "data/formats/database.py",
        ".replace('\"', '\"\"')", "",
        "odd names of tables break the query", ("data/formats/test_database.py",),
    ),
    # ---- layouts of other libraries
    Mutant(
        "layout-d3rlpy-terminated", "data/formats/layout_rows.py",
        "append(last & bool(ended))",
        "append(last)",
        "d3rlpy's episodes all end by termination", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-minari-flat", "data/formats/layouts.py",
        '"terminations": "terminated", "truncations": "truncated"',
        '"terminations": "truncated", "truncations": "terminated"',
        "Minari's two flags are exchanged in flat files", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-rllib-new-obs", "data/formats/layouts.py",
        '"rewards": "rewards", "new_obs": "next_observations",',
        '"rewards": "rewards", "prev_obs": "next_observations",',
        "RLlib's next observations are forgotten", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-sb3-unstacked", "data/formats/layout_rows.py",
        "np.swapaxes(column[order], 0, 1)",
        "column[order]",
        "parallel environments of Stable-Baselines3 stay interleaved", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-sb3-timeouts", "data/formats/layout_ends.py",
        "return ended & ~truncated, truncated",
        "return ended, truncated",
        "time limits of Stable-Baselines3 are terminations", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-tianshou-ring", "data/formats/layout_rows.py",
        "(following if length == size else 0)) % size",
        "0) % size",
        "Tianshou's ring is read from its first row on", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-tianshou-rings", "data/formats/layout_rows.py",
        'parts.arrays["cut"][np.cumsum([len(ring) for ring in rings if len(ring)]) - 1] = True',
        "pass",
        "episodes of Tianshou cross from one ring to the next", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-torchrl-one-hot", "data/formats/layout_rows.py",
        'parts.arrays["action"] = action.argmax(1)',
        'parts.arrays["action"] = action.argmin(1)',
        "TorchRL's one-hot actions are read as another", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-torchrl-zeros", "data/formats/layout_rows.py",
        "and not following[ends].any():",
        "and False:",
        "zeros in place of TorchRL's last observations are taken for observations", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-ogbench-masks", "data/formats/layouts.py",
        '"terminals": "done", "masks": "alive"',
        '"terminals": "terminated"',
        "OGBench's ends of trajectories are terminations", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-ogbench-valids", "data/formats/layout_rows.py",
        "parts.take(valid, rows)",
        "parts.take(valid | True, rows)",
        "OGBench's rows without an action are steps", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-rl-unplugged-discount", "data/formats/layout_ends.py",
        "return column == 0",
        "return column < 1",
        "any discount is a termination", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-steps-shifted", "data/formats/layout_rows.py",
        'parts.arrays["terminated"] = np.append(ended[1:], False)',
        'parts.arrays["terminated"] = ended',
        "the termination of steps is looked for in rows that are left out", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-dsrl-own-names", "data/formats/layouts.py",
        'never=("masks", "dones"), ours=True',
        'never=("masks", "dones")',
        "DSRL's columns lose their names", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "missing-cells-inverted", "data/held.py",
        '"missing": int(is_missing(values).sum())',
        '"missing": int((~is_missing(values)).sum())',
        "cells with a value are counted as missing", ("data/test_told.py",),
    ),
    Mutant(
        "leak-late-own-row", "data/late.py",
        "_errors(features[rows - lag], target, learn)",
        "_errors(features[rows], target, learn)",
        "late rewards are compared with their own row only", ("data/test_leaks.py",),
    ),
    Mutant(
        "propensities-that-fit", "data/propensities.py", "own = np.where(actions == action, weights, 0.0)", "own = weights",
        "right propensities are said to be too small", ("data/test_info.py",),
    ),
    Mutant(
        "copies-in-any-order", "data/repeats.py", "(first[1:] == first[:-1] + 1)", "(first[1:] >= 0)",
        "equal people are taken for a part of a table that was stored twice", ("data/test_info.py",),
    ),
    Mutant(
        "midnight", "data/row_order.py", "(own[1:] == own[:-1]) & (order[1:] < order[:-1])", "order[1:] < order[:-1] - 1e9",
        "episodes that pass midnight are put in another order without a word", ("data/test_misreadings.py",),
    ),
    Mutant(
        "leak-empty-at-ends", "data/leaks.py", "(sample.known[names[i]] == sample.followed).all() and not", "False and not",
        "a next value that is empty in last rows passes for a column of earlier values", ("data/test_leaks.py",),
    ),
    Mutant(
        "copies-of-people", "data/repeats.py", "own[once] = _alone(log, once, found.many)", "own[once] = True",
        "equal people are taken for a table that was stored twice", ("data/test_info.py",),
    ),
    Mutant(
        "leak-behind-empty-cells", "data/leaks.py",
        "return flat[:, column.dimensions[-1]] == 0 if column.marked else np.ones(len(flat), bool)",
        "return np.ones(len(flat), bool)",
        "one empty cell hides a leak", ("data/test_leaks.py",),
    ),
    Mutant(
        "leak-behind-rounding", "data/relations.py",
        "if 0 < unit <= _ROUGH * y.std() and off <= unit + exact:",
        "if 0 < unit <= _ROUGH * y.std() and off <= exact:",
        "rounding hides a leak", ("data/test_leaks.py",),
    ),
    Mutant(
        "leak-lagged-column", "data/leaks.py",
        "if (filled and not ends_empty) or (behind[first] == ahead[first]).all():",
        "if (behind[first] == ahead[first]).all():",
        "a column of earlier values is accused", ("data/test_leaks.py",),
    ),
    Mutant(
        "page-fills-as-values", "report/log.py",
        "seen = flat[:, -1] == 0 if len(names) > 1 else np.ones(len(rows), bool)",
        "seen = np.ones(len(rows), bool)",
        "filled cells are drawn as values", ("report/test_log_page.py",),
    ),
    Mutant(
        "layout-corl-breaks", "data/checks.py",
        "np.append(breaks(observations, following), True) & ~terminals",
        "np.append(np.zeros(rows - 1, bool), True) & ~terminals",
        "episodes of CORL end at terminals alone", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-open-bandit-probability", "data/formats/arrange.py",
        "return {LOG_PROBS: np.log(probs)}",
        "return {LOG_PROBS: probs}",
        "probabilities pass for their logarithms", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-vw-cost", "data/formats/vw.py",
        '"rewards": -np.array(',
        '"rewards": np.array(',
        "VW's costs are rewards", ("data/formats/test_vw.py", "data/formats/test_layouts.py"),
    ),
    Mutant(
        "layout-vw-actions", "data/formats/vw.py",
        "_Example(number, features, action - 1, cost",
        "_Example(number, features, action % 2, cost",
        "VW's actions are others", ("data/formats/test_vw.py",),
    ),
    Mutant(
        "layout-episodes-sorted", "data/formats/layout_ends.py",
        "place = first[codes]",
        "place = codes",
        "episodes are put into the order of their identifiers", ("data/formats/test_layouts.py",),
    ),
    Mutant(
        "layout-done-alone", "data/formats/layout_ends.py",
        "if done is None:\n        raise",
        "if False:\n        raise",
        "`done` alone is taken for a time limit", ("data/formats/test_layouts_refused.py",),
    ),
    Mutant(
        "minari-one-hot-start", "data/formats/flatten.py",
        "column.astype(np.int64) - start\n    wrong = (index < 0) | (index >= count)",
        "column.astype(np.int64) % count\n    wrong = (index < 0) | (index >= count)",
        "discrete observations are counted from 0, wherever they start", ("data/formats/test_minari.py",),
    ),
    Mutant(
        "minari-joined-actions", "data/formats/flatten.py",
        "np.ravel_multi_index(tuple(index.T), tuple(counts.tolist()))",
        'np.ravel_multi_index(tuple(index.T), tuple(counts.tolist()), order="F")',
        "joined actions stand for other combinations than their levels say", ("data/formats/test_minari.py",),
    ),
    # ---- legal actions
    Mutant(
        "legal-net", "nets/mlp.py", "jnp.where(x[..., None, -self.mask :] > 0.5, parts, ILLEGAL)",
        "jnp.where(x[..., None, -self.mask :] > -0.5, parts, ILLEGAL)", "networks give illegal actions values",
        ("agents/test_legal.py",),
    ),
    Mutant(
        "legal-heads", "nets/mlp.py", "out.reshape(*out.shape[:-1], -1, self.mask)",
        "out.reshape(*out.shape[:-1], self.mask, -1).swapaxes(-1, -2)", "heads are masked in another order than they are read",
        ("agents/test_legal.py::test_targets_look_at_legal_actions_alone",),
    ),
    Mutant(
        "legal-standardised", "data/normalizer.py", "mean[-spec.mask_size :], std[-spec.mask_size :] = 0.0, 1.0",
        "pass", "masks are standardised, so that what is rarely legal never is", ("agents/test_legal.py", "data/test_legal.py"),
    ),
    Mutant(
        "legal-portable", "policies/portable.py", "np.where(seen[..., -mask:] > 0.5, x, _ILLEGAL) if mask else x",
        "x", "the NumPy player takes illegal actions", ("agents/test_legal.py::test_no_draw_of_any_agent_is_illegal",),
    ),
    Mutant(
        "legal-entropy", "agents/sac.py", "if spec.mask_size and spec.rows:", "if False:",
        "the target entropy is of actions that are not legal, too", ("agents/test_legal.py",),
    ),
    Mutant(
        "legal-next", "data/legal.py", "mask[:-1][~ends[:-1]] = legal[1:][~ends[:-1]]", "mask[~ends] = legal[~ends]",
        "what is legal next is what was legal before", ("data/test_legal.py",),
    ),
    Mutant(
        "legal-last", "data/legal.py", '"final_known": known & terminals[ends]}', '"final_known": known}',
        "after the end of a recording everything is legal", ("data/test_legal.py",),
    ),
    Mutant(
        "legal-logged", "data/legal.py", "count += int(illegal.sum())", "count += 0",
        "logged actions may be illegal", ("data/test_legal.py",),
    ),
    Mutant(
        "legal-renormalised", "ope/tables.py", "return chances * mask / kept", "return chances * mask",
        "probabilities of legal actions do not sum to one", ("ope/test_legal.py",),
    ),
    Mutant(
        "legal-told", "ope/tables.py", "mass + float(lost.sum()), rows + len(lost)", "float(lost.sum()), rows + len(lost)",
        "illegal mass of earlier blocks is forgotten", ("ope/test_legal.py::test_how_much_is_illegal_is_told_exactly",),
    ),
    Mutant(
        "legal-behaviour", "ope/behavior.py", "chances = chances * mask\n", "chances = chances * 1.0\n",
        "the behaviour policy is believed to take illegal actions", ("ope/test_legal.py",),
    ),
    Mutant(
        "legal-by-name", "data/legal_columns.py", "if own and any(len(cell)", "if any(len(cell)",
        "a column is believed by its name alone", ("data/test_legal.py",),
    ),
    # ---- policies in use: exports, trees, monitoring
    Mutant(
        "sequence-clips-beyond", "stats/confidence_sequence.py", "known = x[: beyond[0]] if len(beyond) else x",
        "known = np.minimum(x, high)", "returns beyond the range count as its end, and prove what they do not",
        ("stats/test_confidence_sequence.py",),
    ),
    Mutant(
        "drift-level-anew", "stats/drift.py", "share = alpha / (k * (k + 1))", "share = alpha",
        "every look at a new log has the whole level", ("stats/test_drift.py",),
    ),
    Mutant(
        "drift-one-column", "stats/drift.py", "largest = np.abs(chosen @ table).max(1)",
        "largest = np.abs(chosen @ table).mean(1)", "many columns are not corrected for", ("stats/test_drift.py",),
    ),
    Mutant(
        "realised-unfinished", "runs/realised.py",
        "if log.terminals[-1] or log.lengths[-1] >= like.lengths.max():", "if len(log):",
        "an episode that goes on counts with the return that it has so far", ("runs/test_monitor.py",),
    ),
    Mutant(
        "export-check-loose", "runs/exported.py", "<= CLOSE * rows.room", "<= rows.room",
        "an export that does something else is kept", ("runs/test_export.py",),
    ),
    Mutant(
        "export-first-member", "policies/pure.py", "is_it = (member == i)", "is_it = (member > i)",
        "another member of a mixture acts than is asked for", ("policies/test_pure.py",),
    ),
    Mutant(
        "monitor-missing-of-values", "runs/compared.py", "self.of(what)[:, -1] if what.marked",
        "self.of(what)[:, 0] if what.marked",
        "the share of missing cells is that of values", ("runs/test_compared.py",),
    ),
    Mutant(
        "explain-units-by-place", "runs/explain.py", 'acts = [known.get(name, "") if not',
        'acts = [next(iter(known.values()), "") if not', "actions have the unit of the first column", ("runs/test_explain.py",),
    ),
    Mutant(
        "flag-codes", "policies/table_encoder.py", "codes.get(flag) for flag", "int(flag) for flag",
        "actions of flags have the codes of false and true, whatever the levels are", ("runs/test_predict.py",),
    ),
    Mutant(
        "dates-of-two-orders", "data/formats/dates.py",
        "orders.pop() if len(orders) == 1 else None", "orders.pop() if orders else None",
        "one order of dates is kept of columns that have two", ("runs/test_reading.py",),
    ),
    Mutant(
        "schema-file-options", "runs/reading.py", "schema.options() if options is None else options", "schema.options()",
        "the file of a schema does not say how its table is read", ("runs/test_reading.py",),
    ),
    Mutant(
        "kept-texts", "cli/predict.py", "_kept(table[column], text)", "_kept(table[column], table[column])",
        "columns that are copied are written as they were read", ("cli/test_predict.py",),
    ),
    Mutant(
        "lattice-pivot", "mbo/lattice.py", "(steps[i] + turn >= ends[i][0])", "(steps[i] - turn >= ends[i][0])",
        "the step that makes a sum whole is checked against bounds on the wrong side", ("mbo/test_lattice.py",),
    ),
    Mutant(
        "grid-of-equality", "mbo/grids.py", "digits[i] = max(common if enough else min(common, wanted[i]), held[i])", "pass",
        "parts of a sum have grids of their own", ("mbo/test_lattice.py",),
    ),
    Mutant(
        "effects-measured", "mbo/effects.py", "left = float(each.bound) - data.repair.measured(x) @ rest",
        "left = float(each.bound) - x @ rest",
        "levels that are numbers count by their indices in sums", ("mbo/test_effects.py",),
    ),
    Mutant(
        "copies-with-errors", "mbo/replicates.py",
        "for each in (data.y, *([] if given is None else [given]))",
        "for each in ([data.y] if given is None else [data.y + np.arange(len(data))])",
        "copies of rows with standard errors pass for replicates", ("mbo/test_batch.py",),
    ),
    Mutant(
        "start-reads-by-names", "runs/started.py", 'read_like(known.get("name", str(source)), read, source)',
        'read_like(known.get("name", str(source)), Read(), source)', "a table is read again without its schema",
        ("runs/test_fine_tuned.py::test_the_log_is_read_again_as_it_was",),
    ),
    Mutant(
        "words-of-actions", "data/formats/words.py", "names = [name for name in empty if held[name]]", "names = empty",
        "a column of numbers that misses all is one of texts", ("data/formats/test_dialects.py",),
    ),
    Mutant(
        "explain-never-exchanged", "runs/explain.py", "other[:, dimensions] = x[rng.permutation(len(x))][:, dimensions]",
        "other[:, dimensions] = x[:, dimensions]", "no column seems to matter", ("runs/test_explain.py",),
    ),
    Mutant(
        "explain-seen-rows", "runs/explain.py", "own, plain = loss(guess(trees[depth], fresh), fresh),",
        "own, plain = 0.0 * loss(guess(trees[depth], fresh), fresh),",
        "a tree is said to do all that the policy does", ("runs/test_explain.py",),
    ),
    Mutant(
        "legal-empty", "data/legal_columns.py", "if isinstance(found, list) and None in found:", "if False:",
        "an empty entry of a list of legal actions is an action called None",
        ("data/test_legal.py::test_an_empty_entry_of_a_list_is_no_action",),
    ),
    # ---- what is told of tables
    Mutant(
        "zeros-rows", "data/formats/delimited.py", "        row += batch.num_rows\n", "        break\n",
        "codes with zeros in front are looked for in the first rows alone",
        ("data/formats/test_spool.py::test_zeros_in_front_are_told_wherever_they_are",),
    ),
    Mutant(
        "stream-columns", "data/formats/stream.py", "found if schema is None else opened(schema=schema)", "found",
        "a folder of files has the columns of the first file",
        ("data/formats/test_stream.py::test_files_with_other_columns_and_types",),
    ),
    Mutant(
        "recommend-leaks", "runs/recommend.py", '+= [*state.get("leaks", []), *(', "+= [*(",
        "suspected leaks are not on the card of a recommendation",
        ("runs/test_recommend.py::test_suspected_leaks_are_on_the_card_once",),
    ),
    # ---- costs
    Mutant(
        "cost-upper", "ope/costs.py", "if self.limit is None or high <= self.limit:",
        "if self.limit is None or value <= self.limit:",
        "a limit is held by the estimate instead of its upper end", ("ope/test_costs.py",),
    ),
    Mutant(
        "cost-reward", "ope/case.py", "log = dataclasses.replace(self.given, rewards=rewards)", "log = self.given",
        "the cost of a policy is its value", ("ope/test_costs.py",),
    ),
    Mutant(
        "cost-against", "ope/select.py", "own += [] if against is None else against[i]", "own += []",
        "policies that cost too much are deployed", ("ope/test_costs.py",),
    ),
    # ---- names from outside
    Mutant(
        "outside-parent", "names.py",
        'if name == ".." or PureWindowsPath(name).name != name:', 'if PureWindowsPath(name).name != name:',
        "a file may be called ..", ("test_names.py",),
    ),
    Mutant(
        "outside-bytes", "names.py",
        'len(name.encode()) > LONGEST', 'len(name) > LONGEST',
        "names are measured in characters", ("test_names.py",),
    ),
    Mutant(
        "outside-device", "names.py",
        '    if _DEVICE.match(name):\n', '    if _DEVICE.fullmatch(name):\n',
        "devices of Windows with an ending are names", ("test_names.py",),
    ),
    Mutant(
        "outside-reordering", "errors.py",
        ' or c in _REORDERING', '',
        "characters that reorder others are shown", ("test_names.py",),
    ),
    Mutant(
        "outside-encoded-device", "names.py",
        'if _DEVICE.match(plain) else plain', 'if False else plain',
        "devices of Windows are names of folders", ("test_names.py",),
    ),
    Mutant(
        "outside-encoded-length", "names.py",
        'plain.encode()[:longest].decode(errors="ignore")', 'plain[:longest]',
        "encoded names are cut to characters", ("test_names.py",),
    ),
    Mutant(
        "outside-path", "names.py",
        'if each != "."', 'if each not in (".", "..")',
        "a path in a file may lead out of its folder", ("test_names.py",),
    ),
    Mutant(
        "outside-terminal", "names.py",
        'self.stream.write(shown(text, keep="\\n\\t"))', 'self.stream.write(text)',
        "names steer the terminal", ("test_names.py",),
    ),
    Mutant(
        "outside-main", "cli/main.py",
        'if "-h" in args or "--help" in args:', 'if args:',
        "commands print names as they are", ("runs/test_hostile_runs.py",),
    ),
    Mutant(
        "outside-page", "report/markup.py",
        'html.escape(shown(value, keep="\\n\\t"))', 'html.escape(str(value))',
        "control characters reach a page", ("runs/test_hostile_runs.py",),
    ),
    Mutant(
        "outside-toml", "data/schema.py",
        'if is_control(c) and not', 'if c == "\\x7f" and not',
        "control characters reach a schema", ("runs/test_hostile_runs.py",),
    ),
    Mutant(
        "outside-ledger", "bench/suite.py",
        'safe_path(document["ledger"], f"{where}: ledger")', 'document["ledger"]',
        "a suite writes its ledger anywhere", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-tracker", "runs/trackers/feed.py",
        'safe_name(read_json(path, _Told)["id"], f"{path}: id")', 'read_json(path, _Told)["id"]',
        "the id of a tracked run is a path", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-pattern", "runs/trackers/wandb_runs.py",
        "glob.escape(config['id'])", "config['id']",
        "the id of a tracked run is a pattern", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-commit", "runs/hub.py",
        'safe_name(str(info.sha), f"{repo}: commit")', 'str(info.sha)',
        "a repository's commit is a path", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-run", "runs/train.py",
        'file_part(f"{short_name(lanes[0])}-{log.name}")', 'f"{short_name(lanes[0])}-{log.name}"',
        "a log's name is a path", ("runs/test_hostile_runs.py",),
    ),
    Mutant(
        "outside-agent", "runs/train.py",
        'safe_name(name, "agents are named as folders are, and")', 'str(name)',
        "the name of an agent is a path", ("runs/test_hostile_runs.py",),
    ),
    Mutant(
        "outside-minari", "data/formats/minari_ids.py",
        'all(file_part(part) == part', 'any(file_part(part) == part',
        "an id of Minari's leads out of its folder", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-cache", "data/catalogue.py",
        'name.startswith("~") or file_part(name) != name', 'name.startswith("~")',
        "a log's name leads out of the cache", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-column", "data/formats/folder.py",
        'safe_name(key, f"{path}: column")', 'str(key)',
        "a column's name is a path", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-row", "bench/store.py",
        'safe_path(str(row["job"]), f"{self.path}: run")', 'str(row["job"])',
        "a row of results names any folder", ("test_hostile_names.py",),
    ),
    Mutant(
        "outside-half", "files.py",
        '    except UnicodeEncodeError as error:\n        text', '    except ZeroDivisionError as error:\n        text',
        "half a character is no error of the user's", ("test_files.py",),
    ),
    Mutant(
        "formula-prefix", "data/formats/csv_out.py",
        '_HARMLESS.fullmatch(value)', '_HARMLESS.match(value)',
        "a sign in front makes a formula a number", ("data/formats/test_csv_out.py",),
    ),
    Mutant(
        "formula-numbers", "data/formats/csv_out.py",
        ' and not _HARMLESS.fullmatch(value)', '',
        "negative numbers become texts", ("data/formats/test_csv_out.py",),
    ),
    Mutant(
        "formula-names", "data/formats/csv_out.py",
        '[cell(name) for name in whole.column_names]', 'whole.column_names',
        "names of columns may be formulas", ("data/formats/test_csv_out.py",),
    ),
    Mutant(
        "formula-dictionary", "data/formats/csv_out.py",
        'column = column.cast(column.type.value_type)', 'return column',
        "levels may be formulas", ("data/formats/test_csv_out.py",),
    ),
    # ---- roads and driving, demonstrations
    Mutant(
        "pictures-climb", "training/pictures.py", "back(jax.grad(loss)(features))[0]", "back(-jax.grad(loss)(features))[0]",
        "an encoder climbs its loss", ("training/test_pictures.py",),
    ),
    Mutant(
        "pictures-now-for-next", "training/pictures.py", "shifted(batch.next_observation, k_next, state.shift)",
        "shifted(batch.observation, k_next, state.shift)", "what follows a picture is the picture",
        ("training/test_pictures.py",),
    ),
    Mutant(
        "n-step-over-timeouts", "training/program.py", 'over = (batch.terminal + batch.extra["timeout"] > 0)[:, :-1]',
        "over = (batch.terminal > 0)[:, :-1]", "sums of rewards cross timeouts", ("training/test_n_step.py",),
    ),
    Mutant(
        "n-step-other-copies", "training/sources.py", "stride=rows.copies", "stride=1",
        "sums of rewards mix copies of the environment", ("training/test_n_step.py",),
    ),
    Mutant(
        "n-step-lost-episodes", "online/exploration.py", 'self._cut(lost, int(state["count"]))', "pass",
        "an episode that is lost on resuming does not end", ("training/test_n_step.py",),
    ),
    Mutant(
        "d4pg-slope-uncut", "agents/d4pg.py", "slope / jnp.maximum(length, 1.0)", "slope / length",
        "every slope of D4PG's critic has length one", ("agents/test_d4pg.py",),
    ),
    Mutant(
        "targets-renewed-late", "nets/optim.py", "(step + 1) % period == 0", "step % period == 0",
        "target networks are copied an update late", ("agents/test_d4pg.py",),
    ),
    Mutant(
        "crr-d-present-policy", "agents/d4pg.py", "self.actions(state.target_actor,", "self.actions(state.actor,",
        "targets value what the present policy does, not its copy", ("agents/test_d4pg.py",),
    ),
    Mutant(
        "crr-d-best-draw", "agents/crr_d.py", "self.support).mean(0)", "self.support).max(0)",
        "an action has to be better than the best of the policy's draws", ("agents/test_d4pg.py",),
    ),
    Mutant(
        "abm-worse-rows", "agents/abm.py", "following) > 0 if", "following) < 0 if",
        "the prior imitates what turned out badly", ("agents/test_abm.py",),
    ),
    Mutant(
        "abm-dual-of-sums", "agents/abm.py", " - jnp.log(len(values))", "",
        "the dual of ABM sums over draws where it should average", ("agents/test_abm.py",),
    ),
    Mutant(
        "control-episodes-mixed", "online/rows.py", "chosen // copies * horizon * copies + chosen % copies",
        "chosen * horizon", "episodes of a log are put together from several copies", ("collect/test_collect_control.py",),
    ),
    Mutant(
        "control-old-positions", "tasks/control.py",
        "        self._mujoco.mj_step1(own.physics.model.ptr, data)  # dm_control measures where the state is\n", "",
        "dm_control's tasks observe where bodies were a physics step ago", ("tasks/test_control.py",),
    ),
    Mutant(
        "pictures-moved-roads", "runs/together.py", "(task is not None and task.places_matter)", "False",
        "pictures of roads are moved at random", ("tasks/test_pixels.py",),
    ),
    Mutant(
        "pixels-oldest", "tasks/pixels.py", "self.frames[copy, :, :, -3:] = self._drawn(copy)",
        "self.frames[copy, :, :, :3] = self._drawn(copy)", "the newest frame takes the place of the oldest",
        ("tasks/test_pixels.py",),
    ),
    Mutant(
        "pictures-first-encoder", "ope/pictures.py", "first = sum(each.features for each in encoders[:which])", "first = 0",
        "policies are judged by the features of the first one's encoder", ("ope/test_pictures.py",),
    ),
    Mutant(
        "film-first-frame", "report/film.py", "pictures[..., -3:]", "pictures[..., :3]",
        "film strips show the oldest frame of an observation", ("report/test_log_page.py",),
    ),
    Mutant(
        "lane-across", "tasks/driving.py", "along - 5.0 * across", "along - across", "driving across the lane costs a fifth",
        ("tasks/test_driving.py",),
    ),
    Mutant(
        "lane-left-edge", "tasks/car.py", "(offset > 1.5 * width)", "(offset > 0.5 * width)",
        "the lane of oncoming cars is off the road", ("tasks/test_driving.py",),
    ),
    Mutant(
        "lane-near", "tasks/driving.py", "route.project(self.cars[:, [X, Y]], near=self.distance)",
        "route.project(self.cars[:, [X, Y]])", "progress along the lane jumps where the road crosses itself",
        ("tasks/test_driving.py",),
    ),
    Mutant(
        "steering-left", "tasks/car.py", "-STEER * wheel - angle", "STEER * wheel - angle", "cars steer to the other side",
        ("tasks/test_driving.py",),
    ),
    Mutant(
        "town-red", "tasks/town.py", "light] == RED) & running", "light] == GREEN) & running",
        "passing a green light ends the episode, and a red one does not", ("tasks/test_town.py",),
    ),
    Mutant(
        "town-others", "tasks/town.py", "touching(self.cars[:, [X, Y, YAW]], others).any(1)",
        "touching(self.cars[:, [X, Y, YAW]], others).all(1)", "who hits one car only drives on", ("tasks/test_town.py",),
    ),
    Mutant(
        "town-seen", "tasks/town.py", "over = speed * np.cos(heading) - self.cars[:, [VELOCITY]] * np.cos(way)",
        "over = speed * np.cos(heading)", "other cars' speeds are seen as they are on the ground", ("tasks/test_town.py",),
    ),
    Mutant(
        "town-front", "tasks/town.py", "self._front = np.maximum(self._front, self.distance + LENGTH / 2)",
        "self._front = np.maximum(self._front, self.distance)", "half of the car may stand over the line",
        ("tasks/test_town.py",),
    ),
    Mutant(
        "traffic-closing", "tasks/traffic.py", "closing / (2.0 * np.sqrt(", "closing / (1.0 * np.sqrt(",
        "cars that close in on others brake twice as early", ("tasks/test_traffic.py",),
    ),
    Mutant(
        "traffic-lights", "tasks/traffic.py", "(PHASE * turns) - PHASE * turn", "(PHASE * turns) - 0 * turn",
        "all streets of a junction have green at once", ("tasks/test_traffic.py",),
    ),
    Mutant(
        "traffic-clear", "tasks/traffic.py", "return taken | there", "return taken",
        "other cars enter a junction where the learner's car is", ("tasks/test_town.py",),
    ),
    Mutant(
        "traffic-yellow", "tasks/traffic.py", "(needed <= COMFORT)", "(needed <= HARDEST)",
        "cars stop hard where yellow could still be passed", ("tasks/test_traffic.py",),
    ),
    Mutant(
        "arc-turns", "tasks/road_paths.py", "turned -= np.round(", "turned -= 0.0 * np.round(",
        "the nearest place on an arc of more than half a circle is on its other side", ("tasks/test_roads.py",),
    ),
    Mutant(
        "kitchen-demonstration-end", "collect/kitchen.py", "terminals = np.isin(np.arange(steps), ends)",
        "terminals = np.zeros(steps, bool)", "demonstrations in the kitchen do not end", ("collect/test_collect_kitchen.py",),
    ),
    Mutant(
        "kitchen-row-reward", "collect/kitchen.py", ".astype(np.float64)).sum(1)", ".astype(np.float64)).any(1)",
        "a row of a demonstration pays for one sub-task at most", ("collect/test_collect_kitchen.py",),
    ),
    Mutant(
        "devices-collect", "collect/rollouts.py", "with on_processor():", "if True:", "logs are collected on the accelerator",
        ("collect/test_rollouts.py",),
    ),
    # ---- faults
    Mutant(
        "fault-wait", "interrupts.py",
        "        if not _held:\n            raise Interrupted(number)", "        raise Interrupted(number)",
        "a signal ends a chunk before it is on disk", ("test_interrupts.py",),
    ),
    Mutant(
        "fault-callback", "interrupts.py",
        "_again(lost) if isinstance(lost.exc_value, Interrupted) else shown(lost)", "shown(lost)",
        "a signal within a callback of the garbage collector is lost", ("test_interrupts.py",),
    ),
    Mutant(
        "fault-living", "temporaries.py",
        "        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)\n", "",
        "temporary files of living processes are removed", ("test_temporaries.py",),
    ),
    Mutant(
        "fault-aside", "temporaries.py",
        "if not path.exists() and _aside(path).exists():", "if False:",
        "what a killed process had put aside is lost", ("test_temporaries.py",),
    ),
    Mutant(
        "fault-chunk", "training/fit.py",
        "with contextlib.nullcontext() if self.folder is None else holding():", "with contextlib.nullcontext():",
        "a signal does not wait for the checkpoint", ("training/test_fit.py",),
    ),
    Mutant(
        "fault-told", "training/fit.py",
        "if problem is not None:\n                told", "if problem is None:\n                told",
        "a broken checkpoint is passed over without a word", ("training/test_fit.py",),
    ),
    Mutant(
        "fault-design", "cli/design.py",
        'with alone(out, what=str(out)), resumable(out / "fits"):', 'with resumable(out / "fits"):',
        "two commands propose into one folder", ("runs/test_alone.py",),
    ),
    # ---- files from elsewhere
    Mutant(
        "door-pipes", "foreign/door.py", "    _refuse_others(path, found.st_mode)\n    return found.st_size",
        "    return found.st_size",
        "a pipe or a device is opened before it is refused, and an archive's is waited for", ("test_foreign.py",),
    ),
    Mutant(
        "door-gzip", "foreign/door.py", "if self.inner.tell() > self.most:", "if False:",
        "gzip unpacks without end", ("test_foreign.py",),
    ),
    Mutant(
        "archive-twice", "foreign/archive.py", "if name in found:", "if False:",
        "of two members of one name the last is taken", ("test_foreign.py",),
    ),
    Mutant(
        "archive-bombs", "foreign/archive.py",
        "        check_unpacked(path, sum(each.file_size for each in members), size)\n", "",
        "an archive unpacks to any size", ("test_foreign.py",),
    ),
    Mutant(
        "hdf5-links", "data/formats/hdf5_inside.py", "h5py.ExternalLink)", "type(None))",
        "columns of other files are read by links", ("test_foreign.py",),
    ),
    Mutant(
        "hdf5-elsewhere", "data/formats/hdf5_inside.py", "if found.is_virtual or found.external:", "if found.is_virtual:",
        "a column of HDF5 is any file's bytes", ("test_foreign.py",),
    ),
    Mutant(
        "hdf5-loops", "data/formats/hdf5_inside.py", "if (address := _address(inner)) not in seen:",
        "if (address := _address(inner)) or True:",
        "a group that holds itself is walked until it is too deep", ("test_foreign.py",),
    ),
    Mutant(
        "pickle-memory", "unpickle.py", "    bound_memory(_GROWS * len(data))", "    bound_memory(1 << 40)",
        "a pickle of ten bytes takes gigabytes", ("test_foreign.py",),
    ),
    Mutant(
        "child-folder", "foreign/reader.py", '    os.chdir(request.pop("folder"))', '    request.pop("folder")',
        "relative paths are those of the first folder that a file was read in", ("test_foreign.py",),
    ),
    Mutant(
        "child-hangs", "foreign/child.py",
        '        _drop()\n        raise UserError(\n            f"{path}: reading',
        '        raise UserError(\n            f"{path}: reading',
        "a process that hung is asked again", ("test_foreign.py",),
    ),
    Mutant(
        "json-bool", "foreign/shapes.py", "return type(value) is int and", "return isinstance(value, int) and",
        "true is a whole number", ("test_foreign.py",),
    ),
    Mutant(
        "json-depth", "foreign/text.py", "    if deepest > most:", "    if False:",
        "JSON is as deep as it likes", ("test_foreign.py",),
    ),
    Mutant(
        "errors-escapes", "errors.py", "super().__init__(printable(message))", "super().__init__(message)",
        "a column's name steers the terminal from within an error", ("test_foreign.py",),
    ),
    Mutant(
        "policy-whole", "policies/store.py", "    check_whole(path, policy)\n", "",
        "a policy is loaded that cannot act", ("policies/test_policies.py",),
    ),
    # ---- reports and estimates that are not finite
    Mutant(
        "unbounded-first", "ope/estimator.py", "            found = found.unbounded(lost)\n", "",
        "an estimate that overflows keeps an interval of no numbers", ("ope/test_decide.py",),
    ),
    Mutant(
        "check-late", "ope/decide.py", "    for each in asked:\n        each.check(case)\n", "",
        "an estimator that cannot answer is refused after the others were fitted", ("ope/test_decide.py",),
    ),
    Mutant(
        "holdout-unsaid", "report/provenance.py",
        '    return ["--holdout", told["share"], "--holdout-by", told["by"]]', "    return []",
        "the command that makes a run again holds other episodes out", ("report/test_page.py",),
    ),
    Mutant(
        "constant-decides", "bench/claims.py", "self.undefined or doubtful or not", "self.undefined or not",
        "a log on which all seeds differ by the same is taken as certain", ("bench/test_claims.py",),
    ),
    Mutant(
        "equal-differences-are-certain", "stats/comparison.py",
        "        other = 1.0 - miss ** (1.0 / len(gap))", "        other = 0.0",
        "a task whose differences are all the same is taken as certain within a range, too", ("stats/test_scores.py",),
    ),
    Mutant(
        "pages-of-both-sizes", "cli/bench.py", 'f"{suite.name}-full" if full else suite.name', "suite.name",
        "pages of the full size are written over those of the other",
        ("bench/test_studies.py::test_the_full_size_has_a_page_of_its_own",),
    ),
    Mutant(
        "metric-of-no-study", "bench/tables.py", "if given and metric.column", "if False and metric.column",
        "a table of a metric that no function returns is full of dashes", ("bench/test_studies.py",),
    ),
    Mutant(
        "texts-are-numbers", "bench/work.py", 'number.dtype.kind not in "biuf"', 'number.dtype.kind not in "biufU"',
        "a text that a study returns is taken as a number", ("bench/test_studies.py",),
    ),
    Mutant(
        "a-rival-twice", "bench/claims_file.py", "len({*own, *than}) < len(own) + len(than)", "False",
        "a claim compares a method with itself, or twice with one rival", ("bench/test_claims.py",),
    ),
    Mutant(
        "targets-at-the-floor", "agents/mobile.py", "spec.reward.max <= 0.0 <= self.min_target", "False",
        "MOBILE learns from targets that are all its floor", ("agents/test_offline_mbrl.py",),
    ),
    Mutant(
        "copies-paired-with-themselves", "runs/diagnostics.py", "    np.fill_diagonal(k, 0.0)\n", "",
        "what a copy's MMD stays below counts rows beside themselves", ("runs/test_train.py",),
    ),
    Mutant(
        "noise-departs-from-the-log", "report/simulated.py",
        "best.mmd > max(cloning.mmd, best.copy or 0.0)", "best.mmd > cloning.mmd",
        "a distance that a copy of the log's policy has too is called one", ("report/test_page.py",),
    ),
    Mutant(
        "equal-differences-cost-no-level", "stats/comparison.py",
        "miss = (1.0 - level) / (1 + len(same))", "miss = 1.0 - level",
        "parts of one interval are each made at the level of the whole", ("stats/test_scores.py",),
    ),
    Mutant(
        "offsets-are-usual", "data/sizes.py", "return _size(seen) > LARGE", "return seen.std > LARGE",
        "observations with a large offset are of usual size", ("data/test_sizes.py",),
    ),
    Mutant(
        "rare-flags-are-small", "data/sizes.py", "np.maximum(np.abs(seen.min), np.abs(seen.max)) < SMALL",
        "_size(seen) < SMALL",
        "flags that are rare are taken for small numbers", ("data/test_sizes.py",),
    ),
    Mutant(
        "units-as-they-are", "runs/candidates.py", 'else {"standardise": True}', "else {}",
        "candidates of `recommend` learn from degrees as they are", ("runs/test_sizes.py",),
    ),
    Mutant(
        "later-fields-tell", "training/later_fields.py", 'if not f.metadata.get("later") or own(f)', "if f.init",
        "a new field of an agent renames all cells of before", ("training/test_later_fields.py",),
    ),
    Mutant(
        "one-hold-out-for-all", "runs/together.py", "begun = Folder(next(iter(runs)))", "begun = first",
        "all logs of a program hold out what the first does when they are gone on with", ("runs/test_together.py",),
    ),
    Mutant(
        "others-work-again", "bench/executor.py", "if not store.undone(chosen.jobs):", "if not chosen.jobs:",
        "what another command has done since is done again", ("bench/test_runner.py",),
    ),
    Mutant(
        "no-skill-as-it-is", "mbo/calibration.py", "OWN if skilled else 0.0", "OWN",
        "intervals of a model without skill are those beside the rows that were lucky", ("mbo/test_validation.py",),
    ),
    Mutant(
        "own-deviations-alone", "mbo/calibration.py", "OWN = 0.5", "OWN = 1.0",
        "intervals trust a model to know where it is sure", ("mbo/test_validation.py",),
    ),
    Mutant(
        "predictions-as-they-are", "mbo/calibration.py", "return self.a + self.b * mean, np.maximum(",
        "return mean, np.maximum(", "what proposals owe to luck is promised", ("mbo/test_validation.py",),
    ),
    Mutant(
        "grid-after-the-climb", "mbo/local_search.py", "data.repair.nearly(x)", "data.repair.relaxed(x)",
        "of numbers in steps that must sum to a number the best designs are missed",
        ("mbo/test_rules.py::test_the_best_design_on_a_grid_with_a_sum_is_found",),
    ),
    Mutant(
        "noise-of-means", "mbo/calibration.py",
        "return mean, np.hypot(found, beyond), found / row", "return mean, found, found / row",
        "the interval of one measurement is that of the mean of several", ("mbo/test_validation.py",),
    ),
    Mutant(
        "all-rows-alike", "mbo/calibration.py", "np.square(std.min() / std)", "np.ones(len(std))",
        "rows that are known badly bend the predictions of all", ("mbo/test_validation.py",),
    ),
    Mutant(
        "rows-judge-their-regression", "mbo/calibration.py", "np.maximum(1.0 - seen, 1e-6)", "1.0",
        "intervals of few rows are too narrow, since the regression has seen them", ("mbo/test_validation.py",),
    ),
    Mutant(
        "draft-is-meant", "mbo/doubts.py", "or tuple(bounds) == (values.min(), values.max())", "",
        "a slipped digit becomes a bound of the drafted schema, and nothing is told any more", ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "networks-off-the-grid", "mbo/designer.py", "if climbed is not None:", "if False:",
        "networks propose what lies near designs that break a sum, and not what they predict to be best",
        ("mbo/test_rules.py::test_networks_find_good_designs_on_a_grid_with_a_sum",),
    ),
    Mutant(
        "gain-beyond-the-rules", "mbo/effects.py", "np.where(permitted(data), data.y, -np.inf)", "data.y",
        "no gain is predicted, since a row that breaks a rule scored more", ("report/test_design_page.py",),
    ),
    Mutant(
        "front-of-forbidden-rows", "mbo/front.py", "np.flatnonzero(permitted(data[0]))", "np.arange(len(data[0]))",
        "the front of the data is of rows that no proposal may be like", ("mbo/test_front.py",),
    ),
    Mutant(
        "relations-of-noise", "mbo/doubts.py", "directions[deviations <= _RELATED * len(x) ** 0.5]", "directions[:0]",
        "a cost that follows from other inputs is proposed at will, and nobody is told", ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "copies-hide-names-of-rows", "mbo/designs.py", "len(np.unique(x, axis=0)), {*(kinds", "len(x), {*(kinds",
        "a name of each row is an input, where rows of the file are copied", ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "units-make-levels", "mbo/variables.py", "if len(cells) > len(values) / 2", "if len(cells) > len(values)",
        "numbers with a percent sign are read as categories", ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "loose-sums-alone", "mbo/doubts.py", "for slack in _SLACKS * whole:", "for slack in _SLACKS[-1:] * whole:",
        "a trace is no part of the mixture that it belongs to", ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "optimism-seen", "report/design_doubts.py", "quality.crosswise[0]", "quality.corrected[0]",
        "the page tells errors of predictions that these rows have calibrated", ("report/test_design_page.py",),
    ),
    Mutant(
        "steps-off-the-grid", "mbo/program.py", "if v.step is None:", "if True:",
        "the page says that proposals begin where none can be", ("report/test_design_page.py",),
    ),
    Mutant(
        "blanks-make-levels", "mbo/design_table.py", "plain = compute.utf8_trim_whitespace(texts)", "plain = texts",
        "a blank at a text's end makes another level", ("mbo/test_design_tables.py",),
    ),
    Mutant(
        "resume-cuts-the-replay", "training/replay.py", "np.float32(value).data, cut=False)", "np.float32(value).data)",
        "to mark an episode that could not be taken up again cuts off all later rows", ("training/test_replay.py",),
    ),
    Mutant(
        "clone-of-raw-observations", "agents/bc.py", '("hidden", "batch_size", "standardise", "first_weights")',
        '("hidden", "batch_size", "first_weights")',
        "the model of the log's policy is fitted in other coordinates than it is used",
        ("agents/test_actor_critics.py::test_a_clone_learns_from_what_its_agent_sees",),
    ),
    Mutant(
        "share-without-groups", "runs/holdout.py", "return Holdout(share, by=group_of(log) or RANDOM)", "return Holdout(share)",
        "rows of one patient are learned from and judged on",
        ("runs/test_recommend.py::test_a_share_alone_holds_out_whole_groups_as_training_does",),
    ),
    Mutant(
        "cost-that-never-occurred", "ope/costs.py", "reliable & [not why for why in unknown]",
        "reliable",
        "a cost that no judged episode had is certain to be rare", ("ope/test_costs.py",),
    ),
    Mutant(
        "fqe-d-of-one-step", "ope/fqe_d.py", "share=1.0 / case.effective_horizon", "share=1.0 - case.discount",
        "the values of episodes of one step are too small",
        ("ope/test_exact.py::test_distributions_of_one_step_have_its_mean_reward",),
    ),
    Mutant(
        "groups-of-the-chosen", "ope/groups.py", "alpha / len(case.policies)", "alpha",
        "intervals of groups do not know among how many policies theirs was chosen",
        ("ope/test_demands.py::test_groups_and_tails_know_among_how_many_the_policy_was_chosen",),
    ),
    Mutant(
        "gains-beside-forbidden-rows", "mbo/front.py", "point = reference_of(y, counts)",
        "point = reference_of(y, np.ones(len(y), bool))",
        "what a front gains is measured from rows that break the rules", ("mbo/test_front.py",),
    ),
    Mutant(
        "calibrated-on-the-lucky", "mbo/gp.py", "if len(data) > self.max_rows:", "if False:",
        "a process that learns from the best rows is judged on them, so that noise is praised", ("mbo/test_gp.py",),
    ),
    Mutant(
        "agents-as-spelled", "bench/methods.py", 'given["agent"] = canonical_name(given["agent"])', "pass",
        "another spelling of an agent is another agent, whose tuned logs decide claims", ("bench/test_suite.py",),
    ),
    Mutant(
        "found-too-late", "bench/executor.py", "if event is None and over:", "if over:",
        "what workers have found when the time ends is lost", ("bench/test_runner.py",),
    ),
    Mutant(
        "collection-of-two-policies", "collect/in_task.py", '({} if content is None else {"policy_content": content})', "{}",
        "a killed collection is gone on with by another policy of the same name", ("collect/test_rollouts.py",),
    ),
    Mutant(
        "ends-that-are-extras", "data/formats/spread.py", "if not telling:", "if True:",
        "a log whose ends are called terminated and truncated becomes one of single decisions",
        ("data/formats/test_tables.py",),
    ),
    Mutant(
        "drl-mass", "ope/basis.py",
        'told.get("mass high", 1.0) < SHORT',
        'told.get("mass high", 1.0) < 0.0',
        "nothing is said of a policy of whose time occupancy ratios hold a part only",
        ("ope/test_exact.py::test_occupancy_ratios_tell_how_much_of_a_policy_the_log_shows",),
    ),
    Mutant(
        "groups-unsupported", "ope/groups.py",
        'known = np.array([line == "" for line in parts.why])',
        "known = np.array([line is not None for line in parts.why])",
        "a group that the log does not show has an interval",
        ("ope/test_demands.py::test_a_group_that_the_log_does_not_show_has_no_interval",),
    ),
    Mutant(
        "confounding-of-one-episode", "ope/confounding.py",
        "if self.lost[which]:",
        "if False:",
        "bounds for confounding rest on one episode",
        ("ope/test_demands.py::test_what_rests_on_whole_episodes_needs_enough_of_them",),
    ),
    Mutant(
        "own-log-elsewhere", "runs/monitor.py",
        "reference is None or one.learned_from(old)",
        "reference is None",
        "the log that a policy learned from counts as its own actions, where it has been moved",
        ("runs/test_monitor.py::test_the_log_that_the_policy_learned_from_was_not_made_by_it",),
    ),
    Mutant(
        "estimate-of-the-chosen", "runs/realised.py",
        "ALPHA / (2 * among)",
        "ALPHA / 2",
        "the estimate of the best of many policies is taken for that of one",
        ("runs/test_monitor.py::test_the_estimate_of_one_of_many_is_taken_as_that_of_the_chosen",),
    ),
    Mutant(
        "episodes-of-one-patient", "runs/realised.py",
        "< new.episodes:",
        "< 0:",
        "episodes of one patient count as independent in what was realised",
        ("runs/test_monitor.py::test_episodes_of_one_user_are_no_independent_ones",),
    ),
    Mutant(
        "plain-weights-fit", "ope/importance.py",
        "plain = not self.normalised and learns(case, self.behavior)",
        "plain = False",
        "intervals of plain weights do not know that learned propensities do not fit",
        ("ope/test_demands.py::test_learned_propensities_that_do_not_fit_widen_what_does_not_normalise",),
    ),
    Mutant(
        "cut-without-horizon", "ope/evaluated.py",
        "self._ahead[self.data.lengths[cut] - 1].mean()",
        "(self.discount ** self.data.lengths[cut]).mean()",
        "what is lost behind a cut is told of all time, whatever the horizon",
        ("ope/test_cut.py::test_what_is_still_to_come_is_told_of_what_is_asked_for",),
    ),
    Mutant(
        "greedy-though-sampled", "cli/predict.py",
        "found.sampled if options.sampled is None else options.sampled",
        "bool(options.sampled)",
        "a policy that was judged by sampled actions is used with others",
        ("cli/test_predict.py::test_policies_that_a_folder_stands_for",),
    ),
    Mutant(
        "recipes-in-all-folds", "mbo/validation.py",
        "(generator(0, \"folds of designs\").permutation(count) % folds)[data.units]",
        "generator(0, \"folds of designs\").permutation(len(data)) % folds",
        "a model that recalls a recipe whose settings differ slightly from row to row is praised",
        ("mbo/test_validation.py::test_rows_of_a_recipe_lie_in_one_fold_though_their_settings_differ_slightly",),
    ),
    Mutant(
        "groups-in-all-folds", "mbo/replicates.py", "return alike if data.groups is None else", "return alike if True else",
        "a model that has seen some rows of a batch is praised for what it says of the others",
        ("mbo/test_groups.py::test_a_model_that_knows_what_a_batch_has_in_common_is_not_praised",),
    ),
    Mutant(
        "controls-join-groups", "mbo/replicates.py",
        "np.where(low == high, low, groups.max() + 1 + np.arange(len(low)))", "low",
        "a design that stands in all batches is held out with the first",
        ("mbo/test_groups.py::test_a_design_that_stands_in_several_groups_is_held_out_by_itself",),
    ),
    Mutant(
        "rows-of-a-cluster-count-as-one-each", "stats/clusters.py",
        "np.square(size).sum() / n - 1.0) * shared", "0.0) * shared",
        "predictions that share with scores what a batch has in common are told from chance too often",
        ("stats/test_clusters.py::test_scores_that_have_nothing_to_do_with_predictions_correlate_no_more_often_than_said",),
    ),
    Mutant(
        "one-unit-judges-itself", "mbo/validation.py", "(taken < wanted or len(held) < 2)", "taken < wanted",
        "of large batches one alone is held out, and calibrates its own intervals",
        ("mbo/test_groups.py::test_enough_is_left_to_learn_from",),
    ),
    Mutant(
        "spaces-by-environments", "data/formats/minari.py",
        "if not isinstance(metadata.get(key), str):",
        "if False:",
        "a data set makes an environment of any code that it names",
        ("data/formats/test_minari.py::test_no_environment_is_made_for_a_space_that_is_not_there",),
    ),
    Mutant(
        "minari-columns-elsewhere", "data/formats/minari_inside.py",
        "list(datasets_of(file, opened))",
        "list(file)",
        "columns of Minari's data sets are read from other files",
        ("data/formats/test_minari.py::test_columns_that_lie_in_other_files_are_not_read",),
    ),
    Mutant(
        "next-observations-in-the-tables-order", "data/draft.py",
        "observed = [column for column in self.several(self.asked.observations) if column in have] if named else rest",
        "observed = self.having(\"observation\") if named else rest",
        "next observations go with other observations than those that were asked for",
        ("data/test_misreadings.py::test_next_observations_in_any_order_are_those_of_the_observations_asked_for",),
    ),
    Mutant(
        "next-flags-observed", "data/draft.py",
        "(roles.next_flags(self.names) | ahead)",
        "ahead",
        "what the next row holds of its end is observed",
        ("data/test_misreadings.py::test_what_belongs_to_the_next_row_is_no_observation",),
    ),
    Mutant(
        "levels-by-the-cells", "data/formats/words.py",
        "return Known(listed, frozenset",
        "return Known(frozenset(), frozenset",
        "levels of a schema are numbers where the cells of a month look like numbers",
        ("data/test_schema.py::test_another_month_is_encoded_as_the_first_though_its_cells_look_otherwise",),
    ),
    Mutant(
        "marks-are-forgotten", "data/schema.py",
        "(value is False and key != \"marked\")",
        "value is False",
        "a stored schema forgets that nothing was missing, and another month has more numbers",
        ("data/test_schema.py::test_another_month_is_encoded_as_the_first_though_its_cells_look_otherwise",),
    ),
    Mutant(
        "episodes-by-the-alphabet", "data/encode.py",
        "key=lambda i: natural(texts[i]))",
        "key=lambda i: texts[i])",
        "run_10 comes before run_2, and the latest episodes are others",
        ("data/test_misreadings.py::test_episodes_that_begin_at_the_same_time_are_in_the_order_of_the_numbers_in_their_names",),
    ),
    Mutant(
        "parts-by-the-alphabet", "data/formats/stream.py",
        "key=lambda fragment: natural(fragment.path))",
        "key=lambda fragment: fragment.path)",
        "part 10 of a folder follows part 1",
        ("data/formats/test_stream.py::test_files_of_a_folder_are_in_the_order_of_the_numbers_in_their_names",),
    ),
    Mutant(
        "merged-episodes", "data/row_order.py",
        "if len(np.unique(pairs)) == len(starts):",
        "if False:",
        "episodes that each robot counts for itself are merged without a word",
        ("data/test_misreadings.py::test_episodes_that_each_robot_counts_for_itself_are_told",),
    ),
    Mutant(
        "yes-is-another-action", "data/legal_columns.py",
        "said = _truth if place.keys() <= {\"true\", \"false\"} else str",
        "said = str",
        "legal actions yes and no are none of those of the log",
        ("data/test_legal.py::test_actions_that_are_words_for_true_and_false",),
    ),
    Mutant(
        "another-policy-of-the-name", "runs/decision_record.py",
        "same = [place for place in there if is_same(policy, place)]",
        "same = there",
        "a decision stands for a policy that nobody judged, which lies where it was",
        ("runs/test_decision_record.py::test_a_policy_that_was_trained_further_is_not_the_one_that_was_judged",),
    ),
    Mutant(
        "infinity-in-json", "runs/decision_record.py",
        "write_json(path, _finite(results))",
        "write_json(path, dict(results))",
        "estimates hold numbers that JSON does not have",
        ("runs/test_decision_record.py::test_numbers_that_json_does_not_have",),
    ),
    Mutant(
        "refused-estimators-look", "runs/offline.py",
        "        each.check(case)\n    current",
        "        each.label\n    current",
        "an estimator that is refused spends a look",
        ("runs/test_offline.py::test_what_is_refused_is_no_look",),
    ),
    Mutant(
        "another-member-is-asked", "runs/explain.py",
        "jnp.asarray(rows % function.members, jnp.int32)",
        "jnp.asarray(np.arange(len(x)) % function.members, jnp.int32)",
        "no column of a mixture seems to be without effect",
        ("runs/test_explain.py::test_exchanged_values_are_asked_of_the_member_that_acted_before",),
    ),
    Mutant(
        "members-change-within-episodes", "policies/table_predict.py",
        "cut = key is None and any(each in columns for each in encoder.ends)",
        "cut = False",
        "another member of a mixture acts in each row of an episode",
        ("runs/test_predict.py::test_one_member_of_a_mixture_acts_to_the_end_of_an_episode_that_flags_alone_tell",),
    ),
    Mutant(
        "values-of-other-actions", "runs/monitor.py",
        "bool(told[0][\"estimand\"][\"greedy\"]) != greedy",
        "False",
        "the value of sampled actions is compared with that of greedy ones",
        ("runs/test_monitor.py::test_a_value_is_compared_with_that_of_the_actions_in_use",),
    ),
    Mutant(
        "masks-are-standardised", "dynamics/model.py",
        "jnp.asarray(view.observe(edge), jnp.float32)",
        "jnp.asarray((edge - o.mean) / (o.std + 1e-3), jnp.float32)",
        "a model does not believe what is legal in most rows",
        ("ope/test_legal.py::test_a_model_believes_what_is_legal_where_it_mostly_is",),
    ),
    Mutant(
        "units-of-nothing", "agents/morel.py",
        "np.where(deviation < LEAST, 1.0, deviation + LEAST)",
        "deviation + LEAST",
        "MOReL ends rollouts by errors in zeros that pad observations",
        ("agents/test_offline_mbrl.py::test_morel_counts_disagreement_in_units_of_what_changes",),
    ),
    Mutant(
        "rollouts-that-are-gone", "online/branched_rollouts.py",
        "for turn in (turn for turn in self._waiting if turn in self._batches):",
        "for turn in self._waiting:",
        "MBPO has no checkpoint where its model is fitted more often than is kept",
        ("online/test_branched_rollouts.py::test_a_checkpoint_holds_the_rollouts_that_are_still_learned_from",),
    ),
    Mutant(
        "beyond-the-bounds-by-rounding", "tasks/gymnasium_spaces.py",
        "<= ROUNDED *",
        "<= 0.0 *",
        "environments refuse actions of saturated policies",
        ("tasks/test_gymnasium.py::test_actions_lie_on_bounds_that_rounding_puts_them_beyond",),
    ),
    Mutant(
        "dicts-by-the-alphabet", "tasks/gymnasium_spaces.py",
        "spaces.Dict(list(parts.items()))",
        "spaces.Dict(parts)",
        "observations have another order than Gymnasium's",
        ("tasks/test_gymnasium.py::test_dicts_keep_the_order_that_gymnasium_flattens_in",),
    ),
    Mutant(
        "rewards-of-another-scale", "tasks/gymnasium_copies.py",
        "self._gained[i] != before[i] or ",
        "",
        "a run goes on with rewards on another scale",
        ("tasks/test_gymnasium.py::test_rewards_that_depend_on_earlier_episodes_are_told_when_copies_are_restored",),
    ),
    Mutant(
        "seeds-fall-together", "bench/jobs.py",
        "for job in alone for seed in job.seeds]",
        "for job in alone for seed in job.seeds[:1]]",
        "the seeds of a program in which one failed are never done",
        ("bench/test_runner.py::test_a_seed_that_fails_does_not_take_the_others_with_it",),
    ),
    Mutant(
        "curves-end-where-they-fail", "bench/claims.py",
        "if rows[cell][\"failure\"]:",
        "if False:",
        "the average score of a run that diverged is that of its first part",
        ("bench/test_claims.py::test_runs_that_diverged_are_counted_and_keep_their_last_score",),
    ),
    Mutant(
        "four-rows-tell-skill", "mbo/validation.py",
        "if rows < 5:",
        "if False:",
        "four batches in the right order, as by chance one time in 24, show skill",
        ("mbo/test_groups.py::test_four_groups_with_nothing_else_in_them_tell_no_skill_from_chance",),
    ),
    Mutant(
        "losses-that-are-not-there", "ope/losses.py",
        "if lacks.chance > alpha / 2 / len(out) and low <= lacks.most:",
        "if False:",
        "a policy whose few rows lack the log's rare losses by chance is deployed",
        ("ope/test_losses.py::test_a_policy_whose_few_rows_have_no_loss_by_chance_is_not_deployed",),
    ),
    Mutant(
        "costs-that-are-not-there", "ope/costs.py",
        "most, alike = costs[own].max(), np.ptp(costs[own]) == 0.0",
        "most, alike = costs[own].max(), False",
        "a limit is met by a cost that a policy's few rows lack by chance",
        ("ope/test_losses.py::test_a_cost_that_the_rows_of_a_policy_lack_is_not_within_a_limit",),
    ),
    Mutant(
        "weights-above-one", "ope/support.py",
        "self.ratio_low[which] > LONG",
        "False",
        "propensities that are those of another action pass for good ones",
        ("ope/test_losses.py::test_propensities_that_are_those_of_another_action_are_objected_to",),
    ),
    Mutant(
        "rounded-parts-break-the-sum", "mbo/effects.py", "if each.equal and rounded:", "if False:",
        "the best row, whose parts are rounded, is none that satisfies the rules, and gains are measured from a worse one",
        ("report/test_design_page.py::test_a_mixture_of_rounded_parts_is_one",),
    ),
    Mutant(
        "yes-becomes-true", "mbo/design_table.py", "pairs=False", "pairs=True",
        "proposals have other words than the table, in which they are then levels of their own",
        ("mbo/test_design_tables.py::test_yes_and_no_are_the_levels_that_the_table_has",),
    ),
    Mutant(
        "few-members-are-sure", "mbo/effects.py", "critical(variables, self.freedom)", "critical(variables)",
        "effects by five members of an ensemble are told as if their deviation were known",
        ("mbo/test_effects.py::test_few_members_are_no_known_deviation",),
    ),
    Mutant(
        "surer-beyond-the-data", "mbo/calibration.py",
        "np.maximum(np.hypot(self.scale * std, self.scatter), self.scale / OWN**0.5 * std)",
        "np.hypot(self.scale * std, self.scatter)",
        "intervals far from the data are narrower than the model says",
        ("mbo/test_validation.py::test_half_of_a_skilled_models_own_variance_counts",),
    ),
    Mutant(
        "halted-for-good", "agents/morel.py", "(worst / (1.0 - self.discount) if worst < 0.0 else worst)", "worst",
        "MOReL is drawn away from the log where rewards are negative",
        ("agents/test_conformance.py::test_numbers_are_as_before",),
    ),
)


def cells(mutant: Mutant) -> dict[str, str]:
    """What a result stands under, and what it was found with."""
    told = hashlib.blake2b(repr(mutant).encode(), digest_size=8).hexdigest()
    code = hashlib.blake2b(digest_size=8)
    for path in sorted([*SOURCE.rglob("*.py"), *(ROOT / "tests").rglob("*.py")]):
        if path != Path(__file__).resolve():
            code.update(path.read_bytes())
    return {"mutant": told, "code": code.hexdigest()}


def run(mutant: Mutant, tests: tuple[str, ...]) -> tuple[str, float]:
    """The first test that fails on a copy of the source with the bug, or nothing; and the seconds that took."""
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "src"
        shutil.copytree(SOURCE, copy / "deadreckon")  # with what is compiled already, which saves seconds
        (copy / "deadreckon" / mutant.file).write_text(mutant.source())
        command = [sys.executable, "-m", "pytest", "-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-rfE", *tests]
        done = subprocess.run(
            command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(copy)}, capture_output=True, text=True, check=False
        )
    # A test that fails, or its fixture; a module of tests that cannot be imported (2) is no test that sees a bug.
    failed = re.search(r"^(?:FAILED|ERROR) (\S+::\S+)", done.stdout, re.MULTILINE)
    if done.returncode not in (0, 1) or (done.returncode and not failed):
        raise RuntimeError(f"{mutant.name}: pytest ended with {done.returncode}\n{done.stdout[-2000:]}{done.stderr[-2000:]}")
    return (failed[1] if failed else ""), time.monotonic() - begun


def likely(mutant: Mutant, page: str) -> tuple[str, ...]:
    """The test that caught the bug by the page's table, where that test is still there: it is run before all others."""
    found = re.search(rf"^\| {re.escape(mutant.breaks)} \| `{re.escape(mutant.file)}` \| `([^`]+)` \|$", page, re.MULTILINE)
    if found is None:
        return ()
    file, name = found[1].split("[")[0].split("::")
    path = ROOT / "tests" / file
    return (f"tests/{file}::{name}",) if path.exists() and f"def {name}(" in path.read_text() else ()


def markdown(results: dict[str, dict]) -> str:
    """The table."""
    lines = ["| bug | in | caught by |", "|---|---|---|"]
    for mutant in MUTANTS:
        found = results.get(mutant.name)
        by = "not run" if found is None else f"`{found['by'].removeprefix('tests/')}`" if found["by"] else "**survived**"
        lines.append(f"| {mutant.breaks} | `{mutant.file}` | {by} |")
    return "\n".join(lines)


def main() -> int:
    """Runs the bugs; 1 where one has survived."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--whole", action="store_true", help="run all fast tests on what the named ones let pass")
    parser.add_argument("--keep", action="store_true", help="do not run again what has been caught, whatever has changed since")
    parser.add_argument("--only", nargs="+", metavar="WORD", help="bugs whose name holds one of these")
    parser.add_argument("--markdown", action="store_true", help="print the table and run nothing")
    given = parser.parse_args()
    results = json.loads(CACHE.read_text()) if CACHE.exists() else {}
    if given.markdown:
        print(markdown(results))
        return 0
    page = PAGE.read_text()
    some = [m for m in MUTANTS if not given.only or any(word in m.name for word in given.only)]
    for mutant in some:
        asked, found = cells(mutant), results.get(mutant.name, {})
        same = found.get("mutant") == asked["mutant"]
        same = same and (bool(found["by"]) if given.keep else found["code"] == asked["code"])
        if not same:
            by, seconds = run(mutant, (*likely(mutant, page), *(f"tests/{each}" for each in mutant.tests)))
            found = {**asked, "by": by, "seconds": seconds, "whole": False}
        if not found["by"] and given.whole and not found["whole"]:
            by, seconds = run(mutant, ("tests",))
            found |= {"by": by, "seconds": found["seconds"] + seconds, "whole": True}
        results[mutant.name] = found
        CACHE.parent.mkdir(exist_ok=True)
        CACHE.write_text(json.dumps(results, indent=1))
        print(f"{mutant.name:28} {found['by'] or 'SURVIVED':100} {found['seconds']:6.1f} s", flush=True)
    survived = [m.name for m in some if not results[m.name]["by"]]
    print(f"{len(some) - len(survived)} of {len(some)} caught" + (f"; survived: {', '.join(survived)}" if survived else ""))
    return bool(survived)


if __name__ == "__main__":
    sys.exit(main())
