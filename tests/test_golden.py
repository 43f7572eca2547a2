"""Short runs give the numbers that they gave before; those of offline agents stand with the conformance tests, whose programs
they share."""

import pytest

from tests import golden

# Methods whose programs take seconds to compile, and most of whose code others below run, too.
SLOW = {
    "mbo/cbas", "mbo/autofocus", "mbo/auto", "mbo/mins", "mbo/ddom", "mbo/gp-bo", "ope/mb-ar", "online/steve", "online/rlpd",
    "online/slbo", "online/dapg", "online/d4pg", "online/mve", "online/pets", "fine-tuning/td3_bc", "fine-tuning/cal_ql",
}  # fmt: skip


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
        for name in golden.RUNS
        if not name.startswith("agents/")
    ],
)
def test_numbers_are_as_before(name):
    told = golden.problem_of(name)
    assert told is None, told


def test_nothing_is_kept_that_is_no_longer_computed():
    assert list(golden.kept()) == list(golden.RUNS)
