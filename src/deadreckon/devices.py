"""Where JAX computes: what is small and waits for a simulator at every step belongs on the processor."""

import contextlib
from typing import Any

import jax


def processor() -> Any:
    """The processor as a device of JAX; None where JAX has been told to use an accelerator alone (`JAX_PLATFORMS`)."""
    try:
        return jax.local_devices(backend="cpu")[0]
    except RuntimeError:
        return None


def on_processor() -> contextlib.AbstractContextManager[Any]:
    """While it is held, what is computed from arrays of no fixed device is computed on the processor, where there is one.

    For policies that act in a simulator: on an accelerator each action would wait for its turn among the programs there, and
    the last bits of what is logged would depend on whether there is one.
    """
    # To name the processor where it is used anyway would have what is compiled already compiled again.
    found = None if jax.default_backend() == "cpu" else processor()
    return contextlib.nullcontext() if found is None else jax.default_device(found)


def acting_platform() -> str:
    """What `on_processor` computes on, such as `cpu`."""
    found = processor()
    return jax.default_backend() if found is None else found.platform
