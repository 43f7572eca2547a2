"""`deadreckon ope` from files to a decision card, and its one-line errors."""

import shutil

import numpy as np
import pytest

import deadreckon as dr
from deadreckon.agents.bc import BC
from deadreckon.cli.main import main
from deadreckon.cli.ope import usage, use
from deadreckon.data.formats.hdf5 import write_hdf5
from deadreckon.ope import ESTIMATORS, LinearFQE
from deadreckon.runs.train import train
from tests.ope.test_case import lqr

SMALL = ["--steps", "200", "--members", "2", "--hidden", "8"]


@pytest.fixture(scope="module")
def once(tmp_path_factory):
    """A log and a run of two policies."""
    folder = tmp_path_factory.mktemp("made")
    log = lqr(-0.5, 0.5, 40, 20)
    write_hdf5(log, folder / "log.hdf5")
    train(BC(hidden=(8,)), log, steps=50, seeds=2, out=folder / "bc")
    return folder


@pytest.fixture
def made(once, tmp_path):
    """The same in a folder of the test's own."""
    return shutil.copytree(once, tmp_path, dirs_exist_ok=True)


@pytest.mark.slow
def test_from_files_to_a_decision(made, capsys):
    common = ["ope", "--data", str(made / "log.hdf5"), "--policies", str(made / "bc"), "--discount", "0.9", *SMALL]
    assert main([*common, "--estimators", "fqe,is", "--select", "--out", str(made / "ope")]) == 0
    out = capsys.readouterr().out
    assert "evaluated on: 8 held-out episodes of 40\n" in out
    asked = "expected discounted return (discount 0.9) of the first 20 steps of an episode; sampled actions; 95 % intervals"
    assert f"fqe (FQE-L2), model-based: {asked}" in out
    assert f"is (WPDIS): {asked}" in out
    assert "bc seed 1" in out
    assert "behaviour policy" in out
    assert "effective sample size" in out
    assert "share of each policy's actions without support in the log" in out
    assert "DO NOT DEPLOY: bc seed" in out
    assert "model-based only" in out
    # Given again, it takes up what is there, and is the same look at these episodes.
    assert main([*common, "--estimators", "fqe,is", "--select", "--out", str(made / "ope")]) == 0
    again = capsys.readouterr().out
    assert again == out


@pytest.mark.slow
def test_options_of_what_is_estimated(made, capsys, monkeypatch):
    """A horizon, clusters that are no column, and who says that the policies are new to the log."""
    words = ESTIMATORS["fqe-linear"][1]
    monkeypatch.setitem(ESTIMATORS, "fqe-linear", (lambda: LinearFQE(fourier_features=16, n_bootstrap=20), words))
    common = ["ope", "--data", str(made / "log.hdf5"), "--policies", str(made / "bc"), "--estimators", "fqe-linear"]
    common += ["--steps", "50", "--hidden", "8"]
    assert main([*common, "--horizon", "5", "--discount", "1", "--unseen", "--accept-model-based"]) == 0
    out = capsys.readouterr().out
    # Its file records the others.
    assert "evaluated on: 8 episodes on which no policy was trained, according to --unseen" in out
    assert "FQE-linear, model-based: expected return of the first 5 steps of an episode; sampled actions" in out
    assert "DEPLOY" not in out  # nobody asked for a decision
    assert main([*common, "--cluster", "user"]) == 2
    assert "user" in capsys.readouterr().err


def test_what_is_deployed_is_used_as_it_was_judged(made):
    """The call that is printed is one that works on that file."""
    file = str(made / "bc" / "policies" / "seed0.npz")
    plain = f"deadreckon.policies.portable.load({file!r})(observations"
    assert use({"file": file}, [], True) == f"{plain})"
    assert use({"file": file}, [], False) == f"{plain}, rng, greedy=False)"
    assert use({"file": "dope.pkl"}, [], True) == "deadreckon.policies.load_dope('dope.pkl')(observations)"
    assert use({"file": None, "run": "hopper snapshot-01", "seed": None}, ["hopper"], True) is None
    results = {"policies": [{"name": "a", "file": "dope.pkl"}, {"name": "b", "file": file}], "estimand": {"greedy": False}}
    assert usage(results | {"choice": {"name": "b", "deploy": True}}, []) == f"  use it: {plain}, rng, greedy=False)\n"
    assert usage(results | {"choice": {"name": None, "deploy": False}, "estimand": None}, []) == ""


