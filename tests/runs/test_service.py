"""The HTTP service answers rows with named actions and everything else with one line, without a network."""

import asyncio
import json
import threading

import numpy as np
import pandas as pd
import pytest

import deadreckon as dr
from deadreckon.policies import store
from deadreckon.runs import service as services
from deadreckon.runs.player import chosen, predictor
from deadreckon.runs.service import Limits, Service, app
from deadreckon.runs.train import train
from tests.asked import ask, post

ROWS = 40
NETS = {"hidden": (8,), "batch_size": 8}


def table(seed=0):
    rng = np.random.default_rng(seed)
    return pd.DataFrame({
        "age": np.where(rng.random(ROWS) < 0.2, np.nan, rng.integers(18, 80, ROWS)),
        "plan": rng.choice(["a", "b", "<b>"], ROWS), "member": rng.random(ROWS) < 0.5,
        "offer": rng.choice(["call", "mail", "none"], ROWS), "paid": rng.normal(size=ROWS),
    })  # fmt: skip


def rows(frame):
    return json.loads(frame.to_json(orient="records"))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    log = dr.Dataset.from_frame(table(), action="offer", reward="paid")
    return train(dr.agents.BC(**NETS), log, out=tmp_path_factory.mktemp("run") / "run", steps=3, task=False)


@pytest.fixture(scope="module")
def service(run):
    found = chosen(run.path)
    return app(Service(predictor(found.file), found.words, Limits(body=20_000, rows=100)))


def test_rows_get_the_actions_that_predict_gives(service, run):
    new = table(1)
    want = run.predict(new, probabilities=True, outside="flag")
    assert post(service, rows(new)) == (200, {"actions": [{"offer": action} for action in want.actions]})
    assert post(service, rows(new)[3]) == (200, {"action": {"offer": want.actions[3]}})
    status, told = post(service, rows(new), "probabilities=true&outside=flag")
    assert status == 200
    assert told["outside"] == want.outside.tolist()
    for row in range(ROWS):
        assert list(told["probabilities"][row]) == ["call", "mail", "none"]
        expected = [want.probabilities[key][row] for key in told["probabilities"][row]]
        np.testing.assert_allclose(list(told["probabilities"][row].values()), expected, atol=1e-6)
    assert list(post(service, rows(new)[0], "probabilities=true&outside=flag")[1]) == ["action", "probabilities", "outside"]


def test_a_flat_list_of_numbers_is_one_encoded_row(service, run):
    size = next(iter(store.meta(chosen(run.path).file)["log"]["observation_shape"]))
    status, told = post(service, [0.0] * size)
    assert status == 200
    assert told["action"]["offer"] in ("call", "mail", "none")
    assert post(service, [0.0] * (size + 1))[0] == 422


def test_sampled_actions_differ_from_request_to_request_unless_a_seed_is_named(service, run):
    one = rows(table(1))[0]
    drawing = app(Service(predictor(chosen(run.path).file), "a policy", seed=0))
    assert len({post(drawing, one, "greedy=false")[1]["action"]["offer"] for _ in range(40)}) > 1
    assert len({post(service, one, "greedy=false&seed=3")[1]["action"]["offer"] for _ in range(5)}) == 1


def test_a_service_of_sampled_actions(run):
    policy = predictor(chosen(run.path).file)
    found = app(Service(policy, "a policy", seed=0, sampled=True))
    one = rows(table(1))[0]
    assert len({post(found, one)[1]["action"]["offer"] for _ in range(40)}) > 1
    assert len({post(found, one, "greedy=true")[1]["action"]["offer"] for _ in range(5)}) == 1
    # Compared by the generators' states: actions of services without a seed would be equal now and then.
    first, second = (Service(policy, "a policy").rng.bit_generator.state for _ in range(2))
    assert first != second


