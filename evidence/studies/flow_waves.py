"""Space-time diagrams of the ring and the merge, as drivers leave them and as controllers that are known to calm traffic do.

    python evidence/studies/flow_waves.py --picture docs/results/flow-waves.svg
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import tyro

from deadreckon import tasks
from deadreckon.collect.flow import Idm, PISaturation
from deadreckon.report import spacetime
from deadreckon.report.picture import PANEL, sheet
from deadreckon.tasks.flow import Flow


@dataclass
class Options:
    """What is drawn."""

    picture: str = "flow-waves.svg"  # the SVG file
    ring_steps: int = 600  # five minutes
    merge_steps: int = 450  # seven and a half minutes
    seed: int = 0


def main(options: Options) -> None:
    """Draws the diagrams and prints what the episodes earn."""
    ring = replace(tasks.task("flow-ring"), horizon=options.ring_steps)
    merge = replace(tasks.task("flow-merge"), horizon=options.merge_steps)
    drawn = {
        "ring: the intelligent driver model": (ring, Idm(ring)),
        "ring: PI with saturation": (ring, PISaturation(ring)),
        "merge: the intelligent driver model": (merge, Idm(merge)),
        "merge: uniform actions": (merge, uniform(merge, options.seed)),
    }
    panels = {}
    for title, (task, controller) in drawn.items():
        cars, earned = play(task, controller, options.seed)
        later = cars[len(cars) // 2 :, :, 1]
        print(f"{title}: return {earned:.1f}; in the second half {np.nanmean(later):.2f} m/s, spread {np.nanstd(later):.2f}")
        panels[title] = spacetime.spacetime(cars, task.seconds, task.learners, title, PANEL)
    sheet(options.picture, panels, [])


def uniform(task: Flow, seed: int) -> Callable[[np.ndarray], np.ndarray]:
    """Draws actions between the bounds."""
    generator, bound = np.random.default_rng(seed), np.array(task.action_space.high)
    return lambda seen: generator.uniform(-bound, bound, (len(seen), len(bound)))


def play(task: Flow, controller: Callable[[np.ndarray], np.ndarray], seed: int) -> tuple[np.ndarray, float]:
    """(steps, cars, 2) positions and speeds of an episode, and its return."""
    simulator, shown, earned = task.simulate([seed]), [], 0.0
    seen = simulator.reset()
    for _ in range(task.horizon):
        shown.append(task.shown(simulator, seen, np.arange(1))[0])
        seen, rewards, _, _ = simulator.step(controller(seen))
        earned += float(rewards[0])
    return np.stack(shown), earned


if __name__ == "__main__":
    main(tyro.cli(Options))
