"""Published numbers in tables: which methods of a suite they stand at, and the best of each log."""

import pytest

from deadreckon.bench.forms import rendered
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import read
from deadreckon.bench.tables import METRICS, _printed, tables

LEARN = 'seeds = 2\nlogs = ["hopper-medium-v2", "ant-medium-v2", "hopper-random-v2"]\n[methods]\n'
DESIGN = 'kind = "design"\nbudget = "cpu"\nproblems = ["superconductor"]\n[methods]\n'
OPE = 'kind = "ope"\nbudget = "cpu"\nlogs = ["hopper-medium-v2"]\n[methods]\n'


@pytest.fixture
def printed(tmp_path):
    """What is published for methods on the first log or problem."""

    def found(head, *methods, metric=0):
        (path := tmp_path / "suite.toml").write_text(head + "\n".join(methods))
        suite = read(path)
        return _printed(suite, suite.on[0], METRICS[suite.kind][metric])

    return found


@pytest.mark.parametrize(
    ("methods", "thesis", "corl"),
    [
        (['BC = { agent = "bc" }'], {"BC": 29.0}, {"BC": 53.51}),
        (['a = { agent = "iql", preset = true }', 'b = { agent = "rebrac" }'], {}, {"a": 67.53, "b": 102.29}),
        # Widths of layers, and how long a model of the log's policy is fitted, also under other names.
        (['a = { agent = "bc", fields = { hidden = [8] } }'], {"a": 29.0}, {"a": 53.51}),
        (['a = { agent = "bc", fields = { hidden_dims = [8] } }'], {"a": 29.0}, {"a": 53.51}),
        (['a = { agent = "cql", fields = { critic_hidden = [8] } }'], {"a": 58.0}, {"a": 59.08}),
        (['a = { agent = "brac", fields = { behavior_steps = 8 } }'], {"a": 31.1}, {}),
        (['a = { agent = "brac", fields = { value_penalty = false } }', 'b = { agent = "brac" }'], {"a": 32.7, "b": 31.1}, {}),
        # Variants, also where the method itself is not there.
        (['a = { agent = "bear" }', 'b = { agent = "bear", fields = { constraint = "kl" } }'], {"a": 52.1}, {}),
        (['a = { agent = "bear", fields = { constraint = "kl" } }', 'b = { agent = "bear" }'], {"b": 52.1}, {}),
        (['a = { agent = "bear", fields = { hidden = [8], threshold = 0.2 } }'], {}, {}),
        (['a = { agent = "bc", history = 4 }'], {}, {}),
        (['a = { agent = "cql", preset = true }', 'b = { agent = "cql" }'], {"a": 58.0}, {"a": 59.08}),
        (['a = { agent = "kl_control" }', 'b = { agent = "td3" }'], {}, {}),
    ],
)
def test_published_scores_stand_at_the_method_and_at_no_variant(printed, methods, thesis, corl):
    found = printed(LEARN, *methods)
    assert found == {source: own for source, own in (("thesis", thesis), ("CORL", corl)) if own}


def test_designers_and_estimators_have_variants_too(printed):
    nemo = [f'{name} = {{ agent = "nemo", fields = {{ {fields} }} }}'
            for name, fields in (("a", "design_lr = 0.1"), ("b", "max_travel = 1000.0"), ("c", ""))]  # fmt: skip
    assert printed(DESIGN, *nemo, 'd = { agent = "forward" }') == {"thesis": {"b": 127.0, "d": 89.64}}
    assert printed(DESIGN, nemo[2]) == {"thesis": {"c": 127.0}}
    weighted = ['a = { agent = "is", fields = { behavior = "learned", folds = 1 } }', 'b = { agent = "is" }']
    assert list(printed(OPE, *weighted, metric=1)["thesis"]) == ["a"]
    assert printed(OPE, *weighted) == {}  # the thesis has errors in returns


def test_latex_has_names_and_notes_from_outside_as_text(tmp_path):
    (path := tmp_path / "suite.toml").write_text(LEARN + "'a {x} \\y_$&%#^~' = { agent = 'bc' }\n")
    [found] = tables(read(path), plan(read(path)), Store(tmp_path / "out"))
    told = rendered([found], "latex").splitlines()
    assert r" & a \{x\} \textbackslash{}y\_\$\&\%\#\^{}\~{} \\" in told
    assert all(line.startswith("% ") for line in told[told.index(r"\end{tabular}") + 2 :])
    job = plan(read(path))[0]
    store = Store(tmp_path / "out")
    store.fail(job, "first\n\\end{tabular}", "")
    [found] = tables(read(path), plan(read(path)), store)
    assert all("\n" not in note for note in found.notes)


def test_designs_of_members_with_the_same_resamples_say_so(tmp_path):
    (path := tmp_path / "suite.toml").write_text(
        DESIGN + 'a = { agent = "ensemble" }\nb = { agent = "forward" }\nc = { agent = "cbas" }\n'
    )
    [found, *_] = tables(read(path), plan(read(path)), Store(tmp_path / "out"))
    told = "members have the same bootstrap samples with all seeds, so intervals do not include how these vary"
    assert f"a, c: {told}" in found.notes


def test_a_table_has_a_row_for_each_source_and_the_best_of_each_log(tmp_path):
    (path := tmp_path / "suite.toml").write_text(LEARN + 'BC = { agent = "bc" }\nIQL = { agent = "iql" }\n')
    found = tables(read(path), plan(read(path)), Store(tmp_path / "out"))
    for form, rows in (
        ("text", ["thesis 29.0", "CORL 53.5 67.5"]),
        ("markdown", ["| thesis | 29.0 | |", "| CORL | 53.5 | 67.5 |"]),
        ("latex", [r"thesis & 29.0 & \\", r"CORL & 53.5 & 67.5 \\"]),
        ("csv", ["score,hopper-medium-v2,BC,0,,,,0,2,0,29.0,53.51", "score,hopper-medium-v2,IQL,0,,,,0,2,0,,67.53"]),
    ):
        shown = [" ".join(line.split()) for line in rendered(found, form).splitlines()]
        assert set(rows) <= set(shown), form
    assert rendered(found, "csv").splitlines()[0].endswith(",thesis,corl")
    notes = [note for note in found[0].notes if note.startswith(("thesis: ", "CORL: ", "best published"))]
    assert [note.partition(":")[0] for note in notes[:2]] == ["thesis", "CORL"]
    assert notes[2].endswith(": hopper-medium-v2 102.3 (ReBRAC, CORL); hopper-random-v2 12.2 (BRAC-v, thesis)")
    path.write_text('seeds = 2\nlogs = ["ant-medium-v2"]\n[methods]\nBC = { agent = "bc" }\n')
    [unknown] = tables(read(path), plan(read(path)), Store(tmp_path / "out"))
    assert not any(note.startswith(("thesis: ", "CORL: ", "best published")) for note in unknown.notes)
