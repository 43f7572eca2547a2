"""Design problems: what they show, what they hide, and judges that say the truth."""

import importlib.util

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.errors import UserError
from deadreckon.mbo import BestOfData, problem
from deadreckon.mbo.problems import gfp as gfp_module
from deadreckon.mbo.problems import hopper_controller as hopper
from deadreckon.mbo.problems.sequence_gp import SequenceGP, differences
from deadreckon.mbo.problems.superconductor import ORACLES, amounts, composition, elements, properties, statistics
from deadreckon.mbo.problems.synthetic import FUNCTIONS

needs_sklearn = pytest.mark.skipif(importlib.util.find_spec("sklearn") is None, reason="scikit-learn is not installed")
needs_rdkit = pytest.mark.skipif(importlib.util.find_spec("rdkit") is None, reason="RDKit is not installed")

BEST = {
    "ackley": np.zeros(10),
    "branin": np.array([np.pi, 2.275]),
    "hartmann6": np.array([0.20169, 0.150011, 0.476874, 0.275332, 0.311652, 0.6573]),
    "rastrigin": np.zeros(10),
    "rosenbrock": np.ones(10),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_test_functions_have_their_known_optimum(name):
    made = problem(name, rows=500)
    assert made.optimum is not None
    np.testing.assert_allclose(made.oracle(BEST[name][None])[0], made.optimum, atol=2e-5)
    near = BEST[name] + 1e-2 * np.random.default_rng(0).standard_normal((100, len(BEST[name])))
    assert (made.oracle(near) <= made.optimum + 1e-12).all()
    assert len(made.visible) == 300
    assert made.visible.y.max() < made.high <= made.optimum
    np.testing.assert_allclose(made.oracle(made.visible.x), made.visible.y)


def test_a_test_function_with_noise_and_dimensions():
    made = problem("ackley", dimensions=3, noise=1.0, rows=4000, shown=100.0)
    assert made.visible.x.shape == (4000, 3)
    assert (made.visible.y - made.oracle(made.visible.x)).std() == pytest.approx(1.0, rel=0.05)
    with pytest.raises(UserError, match="branin has 2 dimensions, got 3"):
        problem("branin", dimensions=3)
    with pytest.raises(UserError, match="rosenbrock needs 2 or more dimensions, got 1"):
        problem("rosenbrock", dimensions=1)


def test_nk_by_hand():
    """Four sites of two letters: each site's worth is looked up at its letter and the next one's."""
    made = problem("nk", length=4, letters=2, neighbours=1, shown=100.0, seed=5)
    table = np.random.default_rng(5).random((4, 4))
    x = np.array([[0, 1, 1, 0]], np.float32)
    by_hand = (table[0, 0 + 2 * 1] + table[1, 1 + 2 * 1] + table[2, 1 + 2 * 0] + table[3, 0 + 2 * 0]) / 4
    assert made.oracle(x)[0] == pytest.approx(by_hand)
    assert made.optimum == made.visible.y.max()
    assert len(problem("nk").visible) == 4**8 / 2
    with pytest.raises(UserError, match=r"neighbours must be 0 .. 2, got 3"):
        problem("nk", length=3, neighbours=3)
    with pytest.raises(UserError, match="at most 1,000,000 designs"):
        problem("nk", length=20)


def test_scores_of_proposals():
    made = problem("branin", rows=200, shown=50.0)
    found = made.score(BestOfData().propose(made.visible, 10))
    assert found.percentile(100) == pytest.approx(made.visible.y.max())
    assert found.percentile(100, normalised=True) == pytest.approx((made.visible.y.max() - made.low) / (made.high - made.low))
    assert found.percentile(50) == pytest.approx(np.median(np.sort(made.visible.y)[-10:]))
    assert found.exploitation == pytest.approx(0.0, abs=1e-6)
    assert str(found).startswith("BestOfData on branin: best of 10 ")
    best = made.score(np.array([[np.pi, 2.275]]))
    assert best.percentile() == pytest.approx(-0.397887, abs=1e-5)
    assert np.isnan(best.exploitation)
    with pytest.raises(UserError, match=r"x0 is 11 in row 0, a number in \[-5, 10\] is needed"):
        made.score(np.array([[11.0, 1.0]]))


def test_names_options_and_missing_files(tmp_path):
    with pytest.raises(UserError, match="unknown problem 'braning': did you mean branin"):
        problem("braning")
    with pytest.raises(UserError, match="unknown option of branin 'row': did you mean rows"):
        problem("branin", row=3)
    for name, file in (("tfbind8", "tfbind8_six6.npz"), ("gfp", "avgfp.tsv"), ("superconductor", "superconductor.csv")):
        with pytest.raises(UserError, match=f"{name} needs {file} .*: give --path, or put it at .*designs/{file}"):
            problem(name)
    with pytest.raises(UserError, match="nowhere is not there"):
        problem("molecule", path=tmp_path / "nowhere")
    for shown in (150.0, -1.0, float("nan")):
        with pytest.raises(UserError, match="^branin: percentiles of shown scores ascend from 0 to 100 at most, got 0 and "):
            problem("branin", shown=shown)


# ---- files that hold something else ---------------------------------------------------------------------------------------


def test_files_that_hold_something_else(tmp_path):
    text = tmp_path / "x.csv"
    text.write_text("a,b\n1,2\n")
    with pytest.raises(UserError, match="neither columns name and Tc, nor critical_temp"):
        problem("superconductor", path=text)
    with pytest.raises(UserError, match="columns smiles and one of"):
        problem("molecule", path=text)
    with pytest.raises(UserError, match="columns variant and score are needed"):
        problem("gfp", path=text)
    text.write_text("variant\tscore\nA0C\t1.0\n")
    with pytest.raises(UserError, match="row 0 has 'A0C', no mutation of the wild type"):
        problem("gfp", path=text)
    for rows, words in (
        ("", "no row has a variant without a stop codon"),
        ("K1*\t1.0\nK1A,S0*\t2.0\n", "no row has a variant without a stop codon"),
        ("5\t1.0\n6\t2.0\n", "column variant must hold texts, got int64"),
    ):
        text.write_text(f"variant\tscore\n{rows}")
        with pytest.raises(UserError, match=words):
            problem("gfp", path=text)


@needs_rdkit
def test_molecules_are_texts(tmp_path):
    path = tmp_path / "numbers.csv"
    path.write_text("smiles,exp\n1,2\n2,3\n")
    with pytest.raises(UserError, match="column smiles must hold texts, got int64"):
        problem("molecule", path=path)


SEQUENCES, SCORES = np.zeros((3, 8), int), np.zeros(3)


@pytest.mark.parametrize(
    ("x", "y", "words"),
    [
        (SEQUENCES, SCORES, "65,535 of 65,536 sequences have no score"),
        (SEQUENCES[:0], SCORES[:0], "65,536 of 65,536 sequences have no score"),
        (SEQUENCES, SCORES[:2], "x and y must have equally many rows, got 3 and 2"),
        (SEQUENCES[:, :7], SCORES, r"x must be \(rows, 8\) with bases 0 .. 3, got \(3, 7\)"),
        (SEQUENCES[0], SCORES, r"x must be \(rows, 8\)"),
        (SEQUENCES + 4, SCORES, r"bases 0 .. 3"),
        (SEQUENCES + 0.5, SCORES, r"bases 0 .. 3"),
        (SEQUENCES + np.nan, SCORES, r"bases 0 .. 3"),
        (np.full((3, 8), "A"), SCORES, "no npz with arrays x and y of numbers"),
        (SEQUENCES, np.full(3, "low"), "no npz with arrays x and y of numbers"),
    ],
)
def test_arrays_that_are_no_sequences_of_dna(tmp_path, x, y, words):
    np.savez(tmp_path / "x.npz", x=x, y=y)
    with pytest.raises(UserError, match=words):
        problem("tfbind8", path=tmp_path / "x.npz")


def test_files_that_are_no_npz(tmp_path):
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "text").write_text("a,b\n1,2\n")
    np.save(tmp_path / "array.npy", SEQUENCES)
    for name in ("empty", "text", "array.npy"):
        with pytest.raises(UserError, match="cannot be read as an npz with arrays x and y"):
            problem("tfbind8", path=tmp_path / name)
    np.savez(tmp_path / "other.npz", x=SEQUENCES)
    with pytest.raises(UserError, match="no npz with arrays x and y of numbers"):
        problem("tfbind8", path=tmp_path / "other.npz")


