import inspect

import numpy as np
import pytest

from deadreckon.data.columns import COLUMNS, NEEDED, RESERVED, extra_name, renamed
from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import read
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


ENDED = np.arange(6) % 3 == 2
STEPS = {"observations": np.arange(6.0)[:, None], "next_observations": np.arange(1.0, 7.0)[:, None],
         "actions": np.zeros((6, 1)), "rewards": np.ones(6)}  # fmt: skip
UNREAD = {
    "masks of JaxRL": ({"masks": 1 - ENDED, "dones_float": ENDED * 1.0}, r"add terminals = \(masks == 0\) if masks are 1"),
    "masks beside dones": ({"dones": ENDED, "masks": 1 - ENDED}, "column masks says nothing of how episodes end"),
    "timeouts without terminals": ({"terminal": ENDED, "timeouts": ENDED}, "column terminal must be called terminals: under"),
    "terminals without timeouts": ({"terminals": ENDED, "truncated": ENDED}, "column truncated must be called timeouts"),
    **{name: ({name: ENDED}, f"column {name} must be called terminals: under") for name in ("is_terminal", "terminateds")},
    **{name: ({name: ENDED}, f"column {name} must be called timeouts") for name in ("truncateds", "Timeout")},
    **{name: ({name: ENDED}, f"column {name} must be called terminals .* or timeouts") for name in
       ("is_done", "is_last", "dones_float")},
}  # fmt: skip


@pytest.mark.parametrize("kind", UNREAD)
def test_end_flags_under_other_names_are_no_mere_extras(tmp_path, kind):
    columns, words = UNREAD[kind]
    given = {key: column for key, column in STEPS.items() if key != "next_observations" or "terminals" not in columns} | columns
    np.savez(tmp_path / "log.npz", **given)
    for log in (lambda: Dataset.from_dict(given), lambda: read(tmp_path / "log.npz")):
        with pytest.raises(UserError, match=words) as caught:
            log()
        assert "\n" not in str(caught.value)


def test_further_flags_beside_those_of_a_log_are_kept():
    flags = {"terminals": ENDED, "timeouts": np.zeros(6), "is_first": np.roll(ENDED, 1), "terminal": ENDED, "truncated": ENDED}
    log = Dataset.from_dict(STEPS | flags)
    assert log.extras.keys() == {"is_first", "terminal", "truncated"}
    table = {"x": np.arange(6.0), "action": np.zeros(6), "reward": np.ones(6), "end": ENDED, "masks": 1 - ENDED}
    assert Dataset.from_frame(table, terminal="end", keep="masks").extras.keys() == {"masks"}
    assert Dataset.from_dict(STEPS | {"is_first": np.roll(ENDED, 1)}).extras.keys() == {"is_first"}


def test_flags_that_say_no_more_and_masks_of_actions_are_kept():
    timeouts = {"timeouts": ENDED, "is_last": ENDED, "masks": np.ones((6, 3))}
    assert Dataset.from_dict({**STEPS, **timeouts}).extras.keys() == {"is_last", "masks"}
    with pytest.raises(UserError, match="column is_last must be called terminals"):
        Dataset.from_dict(STEPS | timeouts | {"is_last": np.ones(6)})
