"""Whether MuJoCo draws here, which takes a screen, a GPU or OSMesa."""

import os
import subprocess
import sys
from functools import cache

import pytest

DRAWS = """
from deadreckon.tasks.pixels import choose_opengl
choose_opengl()
import mujoco
mujoco.Renderer(mujoco.MjModel.from_xml_string("<mujoco/>"), 16, 16).render()
"""


@cache
def draws() -> bool:
    """Tried in a process of its own, since MuJoCo looks for OpenGL once, and some failures end the process."""
    return subprocess.run([sys.executable, "-c", DRAWS], capture_output=True, env=os.environ).returncode == 0


needs_opengl = pytest.mark.skipif(not draws(), reason="MuJoCo finds no OpenGL to draw with")
