"""Which actions are legal: as arrays, functions and columns of tables say it, and what contradicts is refused."""

import numpy as np
import pandas as pd
import pytest

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.data.formats.io import convert, read
from deadreckon.data.normalizer import Normalizer
from deadreckon.data.schema import Schema
from deadreckon.data.spec import Discrete, action_space_from_json, action_space_to_json
from deadreckon.errors import UserError
from deadreckon.policies.table_encoder import TableEncoder
from deadreckon.runs.reading import noted

# Two episodes of three steps; the first ends, the second is cut off.
SEEN = np.array([[0.1], [0.2], [0.3], [0.5], [0.6], [0.7]], np.float32)
AFTER = np.array([[0.2], [0.3], [0.4], [0.6], [0.7], [0.8]], np.float32)
ACTIONS = np.array([0, 2, 1, 1, 0, 2])
LEGAL = np.array([[1, 1, 0], [0, 1, 1], [1, 1, 1], [0, 1, 0], [1, 0, 0], [0, 0, 1]], bool)
ENDS = {"terminals": [0, 0, 1, 0, 0, 0], "timeouts": [0, 0, 0, 0, 0, 1]}
GIVEN = {"observations": SEEN, "actions": ACTIONS, "rewards": np.arange(6.0), **ENDS, "legal": LEGAL}


def test_masks_are_the_end_of_the_observations():
    log = Dataset.from_arrays(**GIVEN)
    np.testing.assert_array_equal(log.observations, np.concatenate([SEEN, LEGAL], 1))
    assert log.action_space == Discrete(3, masked=True)
    assert log.spec.mask_size == 3
    assert "legal" not in log.extras
    np.testing.assert_array_equal(log.next_observations[:2], log.observations[1:3])
    assert log.final_known.tolist() == [False, False]
    assert repr(log.action_space) == "Discrete(n=3, masked=True)"
    assert repr(Discrete(3)) == "Discrete(n=3)"
    for space in (Discrete(3), log.action_space):
        assert action_space_from_json(action_space_to_json(space)) == space
    view = Normalizer.of(log.spec, standardise=True)
    np.testing.assert_array_equal(view.observe(log.observations)[:, 1:], LEGAL)


def test_what_is_legal_next_is_known_where_rows_follow():
    log = Dataset.from_arrays(**GIVEN, next_observations=AFTER)
    assert log.successors is None
    np.testing.assert_array_equal(log.next_observations[[0, 1, 3, 4], 1:], LEGAL[[1, 2, 4, 5]])
    assert log.usable.tolist() == [True, True, True, True, True, False]  # the end of the second episode is unknown
    told = np.roll(LEGAL, -1, 0)
    log = Dataset.from_arrays(**GIVEN, next_observations=AFTER, next_legal=told)
    assert log.usable.all()
    np.testing.assert_array_equal(log.final_observations[1, 1:], told[5])
    # Without flags, episodes end where the next row does not continue.
    flags = {key: value for key, value in GIVEN.items() if key not in ENDS}
    log = Dataset.from_arrays(**flags, next_observations=AFTER)
    assert log.ends.tolist() == [2, 5]
    assert log.final_known.tolist() == [False, False]
    last = Dataset.from_arrays(**GIVEN, final_observations=AFTER[[2, 5]], final_legal=[[0, 0, 0], [1, 0, 1]])
    assert last.final_known.tolist() == [False, True]
    assert last.final_observations[1].tolist() == [np.float32(0.8), 1, 0, 1]
    assert last.dropped == 0


def test_a_function_says_what_is_legal():
    rule = lambda seen: np.concatenate([seen < 9, seen < 9, seen > 0.15], 1)  # noqa: E731
    log = Dataset.from_arrays(**{**GIVEN, "legal": rule}, next_observations=AFTER)
    assert log.usable.all()
    np.testing.assert_array_equal(log.observations[:, 1:], rule(SEEN))
    np.testing.assert_array_equal(log.next_observations[:, 1:], rule(AFTER))
    frame = pd.DataFrame({"x": SEEN[:, 0], "action": ACTIONS, "reward": 1.0, "episode": [0, 0, 0, 1, 1, 1]})
    read_too = Dataset.from_frame(frame, legal=rule)
    np.testing.assert_array_equal(read_too.observations, log.observations)
    with pytest.raises(UserError, match=r"function of legal actions must give shape \(6, actions\), got \(6,\)"):
        Dataset.from_arrays(**{**GIVEN, "legal": lambda seen: seen[:, 0] > 0})


