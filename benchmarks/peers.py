"""Makes the environment of the peers: `python benchmarks/peers.py setup`.

Our own install never sees torch; the peers live in .cache/peer, which git ignores.
"""

import argparse
import subprocess
import sys
from pathlib import Path

from protocol import BenchError

HOME = Path(__file__).resolve().parent.parent / ".cache" / "peer"
PYTHON = HOME / "bin" / "python"
TORCH, D3RLPY = "2.13.0", "2.8.1"
TORCH_INDEX = "https://download.pytorch.org/whl/cpu"  # the one on PyPI brings gigabytes of CUDA


def ready(python: Path) -> bool:
    """Whether this Python has the versions we compare with."""
    ask = "from importlib.metadata import version as v; print(v('torch').split('+')[0], v('d3rlpy'))"
    try:
        said = subprocess.run([str(python), "-c", ask], capture_output=True, text=True, check=True).stdout.split()
    except (OSError, subprocess.CalledProcessError):
        return False
    return said == [TORCH, D3RLPY]


def setup(base: str) -> Path:
    """The peers' Python, made if absent. `base` is the Python the environment is made from."""
    if ready(PYTHON):
        return PYTHON
    steps = [
        [base, "-m", "venv", "--clear", str(HOME)],
        [str(PYTHON), "-m", "pip", "install", "--extra-index-url", TORCH_INDEX, f"torch=={TORCH}+cpu"],
        [str(PYTHON), "-m", "pip", "install", f"torch=={TORCH}+cpu", f"d3rlpy=={D3RLPY}"],
    ]
    for step in steps:
        print("$", " ".join(step), flush=True)
        try:
            subprocess.run(step, check=True)
        except (OSError, subprocess.CalledProcessError) as error:
            raise BenchError(f"peer environment: `{' '.join(step)}` failed ({error})") from None
    return PYTHON


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("action", choices=["setup"])
    parser.add_argument("--python", default=sys.executable, help="Python to make the environment from")
    arguments = parser.parse_args()
    try:
        print(setup(arguments.python))
    except BenchError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
