"""An accelerator that several processes share: what it is, and NVIDIA's multi-process service, where there is one."""

import contextlib
import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from deadreckon.files import alone
from deadreckon.names import file_part

_CONTROL = "nvidia-cuda-mps-control"
_FOLDERS = {"CUDA_MPS_PIPE_DIRECTORY": "pipe", "CUDA_MPS_LOG_DIRECTORY": "log"}
_PATIENCE = 10.0  # seconds for an answer


def device_kind() -> str | None:
    """The kind of the accelerator that JAX uses, such as `NVIDIA H100 80GB HBM3`; None where it uses the processor."""
    import jax

    return None if jax.default_backend() == "cpu" else jax.devices()[0].device_kind


def required() -> contextlib.AbstractContextManager[None]:
    """While it is held, processes that this one starts use the accelerator that it uses, or fail.

    Without it a process that finds no room on the device, say, fails in its first job and does the next ones on the processor:
    JAX falls back without a word once its backends have been looked for. What `JAX_PLATFORMS` says already
    stays, and for an accelerator of unknown make (see `platforms_of`) nothing is said.
    """
    import jax

    client = jax.devices()[0].client
    return _environment({"JAX_PLATFORMS": platforms_of(jax.default_backend(), client.platform_version)})


def platforms_of(backend: str, version: str) -> str:
    """Values of `JAX_PLATFORMS` that name an accelerator, and the processor after it, for what acts in simulators.

    Args:
        backend: JAX's name of it: `gpu`, `tpu` or `cpu`.
        version: what its client tells of itself, which names the maker's interface.
    """
    if backend == "cpu":
        return "cpu"
    named = [each for each in ("cuda", "rocm") if each in version.lower()] if backend == "gpu" else [backend]
    return ",".join([*named, "cpu"]) if named else ""


@contextlib.contextmanager
def shared() -> Iterator[str]:
    """While it is held, processes that this one starts share the accelerator; gives in words how.

    None of them takes its memory in advance. Where the multi-process service can be used and does not run, it is started, in a
    folder of its own, and stopped at the end; one that runs is left as it is, and no setting of the device is changed. To be
    entered before JAX has used the device.

    Raises:
        BusyError: another command does the same.
    """
    with contextlib.ExitStack() as kept:
        which = file_part(os.environ.get("CUDA_VISIBLE_DEVICES", ""))
        place = Path(tempfile.gettempdir()) / "-".join(filter(None, ("deadreckon-mps", str(os.getuid()), which)))
        kept.enter_context(alone(place, what="this GPU"))  # a plan is of the whole device; the service ends with it
        kept.enter_context(_environment({"XLA_PYTHON_CLIENT_PREALLOCATE": "false"}))
        control = shutil.which(_CONTROL)
        if control is None:
            yield f"processes share the device by turns: there is no {_CONTROL}"
            return
        if _answers(control, "get_server_list"):
            yield "processes share the device by the multi-process service, which runs already"
            return
        # Always the same folder, so that a service which a killed command has left is found, and stopped by the next one.
        for name in _FOLDERS.values():
            (place / name).mkdir(parents=True, exist_ok=True, mode=0o700)
        folders = kept.enter_context(contextlib.ExitStack())
        folders.enter_context(_environment({name: str(place / folder) for name, folder in _FOLDERS.items()}))
        if not _answers(control, "get_server_list") and not _starts(control):
            folders.close()  # without the service they would keep processes from the device
            yield "processes share the device by turns: the multi-process service does not start"
            return
        kept.callback(_answers, control, "quit")
        yield "processes share the device by the multi-process service, which is stopped at the end"


def _answers(control: str, command: str) -> bool:
    """Whether the service does as it is told."""
    try:
        done = subprocess.run([control], input=f"{command}\n", text=True, capture_output=True, timeout=_PATIENCE, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


def _starts(control: str) -> bool:
    try:
        done = subprocess.run([control, "-d"], capture_output=True, timeout=_PATIENCE, check=False)
    except (OSError, subprocess.TimeoutExpired):
        return False
    return done.returncode == 0


@contextlib.contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    """Variables of this process, and of those that it starts, as long as it is held; those that are set stay."""
    added = {name: value for name, value in changes.items() if name not in os.environ}
    os.environ.update(added)
    try:
        yield
    finally:
        for name in added:
            os.environ.pop(name, None)
