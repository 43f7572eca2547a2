import inspect

import numpy as np
import pytest

from deadreckon.data.columns import COLUMNS, NEEDED, RESERVED, extra_name, renamed
from deadreckon.data.dataset import Dataset
from deadreckon.errors import UserError


def test_no_further_column_can_have_the_name_of_an_argument():
    arguments = inspect.signature(Dataset.from_arrays).parameters.keys() - {"extras"}
    assert arguments | {"cls"} == RESERVED
    assert set(NEEDED) < set(COLUMNS) < RESERVED


def test_names_of_further_columns():
    assert extra_name("infos/goal", {}) == "goal"
    assert extra_name("infos/goal", {"goal": 0}) == "infos_goal"
    assert extra_name("infos/name", {}) == "infos_name"
    with pytest.raises(UserError, match="two columns would be called infos_goal"):
        extra_name("infos/goal", {"goal": 0, "infos_goal": 0})
    column = np.zeros(1)
    assert renamed("log", {"name": column, "rewards": column, "goal": column}).keys() == {"infos_name", "rewards", "goal"}
    with pytest.raises(UserError, match="log: two columns would be called infos_name"):
        renamed("log", {"name": column, "infos_name": column})
