"""Runs to report on."""

import pytest
from run_folders import write_run


@pytest.fixture
def runs(tmp_path):
    """Cloning, a good agent, and one whose values explode and one of whose lanes failed."""
    return [
        write_run(tmp_path / "bc", "bc", 60.0, metrics={"behavior_nll": 3.0, "behavior_error": 0.2}, paths=True),
        write_run(tmp_path / "good", "td3_bc", 150.0, promised=45.0, metrics={"critic_loss": 5.0, "q": 40.0}, paths=True),
        write_run(
            tmp_path / "wild", "td3", 20.0, promised=3.0e7, metrics={"critic_loss": 1e12, "q": 1e7},
            failures={1: ("critic_loss", 150)}, paths=True,
        ),
    ]  # fmt: skip
