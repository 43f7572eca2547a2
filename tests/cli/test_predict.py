"""`deadreckon predict`: tables in, named actions out, whatever a file's cells look like."""

import csv
import re
import shutil
import sqlite3

import numpy as np
import pandas as pd
import pytest
from pyarrow import parquet

import deadreckon as dr
from deadreckon.cli.main import main
from deadreckon.data.describe import describe_table
from deadreckon.data.formats.any_table import read_rows
from deadreckon.data.schema import Column, Schema
from deadreckon.files import write_json
from deadreckon.runs import player
from deadreckon.runs.decision_record import saved_at
from deadreckon.runs.train import train
from tests.recorded import decision

ROWS = 40


def table(seed=0):
    rng = np.random.default_rng(seed)
    return pd.DataFrame({
        "age": np.where(rng.random(ROWS) < 0.2, np.nan, rng.integers(18, 80, ROWS)),
        "plan": rng.choice(["free", "no", "yes"], ROWS),
        "zip": rng.choice(["0120", "0450", "A"], ROWS), "member": rng.choice(["ja", "nein"], ROWS),
        "open": rng.choice(["on", "off"], ROWS), "offer": rng.choice(["call", "mail", "none"], ROWS),
        "paid": rng.normal(size=ROWS),
    })  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("offers")
    table().to_csv(folder / "offers.csv", index=False)
    log = dr.read(folder / "offers.csv", action="offer", reward="paid")
    agent = dr.agents.BC(hidden=(8,), batch_size=8)
    return train(agent, log, out=folder / "run", steps=3, seeds=2, task=False), log


def predicted(run, frame, tmp_path, *words, out="actions.csv", **how):
    frame.to_csv(tmp_path / "new.csv", index=False, **how)
    code = main(["predict", str(run.path), str(tmp_path / "new.csv"), "--out", str(tmp_path / out), *words])
    return code, tmp_path / out


@pytest.mark.slow
def test_actions_of_a_file(run, tmp_path, capsys):
    run, log = run
    code, out = predicted(run, table(), tmp_path)
    assert code == 0
    assert pd.read_csv(out)["offer"].tolist() == run.predictor(0).encoder.named(run.policies[0](log.observations)).tolist()
    assert capsys.readouterr().out == f"seed 0 of {run.path}, one of 2 (--policy-seed): actions in 40 rows, in {out}\n"


def test_rows_beyond_the_log_are_told(run, tmp_path, capsys):
    """Also where nothing refuses them, such as 20.125 that is read as 20125."""
    run, new = run[0], table()
    new.loc[[5, 7], "age"] = new["age"].max() + 1
    assert predicted(run, new, tmp_path)[0] == 0
    assert "! 2 of 40 rows, from row 5 on, hold values beyond those of the log; --outside flag marks" in capsys.readouterr().err
    assert predicted(run, table(), tmp_path)[0] == 0
    assert "beyond" not in capsys.readouterr().err


@pytest.mark.parametrize("rows", [[0], [3, 5], list(range(10))])
def test_a_file_of_a_few_rows_is_read_as_the_log_was(run, tmp_path, rows):
    """Texts such as 0120, yes or on, which alone look like numbers and truth values; another dialect and order of columns."""
    run, log = run
    part = table().iloc[rows][["zip", "open", "member", "age", "plan"]]
    want = run.predictor(0).encoder.named(run.policies[0](log.observations[rows])).tolist()
    for how in ({}, {"sep": ";", "decimal": ","}):
        code, out = predicted(run, part, tmp_path, "--outside", "flag", **how)
        assert code == 0
        found = pd.read_csv(out)
        assert found["offer"].tolist() == want
        assert not found["outside_the_log"].any()


