"""Worker that lets d3rlpy learn from a log and act. Started by scores.py with the peer's Python: it never sees our package."""

import warnings
from importlib.metadata import version
from typing import Any

warnings.filterwarnings("ignore")

import d3rlpy  # noqa: E402
import numpy as np  # noqa: E402
import protocol  # noqa: E402
import torch  # noqa: E402
from d3rlpy.algos import BEARConfig, CQLConfig, IQLConfig, TD3PlusBCConfig  # noqa: E402
from d3rlpy.logging import NoopAdapterFactory  # noqa: E402
from d3rlpy.models.encoders import VectorEncoderFactory  # noqa: E402
from d3rlpy.preprocessing import StandardObservationScaler  # noqa: E402

VAE_WIDTH, VAE_BESIDE = 750, 256  # its behaviour model, where the other networks are so wide


def config(algo: str, width: int, updates: int) -> Any:
    """d3rlpy's algorithm with its own defaults, and the observation scaler that its TD3+BC is meant to have."""
    hidden = VectorEncoderFactory(hidden_units=[width, width])
    networks = {"actor_encoder_factory": hidden, "critic_encoder_factory": hidden}
    if algo == "td3_bc":
        return TD3PlusBCConfig(**networks, observation_scaler=StandardObservationScaler())
    if algo == "iql":
        return IQLConfig(**networks, value_encoder_factory=hidden)
    if algo == "cql":
        return CQLConfig(**networks)
    vae = VectorEncoderFactory(hidden_units=[width * VAE_WIDTH // VAE_BESIDE] * 2)
    # A fifth of the run is its warm start, as ours has it: its 40,000 updates would be all of a short run.
    return BEARConfig(**networks, imitator_encoder_factory=vae, warmup_steps=updates // 5)


class Learner:
    """What was learned last."""

    def __init__(self) -> None:
        self._algo: Any = None

    def learn(self, request: dict[str, Any]) -> dict[str, Any]:
        torch.set_num_threads(request["threads"])
        d3rlpy.seed(request["seed"])
        with np.load(request["log"]) as file:
            data = d3rlpy.dataset.MDPDataset(**{name: file[name] for name in file.files})
        self._algo = config(request["algo"], request["width"], request["updates"]).create(device=False)
        steps = request["updates"]
        self._algo.fit(
            data, n_steps=steps, n_steps_per_epoch=steps, show_progress=False, logger_adapter=NoopAdapterFactory()
        )  # fmt: skip
        return {}

    def act(self, request: dict[str, Any]) -> dict[str, Any]:
        actions = self._algo.predict(np.asarray(request["observation"], np.float32))
        return {"action": np.asarray(actions, np.float64).tolist()}


def versions(_: dict[str, Any]) -> dict[str, Any]:
    return {"versions": {name: version(name) for name in ("d3rlpy", "torch", "numpy")}}


if __name__ == "__main__":
    learner = Learner()
    protocol.serve({"learn": learner.learn, "act": learner.act, "versions": versions})