GOOD = {"age": 30, "plan": "a", "member": True}
WRONG = {
    "no JSON": (b"age=30", "", 400, "the body is not JSON: Expecting value"),
    "empty": (b"", "", 400, "the body is not JSON"),
    "NaN": (b'{"age": NaN}', "", 400, "NaN is not a number of JSON; use null for a missing value"),
    "no UTF-8": (b'{"age": "\xff"}', "", 400, "the body is not JSON"),
    "half": (b'[{"age": 30', "", 400, "the body is not JSON"),
    "deep": (b"[" * 15_000, "", 400, "nested too deeply"),
    "thousands of digits": (b'{"age": ' + b"9" * 9_000 + b"}", "", 400, "the body is not JSON"),
    "a number": (3, "", 422, "the body must be a row {column: value}, or a list of rows"),
    "no row": ([], "", 422, "the list of rows is empty"),
    "a list of numbers": ([1, 2], "", 422, "observations must have the shape"),
    "mixed": ([GOOD, 3], "", 422, "row 1 is of type int, a dictionary of columns is needed"),
    "a column too few": ({"age": 30, "plan": "a"}, "", 422, "no column member"),
    "a level": ({**GOOD, "plan": "c"}, "", 422, "column plan has 'c' in row 0, which is none of its levels"),
    "a text": ({**GOOD, "age": "old"}, "", 422, "column age has 'old' in row 0, a number is needed"),
    "infinite": (b'{"age": 1e999, "plan": "a", "member": true}', "", 422, "column age has inf in row 0, a finite number"),
    "a nested value": ({**GOOD, "age": {"a": 1}}, "", 422, "column age has {'a': 1} in row 0, a number is needed"),
    "a list in a row": ({**GOOD, "age": [1, 2]}, "", 422, "column age has [1, 2] in row 0, a number is needed"),
    "columns": ({"age": [1, 2], "plan": ["a", "b"], "member": [True, False]}, "", 422, "column age has [1, 2] in row 0"),
    "many rows": ([GOOD] * 101, "", 413, "101 rows are too many for a request; at most 100 are taken"),
    "an option": (GOOD, "probability=1", 422, "unknown option 'probability': did you mean probabilities?"),
    "an option's value": (GOOD, "greedy=maybe", 422, "greedy must be true or false, got 'maybe'"),
    "a seed": (GOOD, "seed=-1", 422, "seed must be a whole number from 0 to 999999999999999, got '-1'"),
    "outside": (GOOD, "outside=keep", 422, "outside must be raise or flag, got 'keep'"),
}  # fmt: skip


@pytest.mark.parametrize("case", WRONG)
def test_what_is_refused_in_one_line(service, case):
    value, query, status, words = WRONG[case]
    found, told = post(service, value, query)
    assert (found, list(told)) == (status, ["error"])
    assert words in told["error"]
    assert "\n" not in told["error"]
    assert "Traceback" not in told["error"]
    assert post(service, GOOD)[0] == 200


def test_large_bodies_are_refused_before_they_are_whole(service):
    read = []

    def parts():
        for _ in range(1_000):
            read.append(1)
            yield b" " * 1_000

    status, told = post(service, None, parts=list(parts()))
    assert (status, told) == (413, {"error": "the body is larger than 20,000 bytes"})
    status, headers, _ = ask(service, "POST", "/predict", b"{}", headers=[(b"content-length", b"20001")])
    assert (status, headers["connection"]) == (413, "close")


def test_slow_bodies_are_given_up(service, monkeypatch):
    monkeypatch.setattr(services, "SLOWEST", 0.05)
    said = []

    async def receive():
        await asyncio.sleep(5)

    async def send(message):
        said.append(message)

    scope = {"type": "http", "method": "POST", "path": "/predict", "query_string": b"", "headers": [], "http_version": "1.1"}
    asyncio.run(service(scope, receive, send))
    assert said[0]["status"] == 408
    assert json.loads(said[1]["body"]) == {"error": "the body has not arrived within 0.05 seconds"}


def test_other_pages_are_answered_while_actions_are_computed(run):
    """One request after the other: each may need much memory."""
    begun, let, at_work, most = threading.Event(), threading.Event(), [], []

    class Slow(Service):
        def predict(self, body, query):
            at_work.append(1)
            most.append(len(at_work))
            begun.set()
            assert let.wait(20)
            at_work.pop()
            return {}

    found = app(Slow(predictor(chosen(run.path).file), "a policy"))

    async def ask_all():
        async def one(method, path):
            said = []
            sent = iter([{"type": "http.request", "body": b"{}".ljust(services.SHORT + 1)}])

            async def receive():
                return next(sent)

            async def send(message):
                said.append(message)

            await found({"type": "http", "method": method, "path": path, "query_string": b"", "headers": [],
                         "http_version": "1.1"}, receive, send)  # fmt: skip
            return said[0]["status"]

        first, second = (asyncio.ensure_future(one("POST", "/predict")) for _ in range(2))
        await asyncio.get_running_loop().run_in_executor(None, begun.wait, 20)
        health = await asyncio.wait_for(one("GET", "/health"), 20)
        let.set()
        return health, await first, await second

    assert asyncio.run(ask_all()) == (200, 200, 200)
    assert most == [1, 1]


