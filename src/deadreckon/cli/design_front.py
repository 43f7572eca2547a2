"""`deadreckon design --targets A B`: proposals, lines, CSV and page for several targets at once."""

import sys
from pathlib import Path
from typing import Any

from deadreckon.cli.progress import Watch
from deadreckon.cli.sheets import write_beside
from deadreckon.errors import UserError
from deadreckon.files import alone
from deadreckon.names import file_part


def check(name: str, options: Any) -> None:
    """Refuses what does not go with several targets.

    Raises:
        UserError: one line, with the option.
    """
    others = {
        "--target": options.target, "--problem": options.problem, "--weights": options.weights, "--path": options.path,
        "--std-error": options.std_error, "--budget": options.budget,
    }  # fmt: skip
    for option, value in others.items():
        if value:
            raise UserError(f"{option} does not go with --targets, which are a front of several scores; leave one of them out")
    if name not in ("auto", "gp"):
        raise UserError(f"several --targets have a Gaussian process each; leave out --method {name}")
    if options.data is None:
        raise UserError("design needs --data FILE with --targets A B")


def write_proposals(options: Any, asked: dict[str, Any]) -> None:
    """Proposes, writes and prints; `asked` are keywords of `Designs.from_frame`, but for the targets."""
    from deadreckon.mbo.design_schema import DesignSchema
    from deadreckon.mbo.designs import Designs
    from deadreckon.mbo.front import propose_front, targets_of
    from deadreckon.mbo.nn_distance import nn_distance
    from deadreckon.mbo.proposal_table import about_front, free_name
    from deadreckon.report.design_front import write_front

    schema = None if options.schema is None else DesignSchema.load(options.schema)
    read = Designs.from_csv if schema is None else schema.read
    data = targets_of(lambda **more: read(options.data, **more), options.targets, options.minimise or (), **asked)
    point = None
    if options.reference:
        if set(options.reference) != set(options.targets):
            raise UserError(f"--reference needs a number for each of {', '.join(options.targets)}, as TARGET NUMBER pairs")
        point = [options.reference[name] for name in options.targets]
    out = Path(options.out or Path("runs", "design", file_part(f"front-{data[0].name}")))
    with alone(out, what=str(out)):
        with Watch() as watch:
            front = propose_front(data, options.n, seed=options.seed, reference=point, repeat=options.repeat, watch=watch)
        x, more = front.made[0].x, {}
        for each, made in zip(data, front.made):
            more[f"predicted_{each.target}"] = each.shown(made.predicted)
            more[f"predicted_std_{each.target}"] = made.predicted_std
            more[f"mean_std_{each.target}"] = made.mean_std
        more["distance"] = nn_distance(data[0], x)
        named = {free_name(key, data[0]): value for key, value in more.items()}
        written = data[0].write(out / "proposals.csv", x, named)
        for line in told(front):
            print(line)
        for line in front.warnings:
            print(f"! {line}", file=sys.stderr)
        print(written)
        write_beside(data[0].decode(x) | named, about_front(front), out / "proposals.xlsx")
        print(write_front(front, out / "report.html"))


def told(front: Any) -> list[str]:
    """Lines for the terminal."""
    from deadreckon.mbo.hypervolume import non_dominated

    data, y = front.data[0], front.observed
    names = ", ".join(f"{'least' if each.minimise else 'greatest'} {each.target}" for each in front.data)
    point = ", ".join(f"{each.target} {value:,.4g}" for each, value in zip(front.data, front.shown(front.reference)))
    size, best, n = f"{len(data):,} designs, {len(data.variables):,} variables", non_dominated(y).sum(), len(front.made[0])
    lines = [
        f"{data.name}: {size}; {names}; {best:,} designs are on the front of the data",
        f"hypervolume of the data {front.before:,.4g} from the reference point {point}; the {n:,} proposals are expected "
        f"to add {front.gain:,.4g}",
    ]
    return lines + [str(made.quality) for made in front.made if made.quality is not None]