AMOUNTS = ",".join(elements())


@pytest.mark.parametrize(
    ("name", "options", "head", "row", "words"),
    [
        ("superconductor", {}, "name,Tc", "Ba1Cu{}O7,", "no row has a formula of elements H to Rn and a temperature above 0"),
        ("superconductor", {}, "name,Tc", "Ba1Cu{}O7,low", "column Tc holds texts, numbers are needed; row 0 has 'low'"),
        ("superconductor", {}, "name,Tc", "Ba1Cu{}O7,inf", "critical temperature, K is not finite in row 0"),
        ("superconductor", {"form": "composition"}, f"{AMOUNTS},critical_temp", ",".join(["{}"] * 86) + ",",
         "column critical_temp is empty in row 0"),
        ("superconductor", {"form": "composition"}, f"{AMOUNTS},critical_temp", "," * 85 + "{},1", "column H is empty in row"),
        ("gfp", {}, "variant\tscore", "K1A\t", "column score is empty in row 0"),
        ("gfp", {"oracle": "gp"}, "variant\tscore", "K1A\tdim", "column score holds texts, numbers are needed; row 0 has"),
        pytest.param("molecule", {}, "smiles,exp", "C{}O,", "column exp is empty in row 0", marks=needs_rdkit),
    ],
)  # fmt: skip
def test_no_oracle_is_trained_on_scores_that_are_missing(tmp_path, monkeypatch, name, options, head, row, words):
    def train(*args):
        raise AssertionError("it is")

    for module in ("trees", "gfp", "sequence_gp"):
        monkeypatch.setattr(f"deadreckon.mbo.problems.{module}.kept", train)
    path = tmp_path / "file"
    path.write_text("\n".join([head, *(row.format(*[i + 1] * 86) for i in range(12))]) + "\n")
    with pytest.raises(UserError, match=words) as told:
        problem(name, path=path, **options)
    assert "\n" not in str(told.value)


