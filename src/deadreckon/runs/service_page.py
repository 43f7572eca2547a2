"""The description of a service: the columns that it takes, as JSON, as an OpenAPI document and as a page without scripts."""

import html
import json
from typing import TYPE_CHECKING, Any

from deadreckon._version import __version__
from deadreckon.names import shown
from deadreckon.policies.table_predict import Predictor

if TYPE_CHECKING:
    from deadreckon.runs.service import Limits

_STYLE = """body{font:16px/1.5 system-ui,sans-serif;max-width:50rem;margin:2rem auto;padding:0 1rem}
table{border-collapse:collapse;display:block;overflow-x:auto}td,th{border:1px solid #8886;padding:.3rem .6rem;text-align:left}
pre{background:#8881;padding:1rem;overflow-x:auto}
@media(prefers-color-scheme:dark){body{background:#111;color:#eee}a{color:#8cf}}"""


def described(policy: Predictor, words: str) -> dict[str, Any]:
    """The columns of rows and of actions, as JSON values."""
    encoder = policy.encoder
    actions: dict[str, Any] = {key: _of_action(column) for key, column in encoder.actions.items()}
    if encoder.discrete:
        actions[next(iter(actions), "action")] = {"kind": "discrete", "levels": encoder.names}
    return {
        "policy": words, "history": policy.steps,
        "observations": {key: _of_column(column, encoder.held.get(key) or {}) for key, column in encoder.observed.items()},
        "legal": {key: {"of": column["of"]} if "of" in column else {} for key, column in encoder.allowed.columns.items()},
        "episode": encoder.one.get("episode"), "actions": actions,
        "size": None if encoder.shape is None else list(encoder.shape),
    }  # fmt: skip


def _of_column(column: dict[str, Any], held: dict[str, Any]) -> dict[str, Any]:
    told = {key: column[key] for key in ("kind", "unit", "levels", "low", "high") if key in column}
    seen = [held["low"], held["high"]] if "low" in held and "high" in held and column["kind"] != "category" else None
    return told | {"may_be_missing": bool(column.get("marked"))} | ({} if seen is None else {"in_the_log": seen})


def _of_action(column: dict[str, Any]) -> dict[str, Any]:
    return {"kind": "continuous"} | {key: column[key] for key in ("unit", "low", "high") if key in column}


def openapi(policy: Predictor, words: str, limits: "Limits", sampled: bool = False) -> dict[str, Any]:
    """The OpenAPI document."""
    told = described(policy, words)
    row, actions = _row(policy, told), {key: _type_of_action(action) for key, action in told["actions"].items()}
    action = {"type": "object", "properties": actions}
    shares = {"type": "object", "additionalProperties": {"type": "number"}}
    one = {"action": action, "probabilities": shares, "outside": {"type": "boolean"}}
    several = {
        "actions": {"type": "array", "items": action}, "probabilities": {"type": "array", "items": shares},
        "outside": {"type": "array", "items": {"type": "boolean"}},
    }  # fmt: skip
    error = {"type": "object", "properties": {"error": {"type": "string"}}, "required": ["error"]}
    answers = {str(code): {"description": text, "content": _as_json(error)} for code, text in (
        (400, "the body is not JSON"), (408, "the body does not arrive in time"),
        (413, f"the body is larger than {limits.body:,} bytes, or has more than {limits.rows:,} rows"),
        (422, "a column, a value or an option is wrong"),
    )}  # fmt: skip
    rows = {"oneOf": [row, {"type": "array", "items": row, "minItems": 1, "maxItems": limits.rows}]}
    body = {"required": True, "content": {"application/json": {"schema": rows, "example": example(policy)}}}
    ok = {"oneOf": [{"type": "object", "properties": properties} for properties in (one, several)]}
    predict = {
        "summary": "The actions of the policy in one row or several", "operationId": "predict", "requestBody": body,
        "parameters": [
            _option("probabilities", {"type": "boolean", "default": False}, "also give the probabilities of discrete actions"),
            _option("greedy", {"type": "boolean", "default": not sampled}, "take the deterministic (greedy) action"),
            _option("outside", {"enum": ["raise", "flag"], "default": "raise"}, "refuse rows outside the log, or mark them"),
            _option("seed", {"type": "integer", "minimum": 0}, "of sampled actions; if absent, each request draws new ones"),
        ],
        "responses": {"200": {"description": "the actions", "content": _as_json(ok)}, **answers},
    }  # fmt: skip

    def get(text: str) -> dict[str, Any]:
        return {"get": {"summary": text, "responses": {"200": {"description": text, "content": _as_json({})}}}}

    return {
        "openapi": "3.1.0", "info": {"title": "deadreckon policy", "version": __version__, "description": words},
        "paths": {"/predict": {"post": predict}, "/health": get("whether the service answers"),
                  "/schema": get("the columns of rows and of actions")},
    }  # fmt: skip


def _option(name: str, kind: dict[str, Any], text: str) -> dict[str, Any]:
    return {"name": name, "in": "query", "required": False, "schema": kind, "description": text}


def _as_json(schema: dict[str, Any]) -> dict[str, Any]:
    return {"application/json": {"schema": schema}}


