"""What the speed table rests on: operations counted by hand are those of the programs that are timed."""

from pathlib import Path

import pytest

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


@pytest.mark.parametrize("case", ["fqe-11", pytest.param("nemo-40", marks=pytest.mark.slow)])
def test_operations_by_hand_are_those_of_the_program(monkeypatch, case):
    """Of fitted Q evaluation and NEMO: the program may do a little more, never less than it is credited with."""
    monkeypatch.syspath_prepend(str(FOLDER))
    import flops
    import ours
    import protocol

    options = protocol.options(case, batch=64, width=64, threads=1, rows=500)
    program = ours.make_ours(case, options).flops
    assert flops.needed(options) <= program * 1.001
    assert program == pytest.approx(flops.needed(options), rel=0.05)