def test_pages(service, run):
    get = lambda path: ask(service, "GET", path)  # noqa: E731
    assert json.loads(get("/health")[2]) == {"status": "ok", "policy": f"seed 0 of {run.path}", "version": dr.__version__}
    told = json.loads(get("/schema")[2])
    assert told["observations"]["plan"] == {"kind": "category", "levels": ["<b>", "a", "b"], "may_be_missing": False}
    assert told["observations"]["age"]["may_be_missing"]
    assert told["actions"] == {"offer": {"kind": "discrete", "levels": ["call", "mail", "none"]}}
    document = json.loads(get("/openapi.json")[2])
    predict = document["paths"]["/predict"]["post"]
    row = predict["requestBody"]["content"]["application/json"]["schema"]["oneOf"][0]
    assert row["required"] == ["age", "plan", "member"]
    assert row["properties"]["age"]["type"] == ["number", "null"]
    assert row["properties"]["plan"] == {"enum": ["<b>", "a", "b"]}
    assert post(service, predict["requestBody"]["content"]["application/json"]["example"])[0] == 200
    status, headers, page = get("/docs")
    assert (status, headers["content-type"]) == (200, "text/html; charset=utf-8")
    assert b"&lt;b&gt;" in page
    assert b"<b>" not in page
    assert b"<script" not in page
    assert b"http://HOST" in page  # of the example; nothing is loaded
    assert b"src=" not in page
    assert get("/")[1]["location"] == "/docs"
    status, _, body = get("/predict")
    assert (status, json.loads(body)) == (405, {"error": "this method is not for this page"})
    status, _, body = get("/etc/passwd")
    assert status == 404
    assert "no such page; the pages are /predict, /health, /schema, /openapi.json and /docs" in json.loads(body)["error"]


def test_a_mistake_of_ours_is_told_without_a_trace(run, monkeypatch):
    found = Service(predictor(chosen(run.path).file), "a policy")
    monkeypatch.setattr(found.policy, "predict", lambda rows, **options: 1 / 0)
    said = []

    async def receive():
        return {"type": "http.request", "body": b"{}", "more_body": False}

    async def send(message):
        said.append(message)

    scope = {"type": "http", "method": "POST", "path": "/predict", "query_string": b"", "headers": [], "http_version": "1.1"}
    with pytest.raises(ZeroDivisionError):  # which the server writes to its log
        asyncio.run(app(found)(scope, receive, send))
    assert said[0]["status"] == 500
    assert json.loads(said[1]["body"]) == {"error": "internal error; the log of the service has the cause"}


def test_several_actions_arrays_and_histories(tmp_path):
    frame = table().assign(valve=np.linspace(0, 1, ROWS), fan=np.linspace(10, 90, ROWS), day=np.arange(ROWS) // 4)
    frame = frame.drop(columns=["offer", "age"])
    log = dr.Dataset.from_frame(frame, action=["valve", "fan"], reward="paid", episode="day")
    run = train(dr.agents.BC(**NETS), log, out=tmp_path / "run", steps=3, task=False, history=2)
    found = app(Service(predictor(chosen(run.path).file), "a policy"))
    status, told = post(found, rows(frame))
    want = run.predict(frame)
    assert status == 200
    np.testing.assert_allclose([row["fan"] for row in told["actions"]], want["fan"], rtol=1e-4)
    one = {key: value for key, value in rows(frame)[0].items() if key != "day"}
    assert "acts on the last 2 steps of an episode: give the column day" in post(found, one)[1]["error"]
    document = json.loads(ask(found, "GET", "/openapi.json")[2])
    example = document["paths"]["/predict"]["post"]["requestBody"]["content"]["application/json"]["example"]
    assert post(found, example)[0] == 200
    cross = dr.cross_fit(dr.agents.BC(**NETS), log, out=tmp_path / "cross", steps=3, folds=2, task=False)
    found = app(Service(predictor(chosen(cross.path).file), "a mixture"))
    predict = json.loads(ask(found, "GET", "/openapi.json")[2])["paths"]["/predict"]["post"]
    body = predict["requestBody"]["content"]["application/json"]
    assert "day" in body["schema"]["oneOf"][0]["required"]
    assert post(found, body["example"])[0] == 200
    log = dr.Dataset.from_arrays(observations=np.eye(20, 3), actions=np.arange(20) % 2, rewards=np.zeros(20))
    run = train(dr.agents.BC(**NETS), log, out=tmp_path / "arrays", steps=3, task=False)
    found = app(Service(predictor(chosen(run.path).file), "a policy"))
    assert post(found, [[1, 0, 0], [0, 0, 1]])[1] == {"actions": [{"action": int(a)} for a in run.policy(np.eye(3)[[0, 2]])]}
    assert post(found, [1, 0, 0])[1] == {"action": {"action": int(run.policy(np.eye(3)[0]))}}
    for wrong in ([["a"]], [[1, 0, 0], [1]], [1, [2]], ["a"], [[{}]], {"x": 1}):
        assert post(found, wrong)[0] == 422
