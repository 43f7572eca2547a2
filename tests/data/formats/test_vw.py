import gzip

import numpy as np
import pytest

from deadreckon.data.formats.io import read, sniff
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError

# From VW's wiki, Logged Contextual Bandit Example.
LINES = "1:2:0.4 | a c\n3:0.5:0.2 | b d\n4:1.2:0.5 | a b c\n2:1:0.3 | b c\n3:1.5:0.7 | a d\n"
# The form of several lines: the action that a label names is ignored, the place of its line counts.
BLOCKS = """shared |user age:0.5 city:rome
|item a:1
0:-1.5:0.25 |item a:2

shared |user age:1
0:2:0.5 |item a:3
|item a:4
|item a:5 b
"""


@pytest.fixture
def log_of(tmp_path):
    def read_text(text):
        path = tmp_path / "log.txt"
        path.write_text(text)
        assert sniff(path) == "vw"
        return read(path)

    return read_text


def test_examples_of_one_line_each(log_of, tmp_path):
    log = log_of(LINES)
    assert log.provenance.extra["observation_names"] == ["a", "c", "b", "d"]
    assert log.observations.astype(int).tolist() == [[1, 1, 0, 0], [0, 0, 1, 1], [1, 1, 1, 0], [0, 1, 1, 0], [1, 0, 0, 1]]
    assert log.actions.tolist() == [0, 2, 3, 1, 2]
    np.testing.assert_allclose(log.rewards, [-2, -0.5, -1.2, -1, -1.5], rtol=1e-6)
    np.testing.assert_allclose(np.exp(log.extras["behavior_log_probs"]), [0.4, 0.2, 0.5, 0.3, 0.7], rtol=1e-6)
    assert log.terminals.all()
    assert log.action_space == Discrete(4)
    (tmp_path / "log.vw.gz").write_bytes(gzip.compress(LINES.encode()))
    packed = read(tmp_path / "log.vw.gz")
    assert (packed.name, packed.fingerprint) == ("log", log.fingerprint)


def test_decisions_of_several_lines(log_of):
    for text in (BLOCKS, BLOCKS.replace("0:-1.5", "7:-1.5") + "\n\n"):
        log = log_of(text)
        names = ["user^age", "user^city=rome", "0:item^a", "1:item^a", "2:item^a", "2:item^b"]
        names += ["legal=1", "legal=2", "legal=3"]
        assert log.provenance.extra["observation_names"] == names
        np.testing.assert_array_equal(log.observations[:, :-3], [[0.5, 1, 1, 2, 0, 0], [1, 0, 3, 4, 5, 1]])
        assert log.actions.tolist() == [1, 0]
        assert log.rewards.tolist() == [1.5, -2]
        assert log.observations[:, -3:].tolist() == [[1, 1, 0], [1, 1, 1]]
        assert log.action_space == Discrete(3, masked=True)
        assert any("those of each of 3 actions, are one observation" in line for line in log.warnings)
    without = log_of("\n".join(line for line in BLOCKS.split("\n") if not line.startswith("shared")))
    assert without.provenance.extra["observation_names"] == names[2:]