# ---- materials ------------------------------------------------------------------------------------------------------------


def test_formulas():
    assert amounts("Ba0.4K0.6Fe2As2") == {"Ba": 0.4, "K": 0.6, "Fe": 2.0, "As": 2.0}
    assert amounts("HDO") == {"H": 2.0, "O": 1.0}
    assert amounts("C60") == {"C": 60.0}
    for bad in ("", "Xx2", "Fe=2", "Sm1Ba-1Cu3", "UO2", "fe", "Fe0"):
        with pytest.raises(UserError, match="is not a formula"):
            amounts(bad)
    assert len(elements()) == 86
    assert composition(amounts("H2He3"))[:3].tolist() == [2.0, 3.0, 0.0]


def test_statistics_by_hand():
    """Two elements, one of them three times: atomic masses of hydrogen and helium."""
    found = statistics({"H": 3.0, "He": 1.0})
    assert found.shape == (81,)
    assert found[0] == 2
    t, p = np.array([1.008, 4.0026]), np.array([0.75, 0.25])
    w, v = t / t.sum(), p * t / (p * t).sum()
    weighted = (p * t).sum()
    mass = [
        t.mean(), weighted, np.sqrt(t.prod()), (t**p).prod(), -(w * np.log(w)).sum(), -(v * np.log(v)).sum(),
        t[1] - t[0], abs(p[1] * t[1] - p[0] * t[0]), t.std(), np.sqrt((p * (t - weighted) ** 2).sum()),
    ]  # fmt: skip
    np.testing.assert_allclose(found[1:11], mass, rtol=1e-5)
    # Nobody knows helium's heat of fusion here: hydrogen's stands alone.
    fusion = found[1 + 10 * properties().index("fusion_heat") :][:10]
    np.testing.assert_allclose(fusion, [0.117, 0.117, 0.117, 0.117, 0, 0, 0, 0, 0, 0], atol=1e-9)


@pytest.mark.slow
@needs_sklearn
def test_superconductors(real_data, tmp_path, monkeypatch):
    """Every tenth material, so that the forest grows fast; asked again, the oracle is not trained again."""
    lines = (real_data / "supercon" / "Supercon_data.csv").read_text().splitlines()
    small = tmp_path / "small.csv"
    small.write_text("\n".join([lines[0], *lines[1::10]]) + "\n")
    made = problem("superconductor", path=small, form="composition")
    assert made.visible.x.shape[1] == 86
    assert made.visible.y.max() < made.high
    said = float(made.about.split("rank correlation ")[1].split()[0])
    assert said > 0.7
    monkeypatch.setattr("deadreckon.mbo.problems.trees._train", None)
    again = problem("superconductor", path=small, form="composition")
    np.testing.assert_array_equal(again.oracle(made.visible.x), made.oracle(made.visible.x))
    # The forest has seen nine tenths of these.
    assert np.corrcoef(made.oracle(made.visible.x), made.visible.y)[0, 1] > 0.8
    with pytest.raises(UserError, match="unknown form 'composit': did you mean composition"):
        problem("superconductor", path=small, form="composit")
    with pytest.raises(UserError, match="unknown oracle 'boost': did you mean boosting"):
        problem("superconductor", path=small, oracle="boost")


