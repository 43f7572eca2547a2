"""Shapes and kinds of numbers that the package's annotations promise, checked by jaxtyping at every call in the tests.

A call binds the names of the axes and every array of the call must agree with them. Inside a compiled function this happens
while it is traced, so it costs nothing when it runs. Annotations of other things (a path, an agent) are left to pyrefly.
"""

import importlib.util
import inspect
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, get_args

import jaxtyping
from beartype import beartype

USES = re.compile(r"^from jaxtyping import", re.MULTILINE)


def modules(package: str = "deadreckon") -> list[str]:
    """Those that annotate arrays, told by their text, because nothing may be imported before the hook is there."""
    (root,) = importlib.util.find_spec(package).submodule_search_locations
    files = [path for path in sorted(Path(root).rglob("*.py")) if USES.search(path.read_text())]
    return [".".join((package, *path.relative_to(root).with_suffix("").parts)) for path in files]


def arrays(hint: Any) -> Iterator[type[jaxtyping.AbstractArray]]:
    """The annotations of arrays within one, say within a tuple's."""
    if inspect.isclass(hint) and issubclass(hint, jaxtyping.AbstractArray):
        yield hint
    for part in get_args(hint):
        if not isinstance(part, list):  # a function's arguments
            yield from arrays(part)


def checked(function: Callable) -> Callable:
    """`beartype` for the annotations that hold arrays.

    NumPy's arrays pass for JAX's: JAX takes both, and tests make use of it.
    """
    shapes = {name: hint for name, hint in function.__annotations__.items() if any(arrays(hint))}
    for hint in shapes.values():
        for array in arrays(hint):
            array.array_type = Any
    function.__annotations__ = shapes
    return beartype(function) if shapes else function


def check() -> None:
    """From here on, modules that are imported check their shapes."""
    jaxtyping.install_import_hook(modules(), "tests.shapes.checked")