@pytest.mark.parametrize("name", ["log.hdf5", "log.parquet", "folder"])
def test_masks_survive_their_file(name, tmp_path):
    log = Dataset.from_arrays(**GIVEN, next_observations=AFTER, next_legal=np.roll(LEGAL, -1, 0))
    source = tmp_path / "from.hdf5"
    write_hdf5(log, source)
    convert(source, tmp_path / name)
    again = read(tmp_path / name)
    assert (again.fingerprint, again.action_space) == (log.fingerprint, log.action_space)
    with pytest.raises(UserError, match="CSV does not keep which actions are legal"):
        convert(source, tmp_path / "log.csv")


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"actions": [2, 2, 1, 1, 1, 2]}, "2 of 6 rows take an action that is illegal there, first row 0"),
        ({"legal": LEGAL * np.array([[1], [1], [1], [0], [1], [1]])}, "legal allows no action in row 3"),
        ({"legal": LEGAL * 0.5}, r"legal has \[0.5, 0.5, 0.0\] in row 0, each must be 0 or 1"),
        ({"legal": LEGAL[:, 0]}, r"legal must be truth values of shape \(rows, actions\), got shape \(6,\)"),
        ({"legal": LEGAL[:5]}, "column legal has 5 rows, observations have 6"),
        ({"action_space": Discrete(4)}, "legal has a column for each of 3 actions, the action space has 4"),
        ({"legal": None, "next_legal": LEGAL}, "next_legal needs legal as well"),
        ({"next_legal": LEGAL}, "next_legal needs next_observations as well"),
        ({"next_observations": AFTER[::-1]}, "next observation of row 0 is not the following row's.*give next_legal"),
        ({"observations": np.zeros((6, 4, 4, 3), np.uint8)}, "legal needs flat observations"),
        ({"next_observations": AFTER[:4]}, r"next_observations have shape \(4, 1\), observations \(6, 1\)"),
        ({"next_observations": AFTER, "timeouts": [1, 0]}, "column timeouts has 2 values, 6 are needed"),
        ({"next_observations": AFTER, "terminals": [1, 0]}, "column terminals has 2 values, 6 are needed"),
        ({"next_observations": AFTER, "final_known": [1]}, "column final_known has 1 values, 2 are needed"),
        ({"final_observations": AFTER[[2, 5]], "final_known": [1]}, "column final_known has 1 values, 2 are needed"),
        ({"next_observations": AFTER, "timeouts": [0, 0, 2, 0, 0, 1]}, "column timeouts has 2 in row 2, 0 or 1 is needed"),
        ({"next_observations": AFTER, "timeouts": [0, 0, 0, 0, np.nan, 1]}, "column timeouts has nan in row 4, 0 or 1"),
        ({"next_observations": AFTER, "final_known": [1, 2]}, "column final_known has 2 in row 1, 0 or 1 is needed"),
        ({"final_observations": AFTER[[2, 5]], "final_known": [np.nan, 1]}, "column final_known has nan in row 0, 0 or 1"),
        ({"legal": [[1, 0], [1]] * 3}, "legal must be truth values .* its rows differ in length"),
        ({"observations": np.full((6, 1), "a")}, "column observations holds <U1, numbers are needed"),
        ({"legal": None, "action_space": Discrete(3, masked=True)}, r"shape \(6, 1\) cannot end in the mask of 3 actions"),
    ],
)
def test_what_contradicts_is_refused(changed, words):
    with pytest.raises(UserError, match=words):
        Dataset.from_arrays(**{**GIVEN, **changed})


# ---- tables

WAYS = {
    "a text with bars": ({"legal": ["a|b", "b|c", "a|b|c", "b", "a", "c"]}, {}),
    "JSON": ({"available_actions": ['["a", "b"]', '["b", "c"]', '["a","b","c"]', '["b"]', '["a"]', '["c"]']}, {}),
    "lists": ({"legal_actions": [["a", "b"], ["b", "c"], ["a", "b", "c"], ["b"], ["a"], ["c"]]}, {}),
    "flags": ({f"legal_{level}": LEGAL[:, i].astype(int) for i, level in enumerate("abc")}, {}),
    "asked for": ({"choice": ["a;b", "b;c", "a;b;c", "b", "a", "c"]}, {"legal": "choice"}),
    "asked flags": ({f"can {level}": LEGAL[:, i] for i, level in enumerate("abc")}, None),
    "asked prefix": ({f"may_{level}": LEGAL[:, i] for i, level in enumerate("abc")}, {"legal": "may"}),
}


