"""What the bits of a result depend on beside its settings, and how two such notes differ."""

import os
import platform
import sys
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

from deadreckon._version import __version__


def versions() -> dict[str, Any]:
    """Of packages, Python, platform and device, and the threads there are."""
    import jax

    # Its own is that of the code which runs, which may be a checkout that nobody installed.
    named = {"deadreckon": __version__}
    named |= {name: metadata.version(name) for name in ("jax", "jaxlib", "equinox", "optax", "numpy", "mujoco")}
    device = jax.devices()[0]
    return named | {
        "python": platform.python_version(),
        "platform": f"{sys.platform} {platform.machine()}",
        "device": f"{device.platform} {device.device_kind}",
        "threads": len(cores()),
    }


def cores() -> list[int]:
    """The cores that this process may use, where the system says so (Linux); otherwise all."""
    return sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else list(range(os.cpu_count() or 1))


def cpu_model() -> str:
    """The processor's model as its maker calls it, or its kind, such as `x86_64`, if the system does not tell the model."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()  # Linux; on ARM without names of models
    except OSError:
        lines = []
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, "") or platform.processor() or platform.machine()


def installed(package: str) -> dict[str, str]:
    """The version of an optional package by its name; empty where it is not installed."""
    try:
        return {package: metadata.version(package)}
    except metadata.PackageNotFoundError:
        return {}


def differences(before: Any, now: Any, keys: Sequence[str] | None = None, prefix: str = "") -> list[str]:
    """One line for each value that differs between two nested notes; of these keys, or of all.

    Where something lies and when it was made are passed over.
    """
    out = []
    for key in dict.fromkeys([*before, *now]) if keys is None else keys:
        a, b = before.get(key), now.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            inner = [k for k in dict.fromkeys([*a, *b]) if k not in ("path", "created")]
            out += differences(a, b, inner, f"{prefix}{key}.")
        elif a != b and not (key == "marked" and not a and not b):  # which schemas of before did not say where it is False
            out.append(f"{prefix}{key} was {a}, now {b}")
    return out
