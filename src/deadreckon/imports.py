"""Things of users, named `module:attribute`, and packages that go by variables of the environment.

What a user names is imported. What a file names may be somebody else's: code runs when a module is imported, and when what it
holds is called, so both are left to modules that the user has named (`trust`).
"""

import contextlib
import importlib
import os
import sys
from collections.abc import Iterator
from typing import Any

from deadreckon.errors import UserError

_TRUSTED: set[str] = set()


def trust(*modules: str) -> None:
    """Lets files name what these modules, and modules below them, hold: it is imported and called then.

    Args:
        modules: such as `my_studies`.

    Raises:
        UserError: it cannot be the name of a module.
    """
    for module in modules:
        if not all(part.isidentifier() for part in module.split(".")):
            raise UserError(f"a module is named such as my_studies or lab.studies, got {module!r}")
        _TRUSTED.add(module)


def trusted(module: str) -> bool:
    """Whether files may name anything in a module."""
    parts = module.split(".")
    return any(".".join(parts[: i + 1]) in _TRUSTED for i in range(len(parts)))


def imported(path: str, what: str, form: str) -> Any:
    """What has that name in that module, or None where the module has no such name.

    Modules are looked for as Python does, and in the current folder.

    Args:
        path: `module:attribute`.
        what: it is, for the error.
        form: what stands behind the colon, such as `Class`, for the error.

    Raises:
        UserError: it is not named so, or the module cannot be imported.
    """
    module, _, attribute = path.partition(":")
    if not module or module.startswith(".") or not attribute:
        raise UserError(f"{what} {path!r} must be named module:{form}")
    if (here := os.getcwd()) not in sys.path:
        sys.path.append(here)  # a command that pip installs does not look there
    try:
        found = importlib.import_module(module)
    except Exception as error:  # whatever the user's module raises is the user's to mend
        what_of = error if isinstance(error, ImportError) else f"{type(error).__name__}: {error}"
        article = "an" if what[0] in "aeiou" else "a"
        raise UserError(f"{what} {path}: {what_of}; {article} {what} of your own is named module:{form}") from error
    return getattr(found, attribute, None)


@contextlib.contextmanager
def environment_variable(name: str, value: str) -> Iterator[None]:
    """A variable of the environment meanwhile, for packages that look there alone."""
    before = os.environ.get(name)
    os.environ[name] = value
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before
