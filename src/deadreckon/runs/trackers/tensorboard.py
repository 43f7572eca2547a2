"""Event files for TensorBoard, a folder for each seed: `tensorboard --logdir runs` shows them."""

import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deadreckon.runs.trackers.tracker import needed


class TensorBoard:
    """Writes `tensorboard/seedS` in the run folder, anew whenever the run begins or is resumed: event files cannot be changed,
    and what a killed process wrote may go beyond its last checkpoint."""

    def __init__(self):
        self.make = needed("tensorboardX").SummaryWriter

    def start(self, config: Mapping[str, Any]) -> None:
        """See `Tracker`."""
        root = Path(config["folder"]) / "tensorboard"
        if root.exists():
            shutil.rmtree(root)
        self.writers = {seed: self.make(str(root / f"seed{seed}"), flush_secs=10) for seed in config["seeds"]}
        lines = json.dumps(dict(config), indent=1).splitlines()
        for writer in self.writers.values():
            writer.add_text("config", "\n".join(f"    {line}" for line in lines), 0)

    def log(self, step: int, seed: int, metrics: Mapping[str, float]) -> None:
        """See `Tracker`."""
        for name, value in metrics.items():
            self.writers[seed].add_scalar(name, value, step)

    def finish(self, files: Sequence[Path] | None) -> None:
        """See `Tracker`; event files hold no other files."""
        for writer in self.writers.values():
            writer.close()
