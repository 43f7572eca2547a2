"""What BEAR's choice at test time is worth: its actor's mean, its actor's draws, and the best of some draws by Q_1.

    python evidence/studies/bear_choice.py runs/bear-expert

The policies are those of finished runs: nothing is trained.
"""

import dataclasses
from dataclasses import dataclass
from typing import Annotated

import tyro

import deadreckon as dr
from deadreckon.policies.candidates import GreedyQ


@dataclass
class Options:
    """What BEAR's choice at test time is worth."""

    runs: Annotated[tuple[str, ...], tyro.conf.Positional]  # finished runs of BEAR
    samples: tuple[int, ...] = (1, 4, 10, 100)  # draws of which the best is taken; 1: the actor's own draw
    episodes: int = 10  # a seed


def main(options: Options) -> None:
    """Prints a table of normalised scores with 95 % intervals over seeds and episodes."""
    print("| run | mean of the actor | " + " | ".join(f"best of {n}" for n in options.samples) + " |")
    print("|---|---:|" + "---:|" * len(options.samples))
    for path in options.runs:
        run = dr.load_run(path)
        inners = [policy.inner for policy in run.policies]
        if not all(isinstance(inner, GreedyQ) for inner in inners):
            raise dr.UserError(f"{path}: its policies do not choose among draws")
        forms = [[inner.actor for inner in inners]]
        forms += [[GreedyQ.of(inner.actor, inner.critic, n) for inner in inners] for n in options.samples]
        cells = []
        for form in forms:
            policies = [dataclasses.replace(policy, inner=inner) for policy, inner in zip(run.policies, form)]
            cells.append(str(dr.evaluate(policies, run.config["task"], episodes=options.episodes).score()))
        print(f"| {run.path.parent.name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main(tyro.cli(Options))
