import gzip
import pickle
import subprocess
import sys

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.unpickle import load_pickle


class Runs:
    """A pickle that runs a command when it is read in the ordinary way."""

    def __init__(self, function, *arguments):
        self.call = function, arguments

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
def test_plain_values_come_back(tmp_path, protocol):
    value = {
        "fortran": np.asfortranarray(np.arange(6.0).reshape(2, 3)), "swapped": np.arange(3, dtype=">i4"),
        "scalar": np.float32(1.5), "flags": np.array([True, False]), "text": np.array(["a", "bc"]), "empty": np.zeros((0, 2)),
        "nested": ([1, "two", None], {"x": {3}}),
    }  # fmt: skip
    path = tmp_path / "x.pkl"
    path.write_bytes(gzip.compress(pickle.dumps(value, protocol)))
    found = load_pickle(path)
    for key in ("fortran", "swapped", "flags", "text", "empty"):
        np.testing.assert_array_equal(found[key], value[key])
        assert found[key].dtype == value[key].dtype
    assert found["scalar"] == 1.5
    assert found["nested"] == value["nested"]


@pytest.mark.parametrize(
    "value",
    [
        Runs(np.ndarray, (1,), "O", b"12345678"),  # takes the process down if numpy itself is called
        np.array([object], object),
        np.zeros(2, [("a", "f4"), ("b", "i4")]),
        np.array(["2020-01-01"], "datetime64[D]"),
    ],
    ids=["crafted", "objects", "structured", "dates"],
)
def test_arrays_of_other_things_than_numbers_are_refused(tmp_path, value):
    path = tmp_path / "x.pickle"
    path.write_bytes(pickle.dumps({"actions": value}))
    program = f"from deadreckon.unpickle import load_pickle\nload_pickle({str(path)!r})"
    if isinstance(value, Runs):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert done.returncode == 1
        assert "UserError" in done.stderr
    with pytest.raises(UserError, match=str(path)) as caught:
        load_pickle(path)
    assert "\n" not in str(caught.value)


def test_the_real_policies_name_foreign_classes(real_data):
    with pytest.raises(UserError, match="refused: the pickle asks for "):
        load_pickle(real_data / "adroit" / "door-v0_dapg_policy.pickle")
