"""Problems by name."""

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from deadreckon.errors import unknown
from deadreckon.mbo.problems.gfp import FILE as GFP_FILE
from deadreckon.mbo.problems.gfp import SOURCE as GFP_SOURCE
from deadreckon.mbo.problems.gfp import gfp
from deadreckon.mbo.problems.hopper_controller import hopper_controller
from deadreckon.mbo.problems.molecule import FILE as MOLECULE_FILE
from deadreckon.mbo.problems.molecule import SOURCE as MOLECULE_SOURCE
from deadreckon.mbo.problems.molecule import molecule
from deadreckon.mbo.problems.morphology import morphology
from deadreckon.mbo.problems.problem import Problem, file_of
from deadreckon.mbo.problems.superconductor import FILE as SUPERCONDUCTOR_FILE
from deadreckon.mbo.problems.superconductor import SOURCE as SUPERCONDUCTOR_SOURCE
from deadreckon.mbo.problems.superconductor import superconductor
from deadreckon.mbo.problems.synthetic import FUNCTIONS, nk, synthetic
from deadreckon.mbo.problems.tfbind8 import FILE as TFBIND8_FILE
from deadreckon.mbo.problems.tfbind8 import SOURCE as TFBIND8_SOURCE
from deadreckon.mbo.problems.tfbind8 import tfbind8


class Entry(NamedTuple):
    """How a problem is made, one line about it, the file that it reads, if any, and what that holds, and the revision of its
    designs and its judge, which is raised where their numbers change (see bench/identity.py)."""

    make: Callable[..., Problem]
    about: str
    file: str | None = None
    source: str = ""
    revision: int = 1


PROBLEMS: dict[str, Entry] = {
    "hopper-controller": Entry(hopper_controller, "5,126 weights of a controller, scored in MuJoCo (thesis 6.5)"),
    "ant-morphology": Entry(partial(morphology, "ant-morphology"), "60 numbers of an ant's legs; MuJoCo (thesis 6.5)"),
    "dkitty-morphology": Entry(partial(morphology, "dkitty-morphology"), "56 numbers of a kitty's legs, scored in MuJoCo"),
    "superconductor": Entry(
        superconductor,
        "81 statistics of a material; critical temperature by a random forest",
        SUPERCONDUCTOR_FILE,
        SUPERCONDUCTOR_SOURCE,
    ),
    "superconductor-boosting": Entry(
        partial(superconductor, "superconductor-boosting", oracle="boosting", bounded=False),
        "the same without bounds; critical temperature by gradient boosting, as in the benchmark of 2020",
        SUPERCONDUCTOR_FILE,
        SUPERCONDUCTOR_SOURCE,
    ),
    "gfp": Entry(gfp, "237 amino acids; brightness by a learned oracle", GFP_FILE, GFP_SOURCE),
    "gfp-gp": Entry(
        partial(gfp, "gfp-gp", oracle="gp"),
        "the same; brightness by a Gaussian process, as in the benchmark of 2020",
        GFP_FILE,
        GFP_SOURCE,
    ),
    "molecule": Entry(molecule, "1,024 substructures; activity by a random forest", MOLECULE_FILE, MOLECULE_SOURCE),
    "tfbind8": Entry(tfbind8, "8 bases of DNA; every design's score is known", TFBIND8_FILE, TFBIND8_SOURCE),
    "nk": Entry(nk, "8 sites of 4 letters with neighbours' influence; every design's score is known"),
    **{name: Entry(partial(synthetic, name), f"{f.dimensions} numbers; a test function") for name, f in FUNCTIONS.items()},
}


def check_known(name: str, **options: Any) -> None:
    """Refuses what `problem` would refuse at once: an unknown name or option, and a file that is not there.

    Args:
        name: of the problem.
        options: see `problem`.

    Raises:
        UserError: one line.
    """
    if name not in PROBLEMS:
        raise unknown("problem", name, PROBLEMS)
    entry = PROBLEMS[name]
    known = [option for option in inspect.signature(entry.make).parameters if option != "name"]
    for option in options:
        if option not in known:
            raise unknown(f"option of {name}", option, known)
    if entry.file is not None:
        file_of(name, options.get("path"), entry.file, entry.source)


def problem(name: str, **options: Any) -> Problem:
    """A problem by name.

    Args:
        name: among `PROBLEMS`.
        options: of the function that makes it, such as `path` or `shown`.

    Raises:
        UserError: an unknown name or option, or data that is not there.
    """
    check_known(name, **options)
    return PROBLEMS[name].make(**options)