def test_namespaces_values_tags_and_possible_actions(log_of):
    log = log_of("1 3:1:0.5 'tag|user:2 age:3 age:1 vip |item :0.5 x:1e-1\n2:0:1 other|user age\n| a\n3:1:1 |item y:-2\n")
    assert log.provenance.extra["observation_names"] == [
        "user^age", "user^vip", "item^0", "item^x", "item^y", "legal=1", "legal=2", "legal=3",
    ]  # fmt: skip
    np.testing.assert_allclose(log.observations[:, :-3], [[8, 2, 0.5, 0.1, 0], [1, 0, 0, 0, 0], [0, 0, 0, 0, -2]], rtol=1e-6)
    assert log.observations[:, -3:].tolist() == [[1, 0, 1], [1, 1, 1], [1, 1, 1]]
    assert "1 examples without action:cost:probability are left out" in log.warnings


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1:2:0.4 | a\n1:2:0 | a\n", r"line 2 has probability 0, a number in \(0, 1\] is needed"),
        ("1:2:0.4 | a\n1:2:0.4 2:1:0.3 | a\n", "line 2 has 2 actions with a cost, 1:2:0.4 and 2:1:0.3; one is read"),
        ("1:2:0.4 | a\n1:2 | a\n", "line 2 has the label '1:2'; action:cost:probability is needed"),
        ("1:2:0.4 | a\nwords\n", r"line 2 has no \|; action:cost:probability \| features is needed"),
        ("1:2:0.4 |user:x a\n", "line 1: namespace user has the factor 'x', a number is needed"),
        ("1:2:0.4 |\n", "no example has a feature"),
        ("shared | a\n0:1:0.5 | b\n0:1:0.5 | c\n", "line 3: a second action of one decision has a cost"),
        ("0:1:0.5 | b\nshared | a\n", "line 2: the shared line is the first of its decision"),
        ("shared | a\nccb action 0:1:0.5 | b\n", "line 2: ccb examples are not read"),
        ("1:2:0.4 | a\n0 1:1:0.4 | b\n", "line 2 has action 0; they are counted from 1"),
        (
            "1:2:0.4 | " + " ".join(f"f{i}" for i in range(10_001)),
            "there are 10,001 different features, at most 10,000 are read",
        ),
    ],
)
def test_what_cannot_be_read_is_told_with_its_line(log_of, tmp_path, text, words):
    with pytest.raises(UserError, match=words) as caught:
        log_of(text)
    assert str(tmp_path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_options_and_texts_that_are_no_bandits(tmp_path):
    path = tmp_path / "log.txt"
    path.write_text(LINES)
    with pytest.raises(UserError, match="each example is an episode of one step; a horizon is for files"):
        read(path, horizon=3)
    for text in ("1 | a b\n-1 | c\n", "a table | of texts\n1 | 2\n"):
        path.write_text(text)
        with pytest.raises(UserError, match="not a log in a format that is read|no column is the action or the reward"):
            read(path)


def test_tables_of_open_bandit_are_known_by_their_names(tmp_path):
    path = tmp_path / "all.csv"
    path.write_text(
        ",timestamp,item_id,position,click,propensity_score,user_feature_0,user-item_affinity_0\n"
        "0,2019-11-24 00:00:02,2,3,1,0.5,81ce,0.25\n1,2019-11-24 00:00:01,0,1,0,0.25,03a5,0.0\n"
        "2,2019-11-24 00:00:03,1,2,0,0.25,81ce,0.0\n"
    )
    log = read(path)
    assert log.actions.tolist() == [2, 0, 1]
    assert log.rewards.tolist() == [1, 0, 0]
    assert log.terminals.all()
    assert log.extras["position"].tolist() == [3, 1, 2]
    np.testing.assert_allclose(np.exp(log.extras["behavior_log_probs"]), [0.5, 0.25, 0.25])
    assert log.provenance.extra["observation_names"] == ["user_feature_0=03a5", "user_feature_0=81ce", "user-item_affinity_0"]
    assert log.warnings[0].startswith("read as Open Bandit's layout")
    mine = read(path, action="item_id", reward="click", observations="user_feature")
    assert "behavior_log_probs" not in mine.extras  # what is given counts alone


def test_more_actions_than_are_read_are_refused(log_of):
    with pytest.raises(UserError, match="line 6 has action 100000000, at most 10,000 are read"):
        log_of(LINES + "100000000:1:0.5 | a\n")
    with pytest.raises(UserError, match="line 6 has action 20000, at most 10,000"):
        log_of(LINES + "20000 1:1:0.5 | a\n")
    assert log_of(LINES + "10000:1:0.5 | a\n").action_space == Discrete(10_000)


@pytest.mark.parametrize("separator", [";", "\t"])
def test_very_many_names_are_not_those_of_open_bandit(tmp_path, separator):
    """Where commas are expected they are one cell, longer than Python's reader takes."""
    path, names = tmp_path / "log.csv", [f"feature_{'x' * 100}_{i:04d}" for i in range(1_200)]
    rows = ([*names, "action", "reward"], *([f"{i}.5"] * 1_200 + [str(i % 2), "1"] for i in range(6)))
    path.write_text("".join(separator.join(row) + "\n" for row in rows))
    log = read(path)
    assert log.observations.shape == (6, 1_200)
    assert log.actions.tolist() == [0, 1] * 3