@pytest.mark.slow
@needs_sklearn
def test_ucis_files_are_read_too(tmp_path):
    rng = np.random.default_rng(0)
    names = [*elements(), "critical_temp", "material"]
    x = rng.random((60, 86))
    y = 100 * x[:, 3]
    rows = [",".join([*(f"{v:.4f}" for v in row), f"{t:.3f}", "X"]) for row, t in zip(x, y)]
    (tmp_path / "unique_m.csv").write_text("\n".join([",".join(names), *rows]) + "\n")
    made = problem("superconductor", path=tmp_path / "unique_m.csv", form="composition")
    assert len(made.visible) == 48
    names = [f"f{i}" for i in range(81)]
    rows = [",".join([*(f"{v:.4f}" for v in row[:81]), f"{t:.3f}"]) for row, t in zip(x, y)]
    (tmp_path / "train.csv").write_text("\n".join([",".join([*names, "critical_temp"]), *rows]) + "\n")
    made = problem("superconductor", path=tmp_path / "train.csv")
    assert made.visible.variables[80].name == "f80"


@needs_sklearn
def test_forests_and_boosted_trees_are_scikit_learns():
    from sklearn.ensemble import GradientBoostingRegressor, RandomForestRegressor

    from deadreckon.mbo.problems.trees import boosted, forest

    rng = np.random.default_rng(1)
    x = rng.standard_normal((300, 5)).astype(np.float32)
    y = x[:, 0] * x[:, 1] + np.abs(x[:, 2])
    found = forest("test", x, y, trees=7)
    order = np.random.default_rng(0).permutation(300)
    theirs = RandomForestRegressor(7, max_features=1 / 3, random_state=0).fit(x[order[30:]], y[order[30:]])
    fresh = rng.standard_normal((200, 5)).astype(np.float32)
    np.testing.assert_allclose(found(fresh), theirs.predict(fresh), rtol=1e-12)
    assert found.held_out == 30
    found = boosted("test", x, y, trees=9, depth=3)
    theirs = GradientBoostingRegressor(learning_rate=0.02, n_estimators=9, subsample=0.5, max_depth=3, random_state=0)
    theirs.fit(x[order[30:]], y[order[30:]])
    np.testing.assert_allclose(found(fresh), theirs.predict(fresh), rtol=1e-12)
    assert found.about.startswith("gradient boosting of 9 trees; rank correlation 0.")


def test_the_superconductors_of_2020_have_boosted_trees_and_no_bounds(tmp_path, monkeypatch):
    asked = []

    class Judge:
        about = "known"

        def __call__(self, x):
            return np.zeros(len(x))

    monkeypatch.setitem(ORACLES, "boosting", lambda name, x, y: asked.append((name, x.shape)) or Judge())
    (tmp_path / "few.csv").write_text("\n".join(["name,Tc", *(f"Ba{i}Cu{60 - i}O7,{i}" for i in range(1, 41))]) + "\n")
    made = problem("superconductor-boosting", path=tmp_path / "few.csv")
    assert (made.name, made.about, asked) == ("superconductor-boosting", "known", [("superconductor-statistics", (40, 81))])
    assert {(v.low, v.high) for v in made.visible.variables} == {(-np.inf, np.inf)}
    assert len(made.visible) == 32
    assert not made.score(made.visible.x[:3] + 1e6).true.any()  # far from all data


# ---- the others -----------------------------------------------------------------------------------------------------------


def test_tfbind8(real_data):
    made = problem("tfbind8", path=real_data / "tfbind8" / "tfbind8_six6.npz")
    assert (made.low, made.high, made.optimum) == (0.0, 1.0, 1.0)
    assert len(made.visible) == 32_898
    np.testing.assert_allclose(made.oracle(made.visible.x), made.visible.y, atol=1e-7)


@needs_sklearn
@needs_rdkit
def test_molecules(real_data, tmp_path):
    lines = (real_data / "molecules" / "CHEMBL234_Ki.csv").read_text().splitlines()
    small = tmp_path / "small.csv"
    small.write_text("\n".join(lines[:300]) + "\n")
    made = problem("molecule", path=small)
    assert made.visible.x.shape[1] == 1024
    assert set(np.unique(made.visible.x)) == {0.0, 1.0}
    assert made.visible.target == "y [pEC50/pKi]"  # more is better, not the nanomoles
    assert made.score(made.visible.x[:5]).true.shape == (5,)
    small.write_text("smiles,exp\nnot a molecule,1\n")
    with pytest.raises(UserError, match="row 0: 'not a molecule' is no molecule in SMILES"):
        problem("molecule", path=small)


