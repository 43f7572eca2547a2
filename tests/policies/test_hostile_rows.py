"""Rows from elsewhere that are JSON and no rows of the policy's log: `predict` and the service refuse each in one line."""

import json

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.policies import portable
from deadreckon.policies.table_predict import Predictor
from deadreckon.runs.service import Refused, Service
from tests.policies.test_hostile_files import changed

HUGE = 10**400
COLUMNS = changed("extra.schema.columns.e", {"role": "episode", "kind": "category"})["extra"]["schema"]["columns"]
ROW = {"x": 1, "m": "a", "e": "1", "L": ["u"]}


@pytest.fixture(scope="module")
def policies():
    """Of plain numbers, of a table with legal actions, and a mixture of two of the latter."""
    columns = COLUMNS | {"L": {"role": "legal", "kind": "category"}}
    log = changed("extra.schema.columns", columns) | {"observation_shape": [5]}
    net = {"kind": "MLP", "weights": ["@w"], "biases": ["@b"], "activation": "relu", "normalise": False, "mask": 0}
    one = {"kind": "EnvPolicy", "inner": {"kind": "Categorical", "net": net}} | dict.fromkeys(("mean", "std", "low", "high"))
    both = {"kind": "EnvPolicy", "inner": {"kind": "Mixture", "members": [one, one]}} | dict.fromkeys(("mean", "std"))
    arrays = {"w": np.ones((5, 2), np.float32), "b": np.arange(2, dtype=np.float32)}
    moves = one | {"inner": {"kind": "Deterministic", "net": net}}
    opposed = {"w": np.array([[1e3], [1e3], [-1e3]], np.float32), "b": np.zeros(1, np.float32)}
    plain = Predictor(portable.NumpyPolicy({"policy": moves}, opposed), {"observation_shape": [3]})
    made = [Predictor(portable.NumpyPolicy({"policy": each}, arrays), log) for each in (one, both)]
    return dict(zip(("plain", "table", "mixture"), (plain, *made)))


@pytest.mark.parametrize("policy", ["table", "mixture"])
def test_such_rows_are_taken_otherwise(policy, policies):
    assert Service(policies[policy], "policy").predict(json.dumps(ROW).encode(), {}) == {"action": {"act": "v"}}


CASES = [
    ("plain", [HUGE, 0, 0], "a number that is too large for float32"),
    ("plain", [3e38, 3e38, 3e38], "no finite action in row 0"),
    ("table", [ROW | {"x": 1.5}, ROW | {"x": HUGE}], r"column x has 1000000.* in row 1, a number is needed"),
    ("table", ROW | {"L": "[" * 50_000}, r"column L has '\[\[\[.*\.\.\. in row 0, which is no action"),
    ("table", ROW | {"L": f"[{'1' * 5_000}]"}, r"column L has '11.*\.\.\. in row 0, which is no action"),
    ("mixture", ROW | {"e": [1]}, r"column e has \[1\] in row 0, a text or a number is needed"),
    ("mixture", ROW | {"e": {}}, r"column e has {} in row 0, a text or a number is needed"),
]


@pytest.mark.filterwarnings("ignore:overflow", "ignore:invalid value")
@pytest.mark.parametrize(("policy", "rows", "words"), CASES)
def test_rows_are_refused_in_one_line(policy, rows, words, policies):
    with pytest.raises(UserError, match=words):
        policies[policy].predict(rows)
    with pytest.raises(Refused, match=words) as refused:
        Service(policies[policy], "policy").predict(json.dumps(rows).encode(), {})
    assert refused.value.status == 422
    assert "\n" not in refused.value.text
