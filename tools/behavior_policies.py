"""The behaviour policies that come with the package: how their runs were made, published and drawn.

    python tools/behavior_policies.py --train --only hopper         (an hour on one core; goes on where it was stopped)
    python tools/behavior_policies.py --publish --episodes 1000         (measures all of them: hours)
"""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import tyro

import deadreckon as dr
from deadreckon.agents.sac import SAC
from deadreckon.cli.main import cache_compiled_programs
from deadreckon.cli.progress import Bar
from deadreckon.online import Online
from deadreckon.policies.library import ROOT
from deadreckon.report import picture
from deadreckon.runs.publish import Publish, publish


class Made(NamedTuple):
    """A run and what was taken from it. The entropies are those that MBPO's authors published for three of the robots."""

    target_entropy: float | None  # nats; None: minus the number of action dimensions
    updates: int  # over which the eleven snapshots are spread
    medium: int  # updates after which the policy was at about a third of D4RL's expert
    expert: int  # updates after which it was best


RUNS = {
    "hopper": Made(-1.0, 300_480, 200_320, 270_432),
    "halfcheetah": Made(None, 500_800, 60_096, 500_800),
    "walker2d": Made(-3.0, 500_800, 150_240, 460_736),
    "ant": Made(-4.0, 400_640, 150_240, 400_640),
    "humanoid": Made(-2.0, 1_502_400, 500_800, 1_502_400),  # declared, not made yet; the last two are to be chosen by its curve
}
SHIPPED = ("hopper", "halfcheetah", "walker2d", "ant")
SETTINGS = Online(updates_per_step=0.5)
EVERY = 20_000  # environment steps between kept policies; the snapshots are among them


@dataclass
class Options:
    """Online SAC on the Gym-MuJoCo tasks."""

    only: tuple[str, ...] = SHIPPED  # of these tasks, or humanoid
    train: bool = False  # train what is not trained yet
    publish: bool = False  # write the library and measure it
    episodes: int = 1000  # a policy, with drawn and with mean actions
    most: int = 1000  # episodes at most, where the error is still large
    out: str = "runs"  # the runs are OUT/sac-TASK
    library: str = str(ROOT)  # folder that is published to
    picture: str | None = None  # SVG file of the learning curves


def main(options: Options) -> None:
    """Does what is asked for, in this order: train, publish, picture."""
    cache_compiled_programs()
    folders = {name: Path(options.out) / f"sac-{name}" for name in options.only}
    for name, folder in folders.items():
        made = RUNS[name]
        if options.train:
            steps = SETTINGS.steps(made.updates)
            with Bar(f"sac in {name}", made.updates, "updates") as bar:
                dr.train_online(
                    SAC(batch_size=128, target_entropy=made.target_entropy), name, steps=steps, settings=SETTINGS,
                    evaluate_every=EVERY, out=folder, resume=True,
                    watch=lambda progress, updates, bar=bar: bar(progress.step, updates),
                )  # fmt: skip
        if options.publish:
            asked = Publish(
                str(folder), made.medium, made.expert, made.updates, episodes=options.episodes, most=options.most,
                out=options.library,
            )  # fmt: skip
            print(publish(asked, watch=print))
    if options.picture:
        panels = {name: [folder] for name, folder in folders.items()}
        references = {
            name: {"D4RL expert": task.published.expert, "a third of it": task.published.expert / 3}
            for name in folders
            if (task := dr.tasks.task(name)).published
        }
        names = {folder.name: name for name, folder in folders.items()}
        print(picture(options.picture, panels, quantity="return", names=names, references=references))


if __name__ == "__main__":
    main(tyro.cli(Options))