@pytest.mark.slow
def test_gfp(real_data, tmp_path, monkeypatch):
    """A part of the proteins and a short training: the learned effects rank held-out proteins."""
    lines = (real_data / "gfp" / "avgfp.tsv").read_text().splitlines()
    small = tmp_path / "small.tsv"
    small.write_text("\n".join([lines[0], *lines[1::12]]) + "\n")
    monkeypatch.setattr(gfp_module, "STEPS", 300)
    monkeypatch.setattr(gfp_module, "BATCH", 64)
    monkeypatch.setattr(gfp_module, "MEMBERS", 1)
    made = problem("gfp", path=small)
    assert made.low < made.visible.y.min() < made.visible.y.max() < made.high
    assert made.visible.x.shape[1] == 237
    stops = sum("*" in line.split("\t")[0] for line in lines[1::12])
    assert stops > 0
    whole = problem("gfp", path=small, least=0, most=100, limit=None).visible
    assert len(whole) == len(lines[1::12]) - stops
    said = float(made.about.split("rank correlation ")[1].split()[0])
    assert said > 0.5
    # A substitution that nobody has measured changes nothing; one that was does.
    x = whole.x.astype(int)
    site = int(np.argmax(x.max(0) > x.min(0)))
    wild = gfp_module._WILD.astype(np.float32)[None]
    other, tried = wild.copy(), wild.copy()
    other[0, site] = np.setdiff1d(np.arange(20), x[:, site])[0]
    tried[0, site] = np.setdiff1d(x[:, site], wild[0, site])[0]
    assert made.oracle(other)[0] == made.oracle(wild)[0] != made.oracle(tried)[0]


def test_a_process_on_sequences_is_the_formula(home):
    """Predictions are m + k(x, X) (K + noise I)^-1 (y - m); far away they are the mean; what ranks held-out rows is told."""
    rng = np.random.default_rng(0)
    x = rng.integers(0, 3, (400, 6))
    y = (x == 1).sum(1) + 0.1 * rng.standard_normal(400)
    found = SequenceGP.of("test", x, y, rows=300)
    assert (found.rows.shape, found.held_out) == ((300, 6), 40)
    assert found.rank_correlation > 0.9
    order = np.random.default_rng(0).permutation(400)
    rows = order[40:340]
    np.testing.assert_array_equal(found.rows, x[rows])
    apart = (x[:, None] != x[None]).sum(-1)
    np.testing.assert_array_equal(differences(x, x), apart)
    covariance = np.exp(-apart / found.length)
    weights = np.linalg.solve(covariance[np.ix_(rows, rows)] + found.noise * np.eye(300), y[rows] - y[rows].mean())
    np.testing.assert_allclose(found(x), y[rows].mean() + covariance[:, rows] @ weights, atol=1e-4)
    far = SequenceGP(found.rows, found.weights, found.mean, 0.1, found.noise, 0.0, 0)
    np.testing.assert_allclose(far(np.full((1, 6), 9)), y[rows].mean(), atol=1e-6)


@pytest.mark.slow
def test_hopper_controllers_are_what_their_scores_say():
    """Designs are made again from the shipped scores, and the simulator gives them those scores."""
    made = dr.mbo.problem("hopper-controller")
    assert made.visible.x.shape == (3200, 5126)
    assert (made.visible.x[:, -hopper.UNUSED :] == 0).all()
    assert len(np.unique(made.visible.x, axis=0)) == 3200
    rows = np.argsort(made.visible.y)[[0, 400, 800, 1200]]
    np.testing.assert_allclose(made.oracle(made.visible.x[rows]), made.visible.y[rows], rtol=1e-4)


def test_a_controller_by_hand():
    """One that pushes no joint: the hopper sinks, and the return is that of zero actions."""
    x = np.zeros((2, hopper.SIZE), np.float32)
    x[1, -hopper.UNUSED - 3 : -hopper.UNUSED] = [5.0, -5.0, 0.25]  # biases of the last layer, clipped to +-1
    found = hopper.returns(x, threads=1)
    simulator = dr.tasks.task("hopper").simulate([hopper.START] * 2, 1)
    simulator.reset()
    total, alive = np.zeros(2), np.ones(2, bool)
    while alive.any():
        _, rewards, terminals, timeouts = simulator.step(np.array([[0, 0, 0], [1, -1, 0.25]], np.float32))
        total += rewards
        alive &= ~(terminals | timeouts)
    np.testing.assert_allclose(found, total, rtol=1e-6)
    assert hopper.SIZE == 5126


def test_other_random_numbers_are_noticed(monkeypatch):
    """The scores belong to designs that numpy's generator makes again; if it made others, they would be nobody's."""
    monkeypatch.setattr(hopper, "RATE", 0.03)
    with pytest.raises(UserError, match="draws other numbers than its designs were made of"):
        dr.mbo.problem("hopper-controller")