@pytest.mark.parametrize("way", WAYS)
def test_tables_say_it_in_many_ways(way):
    more, asked = WAYS[way]
    table = {"x": SEEN[:, 0], "action": [*"acbbac"], "reward": np.arange(6.0), "episode": [0, 0, 0, 1, 1, 1], **more}
    if asked is None:
        columns = {f"can {level}": {"role": "legal", "kind": "flag", "of": level} for level in "abc"}
        plain = {"x": "observation", "action": "action", "reward": "reward", "episode": "episode"}
        kinds = {"x": "number", "action": "category", "reward": "number", "episode": "integer"}
        columns |= {name: {"role": role, "kind": kinds[name]} for name, role in plain.items()}
        asked = {"schema": {"columns": columns}}
    log = Dataset.from_frame(table, **asked)
    np.testing.assert_array_equal(log.observations, np.concatenate([SEEN, LEGAL], 1))
    assert log.provenance.extra["observation_names"] == ["x", "legal=a", "legal=b", "legal=c"]
    assert log.provenance.extra["action_levels"] == ["a", "b", "c"]
    again = Dataset.from_frame(table, schema=log.provenance.extra["schema"])
    assert again.fingerprint == log.fingerprint
    told = any("which actions are legal (--legal)" in line for line in log.warnings)
    assert told == (way in ("a text with bars", "JSON", "lists", "flags"))


@pytest.mark.parametrize(("names", "cell"), [
    (["f(x)", "b"], "f(x)|b"), (["O'Neil", "b"], "O'Neil, b"), (["a, x", "b"], '["a, x", "b"]'),
    (["New York", "b"], "(New York;b)"), (["a", "b"], "['a' 'b']"), (["New York", "b"], '{"New York",b}'),
])  # fmt: skip
def test_brackets_and_quotes_of_a_list_are_no_part_of_names_and_others_are(names, cell):
    taken = names * 3
    table = {"x": np.arange(6.0), "a": taken, "r": np.arange(6.0), "open": [cell] * 6}
    log = Dataset.from_frame(table, action="a", reward="r", legal="open")
    assert log.provenance.extra["action_levels"] == sorted(names)
    np.testing.assert_array_equal(log.observations[:, 1:], np.ones((6, 2)))


@pytest.mark.parametrize("cells", [[["a", "b"]] * 3 + [["b", None]], ['["a", "b"]'] * 3 + ['["b", null]']])
def test_an_empty_entry_of_a_list_is_no_action(cells):
    table = {"x": np.arange(4.0), "a": ["a", "b"] * 2, "r": np.arange(4.0), "legal": cells}
    with pytest.raises(UserError, match="column legal lists an empty action in row 3"):
        Dataset.from_frame(table, action="a", reward="r", legal="legal")


def test_actions_that_are_only_legal_are_actions_too():
    table = {"x": SEEN[:, 0], "action": [0, 2, 0, 0, 0, 2], "reward": 1.0 + SEEN[:, 0], "legal": ["0 2 5"] * 6}
    log = Dataset.from_frame(table, legal="legal")
    assert log.action_space == Discrete(3, masked=True)
    assert log.provenance.extra["action_levels"] == [0, 2, 5]
    assert log.actions.tolist() == [0, 1, 0, 0, 0, 1]
    assert (log.observations[:, 1:] == 1).all()


