"""What the speed table rests on: operations counted by hand are those of the programs that are timed."""

from pathlib import Path

import pytest

from deadreckon.bench.idle import is_measured

FOLDER = Path(__file__).resolve().parent.parent / "benchmarks"


SLOW = pytest.mark.slow
CASES = ["cql", *(pytest.param(case, marks=SLOW) for case in ("fqe-11", "iql", "awac", "rebrac", "bcq", "nemo-40"))]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_operations_by_hand_are_those_of_the_program(monkeypatch, case):
    """The program may do a little more (what it does twice, which XLA finds), never less than it is credited with."""
    monkeypatch.syspath_prepend(str(FOLDER))
    import flops
    import ours
    import protocol

    options = protocol.options(case, batch=32, width=256, threads=1, rows=500)
    program = ours.make_ours(case, options).flops
    assert flops.needed(options) <= program * 1.001
    assert program == pytest.approx(flops.needed(options), rel=0.12)


@pytest.mark.parametrize(("module", "begins"), [("larger", "make"), ("scale", "case")])
def test_idle_processes_stand_still_while_large_tables_are_timed(module, begins, monkeypatch):
    monkeypatch.syspath_prepend(str(FOLDER))
    timed, seen = __import__(module), []

    def begun(*given):
        seen.append(is_measured())
        raise SystemExit

    monkeypatch.setattr(timed, begins, begun)
    monkeypatch.setattr("sys.argv", [f"{module}.py"])
    with pytest.raises(SystemExit):
        timed.main()
    assert seen == [True]
    assert not is_measured()


def test_figures_go_to_their_places_and_text_stays(monkeypatch, tmp_path, capsys):
    monkeypatch.syspath_prepend(str(FOLDER))
    import report

    (page := tmp_path / "page.md").write_text(
        "before\n<!-- one: python -c 'print(7)' -->\nold\n<!-- end -->\nbetween\n"
        "<!-- two: python -c 'print(8)' -->\nkept\n<!-- end -->\nafter\n"
    )
    monkeypatch.setattr("sys.argv", ["report.py", "--out", str(page), "--only", "one"])
    assert report.report() == 0
    text = page.read_text()
    assert "old" not in text
    assert "`python -c 'print(7)'`, " in text
    assert "\n\n7\n" in text
    for words in ("before\n<!-- one", "<!-- end -->\nbetween\n", "\nkept\n<!-- end -->\nafter\n"):
        assert words in text
    monkeypatch.setattr("sys.argv", ["report.py", "--out", str(page), "--only", "three"])
    with pytest.raises(Exception, match="has no place 'three'; it has one, two"):
        report.report()