def _row(policy: Predictor, told: dict[str, Any]) -> dict[str, Any]:
    """JSON Schema of a row."""
    encoder = policy.encoder
    if not encoder.observed:
        found: dict[str, Any] = {"type": "number"}
        for size in reversed(encoder.shape or (None,)):
            found = {"type": "array", "items": found} | ({} if size is None else {"minItems": size, "maxItems": size})
        return found
    properties = {key: _type_of(column) for key, column in told["observations"].items()}
    for key, column in told["legal"].items():
        names = {"enum": encoder.names}
        properties[key] = {"type": "boolean"} if "of" in column else {"type": "array", "items": names, "minItems": 1}
    required = list(properties)
    if policy.by_episode and told["episode"] is not None:
        properties[told["episode"]] = {"type": ["string", "number"]}
        required.append(told["episode"])
    return {"type": "object", "properties": properties, "required": required}


def _type_of(column: dict[str, Any]) -> dict[str, Any]:
    missing = column["may_be_missing"]
    if column["kind"] == "category":
        return {"enum": [*column["levels"], *([None] if missing else [])]}
    kind = "boolean" if column["kind"] == "flag" else "number"
    limits = {key: column[name] for key, name in (("minimum", "low"), ("maximum", "high")) if name in column}
    unit = {"description": f"in {column['unit']}"} if column.get("unit") else {}
    return {"type": [kind, "null"] if missing else kind} | limits | unit


def _type_of_action(action: dict[str, Any]) -> dict[str, Any]:
    if action["kind"] == "discrete":
        return {"enum": action["levels"]}
    return _type_of({**action, "may_be_missing": False})


def _zeros(shape: tuple[int, ...]) -> Any:
    return [_zeros(shape[1:])] * shape[0] if shape else 0.0


def example(policy: Predictor) -> Any:
    """A row that the policy takes: means and first levels."""
    encoder = policy.encoder
    if not encoder.observed:
        return _zeros(encoder.shape or (1,))
    row: dict[str, Any] = {}
    for key, column in encoder.observed.items():
        mean = (encoder.held.get(key) or {}).get("mean", column.get("fill") or column.get("low") or 0.0)
        plain = True if column["kind"] == "flag" else round(mean) if column["kind"] == "integer" else float(f"{mean:.4g}")
        row[key] = column["levels"][0] if column["kind"] == "category" else plain
    for key, column in encoder.allowed.columns.items():
        row[key] = True if column.get("of") is not None else encoder.names
    if policy.by_episode and (key := encoder.one.get("episode")) is not None:
        row[key] = "1"
    return row


def page(policy: Predictor, words: str, document: dict[str, Any]) -> str:
    """The page /docs: HTML without scripts, which loads nothing from other servers."""
    told = described(policy, words)
    rows = [["column", "kind", "unit", "values", "may be missing"]]
    for key, column in told["observations"].items():
        values = ", ".join(map(str, column.get("levels", [])))
        ends = [column[name] for name in ("low", "high") if name in column] or column.get("in_the_log", [])
        values = values or " .. ".join(f"{end:g}" for end in ends)
        rows.append([key, column["kind"], column.get("unit", ""), values, "yes" if column["may_be_missing"] else "no"])
    for key in told["legal"]:
        rows.append([key, "legal actions", "", "", "no"])
    acts = [["column", "kind", "unit", "values"]]
    for key, action in told["actions"].items():
        ends = " .. ".join(f"{action[name]:g}" for name in ("low", "high") if name in action)
        acts.append([key, action["kind"], action.get("unit", ""), ", ".join(map(str, action.get("levels", []))) or ends])
    body = json.dumps(example(policy), ensure_ascii=False)
    call = f"curl -X POST http://HOST:PORT/predict -H 'content-type: application/json' -d '{body}'"
    options = document["paths"]["/predict"]["post"]["parameters"]
    listed = "".join(f"<li><code>{_text(o['name'])}</code>: {_text(o['description'])}</li>" for o in options)
    return (
        f"<!doctype html><html lang=en><meta charset=utf-8><meta name=viewport content='width=device-width'>"
        f"<title>deadreckon policy</title><style>{_STYLE}</style><h1>deadreckon policy</h1><p>{_text(words)}</p>"
        f"<h2>POST /predict</h2><p>A row <code>{{column: value}}</code>, or a list of rows.</p><pre>{_text(call)}</pre>"
        f"<h3>Columns of a row</h3>{_table(rows)}<h3>Columns of an action</h3>{_table(acts)}"
        f"<h3>Options, such as <code>/predict?probabilities=true</code></h3><ul>{listed}</ul>"
        "<h2>GET</h2><ul><li><a href=/health>/health</a></li><li><a href=/schema>/schema</a></li>"
        "<li><a href=/openapi.json>/openapi.json</a></li></ul></html>"
    )


def _table(rows: list[list[Any]]) -> str:
    cells = lambda row, tag: "".join(f"<{tag}>{_text(cell)}</{tag}>" for cell in row)  # noqa: E731
    head, *body = rows
    return f"<table><tr>{cells(head, 'th')}</tr>" + "".join(f"<tr>{cells(row, 'td')}</tr>" for row in body) + "</table>"


def _text(value: Any) -> str:
    return html.escape(shown(value, keep="\n\t"))