def test_next_legal_columns():
    after = ["b", "a", "c", "b", "a", "a|b"]
    table = {"x": SEEN[:, 0], "next_x": AFTER[:, 0], "action": [*"acbbac"], "reward": np.arange(6.0),
             "terminal": [0, 0, 1, 0, 0, 0], "timeout": [0, 0, 0, 0, 0, 1],
             "legal": ["a|b", "b|c", "a|b|c", "b", "a", "c"], "next_legal": after}  # fmt: skip
    log = Dataset.from_frame(table)
    assert log.usable.all()
    assert log.final_observations[1].tolist() == [np.float32(0.8), 1, 1, 0]
    # Nothing is legal, or known to be, where nothing follows or what follows is not known.
    gone = {"next_x": [*AFTER[:-1, 0], np.nan], "next_legal": ["b", "a", None, "b", "a", None]}
    last = Dataset.from_frame(table | gone, next_legal="next_legal")
    assert last.final_known.tolist() == [True, False]
    np.testing.assert_array_equal(last.next_observations[[0, 1, 3, 4]], log.next_observations[[0, 1, 3, 4]])
    with pytest.raises(UserError, match="column next_legal is empty in row 1"):
        Dataset.from_frame(table | gone | {"next_legal": ["b", None, "c", "b", "a", None]}, next_legal="next_legal")
    flags = {f"next_legal_{a}": [float(a in cell) for cell in after[:-1]] + [np.nan] for a in "abc"}
    with pytest.raises(UserError, match="column next_legal_a is empty in row 5"):
        Dataset.from_frame({key: value for key, value in table.items() if key != "next_legal"} | flags)


@pytest.mark.parametrize(
    ("column", "asked", "words"),
    [
        (["a|b"] * 5 + ["c|d"], {"legal": "legal"}, "1 of 6 rows take an action that is illegal there, first row 1"),
        (["a|b|c"] * 5 + [None], {"legal": "legal"}, "column legal is empty in row 5; it must list the actions"),
        ([2.5] * 6, {"legal": "legal"}, "column legal holds double, lists of actions or texts such as a|b are needed"),
    ],
)
def test_columns_that_do_not_say_it_are_refused(column, asked, words):
    table = {"x": SEEN[:, 0], "action": [*"acbbac"], "reward": np.arange(6.0), "legal": column}
    with pytest.raises(UserError, match=words):
        Dataset.from_frame(table, **asked)


@pytest.mark.parametrize("column", [["yes"] * 3 + ["no"] * 3, [3, 2, 3, 1, 2, 2], ["a"] * 6, ["a|b"] * 6])
def test_a_name_alone_is_not_believed(column):
    """A column called available that does not list actions stays what it was."""
    table = {"x": SEEN[:, 0], "action": [*"acbbac"], "reward": np.arange(6.0), "available": column}
    log = Dataset.from_frame(table)
    assert log.action_space == Discrete(3)


def test_continuous_actions_are_never_illegal():
    table = {"x": SEEN[:, 0], "dose": np.linspace(0, 1, 6), "reward": np.arange(6.0), "legal": ["a|b"] * 6}
    with pytest.raises(UserError, match="column dose is a continuous action, and only discrete ones can be illegal"):
        Dataset.from_frame(table, action="dose", legal="legal")


@pytest.mark.parametrize("words", [("yes", "no"), ("on", "off"), ("True", "False")])
@pytest.mark.parametrize("legal", [None, "legal"])
def test_actions_that_are_words_for_true_and_false(tmp_path, words, legal):
    """The file's reader makes truth values of them, and columns of legal actions are named by the words."""
    yes, no = words
    asked = {} if legal is None else {"legal": legal}
    rows = [f"{i},{yes if i % 2 else no},{i},1,{i % 2}" for i in range(8)]
    (tmp_path / "columns.csv").write_text("\n".join([f"x,action,reward,legal_{no},legal_{yes}", *rows]) + "\n")
    rows = [f"{i},{yes if i % 2 else no},{i},{f'{no}|{yes}' if i % 2 else no}" for i in range(8)]
    (tmp_path / "list.csv").write_text("\n".join(["x,action,reward,legal", *rows]) + "\n")
    for file in ("columns.csv", "list.csv"):
        log = read(tmp_path / file, **asked)
        assert log.action_space == Discrete(2, masked=True)
        assert log.actions.tolist() == [0, 1] * 4
        np.testing.assert_array_equal(log.observations[:, -2:], [[1, 0], [1, 1]] * 4)
        assert read(tmp_path / file, schema=Schema.from_json(log.provenance.extra["schema"])).fingerprint == log.fingerprint
        encoder = TableEncoder(noted(log))  # a policy in use understands the same words
        assert encoder.allowed.strangers == []
        cells = pd.read_csv(tmp_path / file, dtype=str).drop(columns=["action", "reward"]).astype({"x": float})
        np.testing.assert_array_equal(encoder.encode(cells).observations, log.observations)
