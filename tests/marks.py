"""Marks of parameters."""

from typing import Any

import pytest


def slow(*each: Any) -> list[Any]:
    """Parameters, or tuples of them, with which a test is a slow one."""
    return [pytest.param(*(one if isinstance(one, tuple) else (one,)), marks=pytest.mark.slow) for one in each]
