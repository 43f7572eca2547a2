"""`deadreckon design --targets A B`: proposals, lines, CSV and page for several targets at once."""

import sys
from pathlib import Path
from typing import Any

from deadreckon.cli.design_asked import size_told
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
    if options.minimise == ():
        raise UserError(f"--minimise needs names with --targets, such as --minimise {options.targets[-1]}")
    if name not in ("auto", "gp"):
        raise UserError(f"several --targets have a Gaussian process each; leave out --method {name}")
    if options.data is None:
        raise UserError("design needs --data FILE with --targets A B")


def check_schema(path: Any, schema: Any) -> None:
    """Refuses a schema that says what does not go with several targets.

    Raises:
        UserError: one line, with the column.
    """
    for role in ("weighted", "std_error"):
        for name in schema.named(role):
            raise UserError(
                f"{path}: column {name} has the role {role}, which does not go with --targets; make its role input or ignore"
            )
    if schema.minimise and not schema.named("target"):
        raise UserError(
            f"{path}: minimise = true is of no column, since none is the target; leave it out, and name those of --targets "
            "that are to be made small (--minimise NAMES)"
        )


def check_names(data: Any) -> None:
    """Refuses targets of which columns of the proposals would be called the same.

    Raises:
        UserError: two targets would have a column in common.
    """
    from deadreckon.mbo.proposal_table import OF_TARGET, free_name

    owners: dict[str, str] = {}
    for each in data:
        for what in OF_TARGET:
            name = free_name(f"{what}_{each.target}", data[0])
            if name in owners:
                raise UserError(
                    f"{each.name}: targets {owners[name]} and {each.target} would both have the column {name} of the "
                    "proposals; rename one of them in the table"
                )
            owners[name] = each.target


def write_proposals(options: Any, asked: dict[str, Any]) -> None:
    """Proposes, writes and prints; `asked` are keywords of `Designs.from_frame`, but for the targets.

    Those in `--minimise` are made small, and the schema's own target where the schema says so.
    """
    from deadreckon.mbo.batch import repeats_told
    from deadreckon.mbo.design_schema import DesignSchema
    from deadreckon.mbo.designs import Designs
    from deadreckon.mbo.front import propose_front, targets_of
    from deadreckon.mbo.proposal_table import about_front, added_columns_of_front
    from deadreckon.mbo.unscored import unscored_told
    from deadreckon.report.design_front import write_front

    schema = None if options.schema is None else DesignSchema.load(options.schema)
    if schema is not None:
        check_schema(options.schema, schema)
    read = Designs.from_csv if schema is None else schema.read
    data = targets_of(lambda **more: read(options.data, **more), options.targets, options.minimise or (), **asked)
    check_names(data)
    point = None
    if options.reference:
        if set(options.reference) != set(options.targets):
            raise UserError(f"--reference needs a number for each of {', '.join(options.targets)}, as TARGET NUMBER pairs")
        point = [options.reference[name] for name in options.targets]
    out = Path(options.out or Path("runs", "design", file_part(f"front-{data[0].name}")))
    with alone(out, what=str(out)):
        with Watch() as watch:
            front = propose_front(data, options.n, seed=options.seed, reference=point, repeat=options.repeat, watch=watch)
        x, more = front.made[0].x, added_columns_of_front(front)
        written = data[0].write(out / "proposals.csv", x, more)
        for line in told(front):
            print(line)
        for line in (*front.notes, *repeats_told(data[0], x), *unscored_told(data[0], x), *front.warnings):
            print(f"! {line}", file=sys.stderr)
        print(written)
        write_beside(data[0].decode(x) | more, about_front(front), out / "proposals.xlsx")
        print(write_front(front, out / "report.html"))


def told(front: Any) -> list[str]:
    """Lines for the terminal."""
    data = front.data[0]
    names = ", ".join(f"{'least' if each.minimise else 'greatest'} {each.target}" for each in front.data)
    point = ", ".join(f"{each.target} {value:,.4g}" for each, value in zip(front.data, front.shown(front.reference)))
    best, n = front.best.sum(), len(front.made[0])
    gain = f"what the {n:,} proposals add to it is not known"
    if not front.unskilled:
        gain = f"the {n:,} proposals are expected to add {front.gain:,.4g}"
    lines = [
        f"{size_told(data)}; {names}; {best:,} designs are on the front of the data",
        f"hypervolume of the data {front.before:,.4g} from the reference point {point}; {gain}",
    ]
    return lines + [str(made.quality) for made in front.made if made.quality is not None]
