import json
import time

import layout_files as files
import numpy as np
import pytest
from layout_files import BANDIT, WORLD, stacked
from layout_forms import BOTH, COMPACT, D4RL, FLAGS, STEP, STEPS, TIANSHOU, flat_file

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import read
from deadreckon.data.formats.layout_rows import Parts, d3rlpy_episodes
from deadreckon.errors import UserError

REFUSED = {
    "done alone": (flat_file({**D4RL, "done": "done"}), r"column done must be called terminals .* done=\"terminals\""),
    "dones alone": (flat_file({**D4RL, "done": "dones"}), "column dones must be called terminals"),
    "done of Tianshou": (flat_file({**TIANSHOU, "done": "done"}), "column done must be called terminals"),
    "dones of RLlib": (flat_file({"observations": "obs", "actions": "actions", "rewards": "rewards", "done": "dones"}),
                       "column dones must be called terminals"),
    "truncated alone": (flat_file({**D4RL, "truncated": "truncated"}), "column truncated without a flag of terminations"),
    "a done too few": (flat_file(BOTH, {"done": np.zeros(14)}),
                       r"the task ended \(terminated\) and done is not set, first in row 2"),
    "a done too many": (flat_file(BOTH, {"done": np.ones(14)}),
                        "done is not truncated or a termination, first in row 0"),
    "timeouts that are no dones": (flat_file({**D4RL, "terminated": "dones", "truncated": "timeouts"}),
                                   "column dones must be called terminals if it marks no time limits, else all ends; row 6"),
    "masks that are end flags": (flat_file({**D4RL, "done": "terminals"}, {"masks": stacked(WORLD, "done")}),
                                 "masks and terminals contradict each other: masks are 1 exactly where trajectories end"),
    "masks beside terminals and timeouts": (
        flat_file({**D4RL, "done": "terminals", "truncated": "timeouts"}, {"masks": 1 - stacked(WORLD, "terminated")}),
        "terminals and masks contradict each other on whether the task ended, first in row 6",
    ),
    "flags of two libraries": (
        flat_file({**FLAGS, "done": "timeouts"}), "column timeouts says how episodes end, beside terminated, truncated",
    ),
    "masks of two": (flat_file({**D4RL, "done": "terminals"}, {"masks": np.full(14, 2)}),
                     "column masks has 2 in row 0, 0 or 1"),
    "valids without masks": ({key: column for key, column in COMPACT.items() if key != "masks"}, "no column masks: OGBench's"),
    "valids that are off": ({**COMPACT, "valids": np.ones(18)}, "valids and terminals contradict each other in row 2"),
    "a last step too few": ({**STEPS, "is_last": np.zeros(18)}, "row 4 contradicts the row before it"),
    "an end inside": ({**STEPS, "is_terminal": np.ones(18)}, "is_terminal in row 0, which is not a last step"),
    "steps without ends": ({key: STEPS[key] for key in ("observation", "action", "reward", "is_first", "is_last")},
                           "neither is_terminal nor discount"),
    "a discount of two": (flat_file(STEP, {"discount": np.full(14, 2.0)}),
                          r"column discount has 2.0 in row 0, a number in 0 \.\. 1"),
    "no probability": ({**files.by_open_bandit(BANDIT, None), "pscore": np.zeros(6)},
                       "column pscore has 0.0 in row 0, a positive"),
    "pictures beside numbers": (
        {**flat_file(FLAGS), "observations": {"eye": np.zeros((14, 4, 4), np.uint8), "hand": np.zeros(14)}},
        "eye is an image of shape",
    ),
    "a column too short": ({**flat_file(BOTH), "rew": np.zeros(13)}, "column rew has 13 rows, act has 14"),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_contradicts_or_does_not_say_is_refused_in_one_line(kind):
    columns, words = REFUSED[kind]
    with pytest.raises(UserError, match=words) as caught:
        Dataset.from_dict(columns, name="mine")
    assert "\n" not in str(caught.value)
    assert str(caught.value).startswith("mine: ")


def test_json_of_rllib_that_cannot_be_read(tmp_path):
    path = tmp_path / "log.json"
    good = {"type": "SampleBatch", "obs": [[1.0], [2.0]], "actions": [0, 1], "rewards": [1.0, 2.0],
            "terminateds": [False, True], "truncateds": [False, False], "eps_id": [1, 1]}  # fmt: skip
    for lines, words in (
        ([{**good, "obs": "BCJNGGhA"}], "column obs is compressed in line 1; write it with compress_columns"),
        ([{**good, "obs": [[1.0], [2.0, 3.0]]}], "column obs has entries of different shapes in line 1"),
        ([good, {**good, "obs": [[1.0, 3.0], [2.0, 3.0]]}], r"column obs has shape \(2,\) in line 2, \(1,\) before"),
        ([good, {**good, "t": [0, 1]}], "column t is in some lines and not in others, first noticed in line 2"),
        ([good, 3], "line 2 is no object"),
        ([{"a": [1, 2]}], "JSON lines of lists are read in RLlib's layout: obs, actions, .*; found a; a table has one row"),
        (
            [{"type": "MultiAgentBatch", "policy_batches": {"a": good, "b": good}}],
            "a batch of several policies, and one is read",
        ),
    ):
        path.write_text("\n".join(map(json.dumps, lines)))
        with pytest.raises(UserError, match=words) as caught:
            read(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    path.write_text(json.dumps(good) + "\n{")
    with pytest.raises(UserError, match="line 2 is no JSON"):
        read(path)
    path.write_text(json.dumps({"type": "MultiAgentBatch", "count": 2, "policy_batches": {"default_policy": good}}))
    assert read(path).lengths.tolist() == [2]


@pytest.mark.parametrize("wrong", ["abc", 1.5, float("nan"), b"3"])
def test_single_numbers_that_are_none(wrong):
    rows = {"observations": [[0.0]] * 4, "actions": [0] * 4, "rewards": [0.0] * 4, "dones": [0] * 4, "timeouts": [0] * 4}
    with pytest.raises(UserError, match=r"pos must be a whole number, got .*"):
        Dataset.from_dict({**rows, "pos": wrong, "full": False})
    with pytest.raises(UserError, match=r"num_episodes must be a whole number, got .*"):
        Dataset.from_dict({"actions_0": [0], "rewards_0": [0.0], "num_episodes": wrong, "columns": "x"})


def test_many_episodes_of_d3rlpy_take_linear_time():
    count = 2_000
    arrays = {f"{key}_{i}": np.zeros((2, 1)) for key in ("observations", "actions", "rewards") for i in range(count)}
    several = {"observations_7_0": arrays["observations_7"], "observations_7_1": arrays["observations_7"]}
    parts = Parts(arrays | several, {"num_episodes": count, **{f"terminated_{i}": True for i in range(count)}})
    started = time.process_time()
    d3rlpy_episodes(parts)
    assert time.process_time() - started < 1  # it takes 0.01 s, and took 20 s when names of parts were made for all
    assert parts.arrays["observations"].shape == (2 * count, 1)


def test_a_probability_of_more_than_one_is_refused_by_the_name_of_its_column(tmp_path):
    source = files.by_open_bandit(BANDIT, tmp_path)
    source["pscore"] = np.where(np.arange(len(BANDIT)) == 4, 33, source["pscore"])
    with pytest.raises(UserError, match=r"column pscore has 33.0 in row 4, a probability in \(0, 1\] is needed"):
        Dataset.from_dict(source)