@pytest.mark.slow
def test_a_policy_of_a_table_is_used_by_predict(tmp_path):
    frame = {"x": np.arange(30.0), "action": ["mail", "call", "none"] * 10, "reward": np.arange(30.0)}
    log = dr.Dataset.from_frame(frame, action="action", reward="reward")
    run = dr.train(dr.agents.BC(hidden=(4,), batch_size=8), log, steps=2, task=False, out=tmp_path / "a run")
    file = str(run.path / "policies" / "seed0.npz")
    command, call = use({"file": file}, [], False).split(", in Python ")
    assert command == f"deadreckon predict '{file}' TABLE --out actions.csv --sampled True"
    assert call == f"deadreckon.load_policy({file!r}).predict(rows, greedy=False)"
    assert set(eval(call, {"deadreckon": dr, "rows": {"x": [1.0, 2.0]}})) <= {"mail", "call", "none"}


@pytest.mark.slow
def test_episodes_are_counted_among_those_that_nobody_learned_from(made, capsys):
    common = ["ope", "--data", str(made / "log.hdf5"), "--policies", str(made / "bc"), "--estimators", "fqe", *SMALL]
    assert main([*common, "--episodes", "3"]) == 0
    assert "evaluated on: 3 episodes on which no policy was trained" in capsys.readouterr().out


def test_list(capsys):
    assert main(["ope", "--list"]) == 0
    out = capsys.readouterr().out
    assert "magic" in out
    assert "Zhang et al. 2021" in out


@pytest.mark.slow
def test_bad_input_in_one_line(made, capsys):
    data, policies = ["--data", str(made / "log.hdf5")], ["--policies", str(made / "bc")]
    for args, words in [
        ([*data, *policies, "--estimators", "fqa"], "unknown estimator 'fqa'"),
        ([*data, *policies, "--estimators", "auto"], "sizes are set for estimators that are named"),
        ([*data, *policies, "--episodes", "99"], "--episodes must be 1 .. 40"),
        ([*data, "--policies", "hoper"], "there are no policies of 'hoper'"),
        ([*data, "--policies", str(made / "none.npz")], "no file"),
        ([*data, *policies, "--discount", "1.5"], "discount must be in [0, 1], got 1.5"),
        ([*data, *policies, "--horizon", "0"], "horizon must be a number of steps, 1 or more, got 0"),
        (["--policies", "hopper"], "--data"),
    ]:
        assert main(["ope", *([] if "--estimators" in args else ["--estimators", "fqe"]), *args, *SMALL]) == 2
        err = capsys.readouterr().err
        assert words in err
        assert len([line for line in err.splitlines() if line.startswith("deadreckon: ")]) == 1


@pytest.mark.slow
def test_bench_on_a_short_log(tmp_path, capsys):
    options = ["--kinds", "random", "--log-steps", "600", "--out", str(tmp_path / "dope"), *SMALL]
    assert main(["ope", "bench", "--tasks", "hopper", "--estimators", "fqe,is", *options]) == 0
    out = capsys.readouterr().out
    assert "| hopper-random-v2@dr1-600-steps |" in out
    assert out.count("| median |") == 4  # three metrics, and absolute error in returns
    numbers = [float(x) for x in out.split("| median |")[1].splitlines()[0].split("|")[:2]]
    assert np.isfinite(numbers).all()
    page = (tmp_path / "dope" / "report.html").read_text()
    assert out.rstrip().endswith("report.html")
    for said in ("Rank correlation", "hopper-random-v2@dr1-600-steps", "estimate against true value", "WPDIS", "FQE-L2"):
        assert said in page


def test_bench_takes_logs_of_tasks_with_policies_alone(tmp_path, capsys):
    assert main(["ope", "bench", "--logs", "maze2d-umaze-dense-v1,kitchen-mixed-v0", "--out", str(tmp_path)]) == 2
    assert "there are no policies of 'kitchen-mixed'" in capsys.readouterr().err
    assert main(["ope", "bench", "--logs", "maze2d-umaze-dens-v1", "--out", str(tmp_path)]) == 2
    assert "did you mean maze2d-umaze-dense-v1" in capsys.readouterr().err


@pytest.mark.slow
def test_bench_on_a_log_by_its_name(tmp_path, capsys):
    options = ["--log-steps", "600", "--estimators", "fqe", "--out", str(tmp_path / "dope"), *SMALL]
    assert main(["ope", "bench", "--logs", "maze2d-umaze-dense-v1", *options]) == 0
    assert "| maze2d-umaze-dense-v1@dr1-600-steps |" in capsys.readouterr().out


@pytest.mark.slow
def test_bench_on_what_people_did(tmp_path, capsys, home, real_data):
    place = home / "data" / "adroit"
    place.mkdir(parents=True)
    shutil.copy(real_data / "adroit" / "door-v0_demos.pickle", place)
    options = ["--log-steps", "600", "--estimators", "fqe", "--out", str(tmp_path / "dope"), *SMALL]
    assert main(["ope", "bench", "--logs", "door-human-v1", *options]) == 0
    out = capsys.readouterr().out
    assert "| door-human-v1@dr1-600-steps |" in out
