"""What options of `deadreckon design` say of a table of experiments, as keywords of its readers."""

from typing import Any

from deadreckon.cli.data import mapping_options
from deadreckon.errors import UserError
from deadreckon.names import shown

NAMED = 12  # variables up to which they are listed
OF_TABLES = (
    "target", "schema", "kinds", "levels", "bounds", "ignore", "minimise", "reference", "steps", "logs", "fix", "constraints",
    "mixtures", "forbid", "std_error", "groups", "weights", "max_distance", "apart",
)  # fmt: skip


def check_problem(options: Any) -> None:
    """Refuses options that say something of a table where there is a problem.

    Raises:
        UserError: one line, with the option.
    """
    said = {name: getattr(options, name) for name in OF_TABLES} | mapping_options(options.file)
    said["minimise"] = None if options.minimise is None else True  # without names it is given, too
    for name, value in said.items():
        if value not in (None, (), {}):
            raise UserError(f"--{name.replace('_', '-')} is about a table of your own (--data); leave it out with --problem")


def check_budget(name: str) -> None:
    """Refuses a budget for a method whose models have one size alone.

    Raises:
        UserError: one line, with the methods that have two.
    """
    from deadreckon.mbo.registry import CPU_BUDGET

    if name not in CPU_BUDGET:
        raise UserError(
            f"--budget says whether models have published sizes, and {name} has none that were published; leave it out, or "
            f"take one of {', '.join(CPU_BUDGET)} (--method NAME)"
        )


def designs(options: Any) -> Any:
    """The designs of a file by the options of the command.

    Raises:
        UserError: there is no target, or what the readers refuse.
    """
    from deadreckon.mbo.design_schema import DesignSchema
    from deadreckon.mbo.designs import Designs

    if options.target is None and options.schema is None:
        raise UserError("missing --target, the column of the scores")
    if options.path is not None:
        raise UserError("--path is the file of a --problem; the file of your own designs is --data")
    more = asked(options) | {"minimise": options.minimise is not None, "std_error": options.std_error}
    more["weights"] = options.weights
    if options.schema is not None:
        return DesignSchema.load(options.schema).read(options.data or "", target=options.target, **more)
    return Designs.from_csv(options.data or "", options.target or "", **more)


def size_told(data: Any) -> str:
    """How many designs and variables there are, and which ones, so that an outcome that is taken for an input is seen."""
    names = [f"{shown(v.name)}{f' with {len(v.levels)} levels' * v.leveled}" for v in data.variables]
    listed = f" ({', '.join(names)})" if len(names) <= NAMED else ""
    return f"{data.name}: {len(data):,} designs, {len(names):,} variables{listed}"


def asked(options: Any) -> dict[str, Any]:
    """Keywords of `Designs.from_csv` but for those of the scores."""
    return {
        "kinds": options.kinds, "bounds": options.bounds, "ignore": options.ignore,
        "levels": {column: _listed(text) for column, text in options.levels.items()}, "steps": options.steps,
        "logs": options.logs, "fixed": options.fix, "groups": options.groups,
        "constraints": options.constraints, "mixtures": tuple(map(_listed, options.mixtures)), "forbidden": options.forbid,
        "max_distance": options.max_distance, "apart": options.apart, **mapping_options(options.file),
    }  # fmt: skip


def _listed(text: str) -> list[str]:
    return [part.strip() for part in text.split(",")]
