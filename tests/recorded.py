"""What `estimates.json` says of policies that nobody judged: a whole record, for tests of what reads it."""

from typing import Any


def decision(policies: list[dict[str, Any]], results: list[dict[str, Any]] = (), **changes: Any) -> dict[str, Any]:
    """A decision to deploy the first of the policies.

    Args:
        policies: name, and what else is to be said of each.
        results: value, low and high of each policy and of the behaviour policy, and what else is to be said of a method.
        **changes: of what the record says.
    """
    gains = [[0.1, 0.0, 0.2] for _ in policies]
    record = {
        "log": "log", "estimand": {"words": "expected reward", "discount": 1.0, "horizon": 1, "greedy": True}, "truth": None,
        "policies": [{"run": "run", "seed": 0} | each for each in policies],
        "results": [{"method": "dr", "title": "DR", "gain": gains, "effective": None} | each for each in results],
        "judged": {"words": "60 episodes", "episodes": 60, "of": 60, "fresh": True, "cluster": None},
        "looks": {"number": 1, "policies": len(policies), "counted": True},
        "support": {"missing": [0.0 for _ in policies], "ratio": [1.0 for _ in policies]},
        "choice": {
            "name": policies[0]["name"], "deploy": True, "gain": gains[0], "level": 0.95, "reason": "its gain is above zero",
            "evidence": [], "warnings": [], "objections": [[] for _ in policies],
        },
    }  # fmt: skip
    for name, value in changes.items():
        record[name] = record[name] | value if isinstance(record.get(name), dict) and isinstance(value, dict) else value
    return record
