"""Loads a policy as MLflow's pyfunc flavour asks; beside the numpy player it needs numpy and pandas alone."""

from pathlib import Path
from typing import Any

if __package__:
    from deadreckon.policies import portable
else:  # among the code of a model
    import portable  # pyrefly: ignore[missing-import]


class Model:
    """A policy as MLflow calls it.

    Args:
        play: what acts.
    """

    def __init__(self, play: Any):
        self.play = play

    def predict(self, model_input: Any, params: Any = None) -> Any:
        """A data frame of actions by the names of their columns, for rows with the columns of the policy's log.

        Args:
            model_input: a data frame, or an array of observations where the policy's log was no table.
            params: not used; MLflow passes it.
        """
        import pandas

        actions = self.play.predict(model_input)
        if isinstance(actions, dict):
            return pandas.DataFrame(actions)
        names = [key for key, column in _columns(self.play).items() if column["role"] == "action"]
        if actions.ndim == 1:
            return pandas.DataFrame({names[0] if names else "action": actions})
        return pandas.DataFrame(actions, columns=names or [f"action_{i}" for i in range(actions.shape[1])])


def _columns(play: Any) -> dict[str, Any]:
    return ((play.log.get("extra") or {}).get("schema") or {}).get("columns") or {}


def _load_pyfunc(data_path: str) -> Model:
    """What MLflow calls with the folder of the model's data."""
    return Model(portable.load(Path(data_path) / "policy.npz"))