def test_what_is_written_beside_the_actions(run, tmp_path):
    run, log = run
    new = table(1).assign(id=np.arange(ROWS))
    new.loc[3, "plan"] = "gold"
    words = ("--probabilities", "--sampled", "True", "--seed", "5", "--outside", "flag", "--keep", "id", "--policy-seed", "1")
    code, out = predicted(run, new, tmp_path, *words, out="actions.parquet")
    assert code == 0
    found = parquet.read_table(out).to_pandas()
    assert list(found) == ["id", "offer", "probability=call", "probability=mail", "probability=none", "outside_the_log"]
    assert found["id"].tolist() == list(range(ROWS))
    assert found["outside_the_log"][3]
    done = run.predictor(1).predict(new.replace({"ja": True, "nein": False, "on": True, "off": False}), greedy=False, seed=5,
                                    outside="flag")  # fmt: skip
    assert found["offer"].tolist() == done.actions.tolist()
    kept = {"day": [f"{1 + i % 28:02d}.06.2024" for i in range(ROWS)], "code": [f"{i:03d}" for i in range(ROWS)],
            "rate": [f"{i}.50" for i in range(ROWS)], "ok": ["yes", "no"] * (ROWS // 2)}  # fmt: skip
    for out in ("kept.csv", "kept.parquet"):
        assert predicted(run, new.assign(plan="free", **kept), tmp_path, "--keep", *kept, out=out)[0] == 0
        found = pd.read_csv(tmp_path / out, dtype=str) if out.endswith("csv") else pd.read_parquet(tmp_path / out)
        assert {key: found[key].tolist() for key in kept} == kept


def test_tables_in_another_dialect_than_the_schemas_log(tmp_path, capsys):
    table().to_csv(tmp_path / "log.csv", index=False)
    schema = describe_table(tmp_path / "log.csv", action="offer", reward="paid")[0]
    schema.save(tmp_path / "log.toml")
    agent = dr.agents.BC(hidden=(8,), batch_size=8)
    made = train(agent, dr.read(tmp_path / "log.toml"), out=tmp_path / "run", steps=3, task=False)
    how = {"sep": ";", "decimal": ","}
    assert predicted(made, table().assign(age=30.5).drop(columns="paid"), tmp_path, **how)[0] == 0  # one comma in every line
    told = capsys.readouterr().err
    assert "! columns are separated by semicolons, and in the log of the schema by commas, so marks of numbers are" in told
    assert predicted(made, table(), tmp_path, "--separator", ";", "--decimal", "comma", **how)[0] == 0
    # The file of a schema stands for the table that it names.
    first = pd.read_csv(tmp_path / "actions.csv")
    assert main(["predict", str(made.path), str(tmp_path / "log.toml"), "--out", str(tmp_path / "again.csv")]) == 0
    assert pd.read_csv(tmp_path / "again.csv").equals(first)
    before = (tmp_path / "log.csv").read_bytes()
    assert main(["predict", str(made.path), str(tmp_path / "log.toml"), "--out", str(tmp_path / "log.csv")]) == 2
    assert "is the table itself; choose another name" in capsys.readouterr().err
    assert (tmp_path / "log.csv").read_bytes() == before


def test_what_is_refused_and_leaves_no_file(run, tmp_path, capsys):
    run, log = run
    cases = [
        (table().replace({"plan": {"free": "gratis"}}), (), "new.csv: column plan has 'gratis' in row"),
        (table().drop(columns="age"), (), "new.csv: no column age"),
        (table().assign(age="old"), (), "column age has 'old' in row 0, a number is needed"),
        (table(), ("--keep", "ag"), "--keep: unknown column 'ag': did you mean age"),
        (table(), ("--keep", "offer"), "--keep offer: the actions are written under this name"),
        (table(), ("--policy-seed", "3"), "has no policy of seed 3; its seeds are 0, 1"),
        (table(), ("--out", str(tmp_path / "a.txt")), "a.txt: actions are written as .csv or .parquet"),
        (table(), ("--out", str(tmp_path / "new.csv")), "new.csv is the table itself"),
    ]
    for frame, words, said in cases:
        code, out = predicted(run, frame, tmp_path, *words)
        assert (code, out.exists()) == (2, False), said
        assert said in capsys.readouterr().err


def test_policies_that_a_folder_stands_for(run, tmp_path, capsys):
    """The policy to deploy of a folder of estimates, and none where the decision is to deploy none."""
    run, log = run
    table().to_csv(tmp_path / "new.csv", index=False)
    choice = {"name": "bc seed 1", "deploy": True, "reason": "it is better"}
    policies = [{"name": f"bc seed {seed}", "file": str(run.path / "policies" / f"seed{seed}.npz")} for seed in (0, 1)]
    told = decision(policies, choice=choice, estimand={"greedy": False})
    words = ["predict", str(tmp_path), str(tmp_path / "new.csv"), "--out", str(tmp_path / "a.csv")]
    write_json(tmp_path / "estimates.json", told)
    assert main(words) == 0  # as it was judged
    said = capsys.readouterr()
    assert said.err == ""
    drawn = (tmp_path / "a.csv").read_text()
    seed = re.search(r"actions in 40 rows, drawn by the seed (\d+), in ", said.out)[1]
    assert main([*words, "--sampled", "True", "--seed", seed]) == 0
    assert (tmp_path / "a.csv").read_text() == drawn
    assert main(words) == 0
    assert (tmp_path / "a.csv").read_text() != drawn  # by another seed each time
    assert capsys.readouterr().err == ""
    assert main([*words, "--sampled", "False"]) == 0
    said = capsys.readouterr()
    assert f"! {tmp_path} evaluated sampled actions of this policy, but these are deterministic (greedy)" in said.err
    assert f"bc seed 1, the policy to deploy by {tmp_path}: actions in 40 rows" in said.out
    assert (tmp_path / "a.csv").read_text() != drawn
    want = run.predictor(1).encoder.named(run.policies[1](log.observations)).tolist()
    assert pd.read_csv(tmp_path / "a.csv")["offer"].tolist() == want
    write_json(tmp_path / "estimates.json", told | {"choice": told["choice"] | {"deploy": False}})
    assert main(words) == 2
    assert "the decision is to deploy none of its policies: it is better; name a run" in capsys.readouterr().err
    assert main([*words, "--policy-seed", "1"]) == 2
    assert "is no run, so it has no seeds" in capsys.readouterr().err
    (tmp_path / "estimates.json").unlink()
    assert main(words) == 2
    assert "is a folder without a run, a cross-fit or estimates" in capsys.readouterr().err
    assert main(["predict", str(tmp_path / "new.csv"), *words[2:]]) == 2
    assert "is another file than a policy's" in capsys.readouterr().err


def test_a_run_whose_sampled_actions_were_evaluated_beside_it_is_not_used_greedily_without_a_word(run, tmp_path, capsys):
    run, _ = run
    table().to_csv(tmp_path / "new.csv", index=False)
    shutil.copytree(run.path, tmp_path / "offers")
    (tmp_path / "offers-ope").mkdir()
    policies = [{"name": "bc seed 0"} | saved_at(tmp_path / "offers" / "policies" / "seed0.npz", tmp_path / "offers-ope")]
    results = [{"value": [1.0, 0.0], "low": [0.9, -0.1], "high": [1.1, 0.1], "gain": [[1.0, 0.8, 1.2], [0.0, 0.0, 0.0]]}]
    told = decision(policies, results, estimand={"greedy": False})
    write_json(tmp_path / "offers-ope" / "estimates.json", told)
    words = ["predict", str(tmp_path / "offers"), str(tmp_path / "new.csv"), "--out", str(tmp_path / "a.csv")]
    said = f"! {tmp_path / 'offers-ope'} evaluated sampled actions of this policy, but these are deterministic (greedy)"
    for more, doubted in (((), True), (("--sampled", "True"), False), (("--policy-seed", "1"), False)):
        assert main([*words, *more]) == 0
        assert (said in capsys.readouterr().err) == doubted
    write_json(tmp_path / "offers-ope" / "estimates.json", told | {"estimand": told["estimand"] | {"greedy": True}})
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "estimates.json").write_text("{")  # of something else, and damaged
    assert main(words) == 0
    assert capsys.readouterr().err == ""
    assert main([*words, "--sampled", "True"]) == 0
    assert "evaluated deterministic (greedy) actions of this policy, but these are sampled" in capsys.readouterr().err
    file = tmp_path / "offers" / "policies" / "seed0.npz"
    assert main(["predict", str(file), *words[2:], "--sampled", "True"]) == 0
    assert "but these are sampled" in capsys.readouterr().err
    assert not player._draws({"inner": {"kind": "Mixture", "members": [{"inner": {"kind": "Deterministic"}}]}})


@pytest.mark.slow
def test_a_policy_without_a_schema(tmp_path, capsys):
    log = dr.Dataset.from_arrays(observations=np.zeros((20, 3)), actions=np.zeros((20, 2)), rewards=np.zeros(20))
    run = train(dr.agents.BC(hidden=(8,), batch_size=8), log, out=tmp_path / "run", steps=3, task=False)
    with open(tmp_path / "new.csv", "w", newline="") as file:
        csv.writer(file).writerows([["x"], [1.0]])
    assert main(["predict", str(run.path), str(tmp_path / "new.csv"), "--out", str(tmp_path / "a.csv")]) == 2
    assert "has no schema of its log: it was trained on arrays, on images, in a simulator, on a t" in capsys.readouterr().err


def test_kept_columns_are_of_the_rows_that_were_predicted(run, tmp_path):
    """A database may give its rows in another order each time it is asked."""
    rows = pd.concat([table(seed) for seed in range(5)], ignore_index=True)
    with sqlite3.connect(tmp_path / "new.db") as base:
        code = np.arange(len(rows))
        rows.assign(id=[f"{i:04d}" for i in code], code=code, age=code % 60 + 18).to_sql("t", base, index=False)
    words = ["--query", "select * from t order by random()", "--keep", "id", "code", "age", "--out", str(tmp_path / "out.csv")]
    assert main(["predict", str(run[0].path), str(tmp_path / "new.db"), "--outside", "flag", *words]) == 0
    found = pd.read_csv(tmp_path / "out.csv", dtype={"id": str})
    assert sorted(found["code"]) == list(range(len(rows)))
    assert found["id"].tolist() == [f"{code:04d}" for code in found["code"]]
    assert found["age"].tolist() == [code % 60 + 18 for code in found["code"]]


def test_a_name_with_a_comma_is_not_taken_for_a_wrong_separator(run, tmp_path, capsys):
    table().rename(columns={"age": "weight, kg"}).to_csv(tmp_path / "log.csv", index=False, sep=";")
    made = train(dr.agents.BC(hidden=(8,), batch_size=8), dr.read(tmp_path / "log.csv", action="offer", reward="paid"),
                 out=tmp_path / "run", steps=3, task=False)  # fmt: skip
    assert predicted(made, pd.DataFrame({"foo": [1], "height, cm": [2]}), tmp_path, sep=";")[0] == 2
    told = capsys.readouterr().err
    assert "no column weight, kg" in told
    assert "seems to have" not in told


def test_columns_are_read_alike_whether_they_are_kept_or_not(tmp_path):
    names = {"id": ["1234567890123456789", "1234567890123456788"], "x": ["inf", "-1"], "empty": ["", ""],
             "day": ["2020-01-01"] * 2, "time": ["10:00", "11:00"], "hex": ["0x1F", "0x2F"], "age": ["+5", "6"]}  # fmt: skip
    pd.DataFrame(names).to_csv(tmp_path / "t.csv", index=False)
    schema = Schema((Column("age", "observation", "number"),))
    plain = dict.fromkeys(names)
    with_texts = read_rows(tmp_path / "t.csv", schema, plain=plain)[0]
    assert with_texts.equals(read_rows(tmp_path / "t.csv", schema)[0])
    assert {name: [text or "" for text in values.to_pylist()] for name, values in plain.items()} == names
