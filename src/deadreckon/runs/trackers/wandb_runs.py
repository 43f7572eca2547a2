"""Runs in Weights & Biases, one for each seed in a group for each run folder; offline where there is no network."""

import glob
import shutil
import socket
import urllib.parse
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deadreckon.runs.trackers.tracker import files_of, needed

_SECONDS = 3.0  # that its server may take to answer
# It captures what is printed and copies the calling script where it is not asked to leave both.
_SETTINGS = {"silent": True, "console": "off", "save_code": False, "symlink": False}


class WandB:
    """Logs to the project `WANDB_PROJECT`, else `deadreckon`; files lie in `wandb` in the run folder.

    `WANDB_MODE` decides between `online` and `offline`; where it is not set, the server is tried. Offline runs are written anew
    when a run is resumed, and `wandb sync` uploads them; online ones take the points beyond their last.
    """

    def __init__(self):
        self.wandb = needed("wandb")

    def start(self, config: Mapping[str, Any]) -> None:
        """See `Tracker`."""
        folder = Path(config["folder"])
        settings = self.wandb.setup().settings
        mode = settings.mode if settings.mode in ("offline", "disabled", "shared") or _answers(settings.base_url) else "offline"
        if mode == "offline" and settings.mode != mode:
            told = f"wandb: no answer from {settings.base_url}, so the run is kept offline"
            warnings.warn(f"{told}; `wandb sync {folder / 'wandb'}/offline-run-*` uploads it", stacklevel=2)
        for path in folder.glob(f"wandb/offline-run-*-{glob.escape(config['id'])}-seed*"):
            shutil.rmtree(path)  # of before an interruption; it is written again
        self.runs = {
            seed: self.wandb.init(
                mode=mode, project=settings.project or "deadreckon", group=config["name"], dir=str(folder), resume="allow",
                id=f"{config['id']}-seed{seed}", name=f"{config['name']} seed {seed}", config=dict(config) | {"seed": seed},
                reinit="create_new", settings=self.wandb.Settings(**_SETTINGS),
            )
            for seed in config["seeds"]
        }  # fmt: skip

    def log(self, step: int, seed: int, metrics: Mapping[str, float]) -> None:
        """See `Tracker`."""
        run = self.runs[seed]
        if step >= run.starting_step:  # of a run that is resumed online, the first step that the server does not have
            run.log(dict(metrics), step=step)

    def finish(self, files: Sequence[Path] | None) -> None:
        """See `Tracker`."""
        for seed, run in self.runs.items():
            for path in files_of(seed, files or ()):
                run.save(str(path), base_path=str(path.parent), policy="now")
            run.finish(exit_code=1 if files is None else 0)


def _answers(url: str) -> bool:
    """Whether a server can be reached."""
    place = urllib.parse.urlsplit(url)
    port = place.port or (80 if place.scheme == "http" else 443)
    try:
        socket.create_connection((place.hostname or "", port), _SECONDS).close()
    except OSError:
        return False
    return True
