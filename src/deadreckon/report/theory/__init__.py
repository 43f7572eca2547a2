"""`deadreckon theory`: the arguments of the thesis as pictures, with the numbers behind them as CSV files beside."""

from collections.abc import Callable
from pathlib import Path

from deadreckon.report.theory.drawing import Made
from deadreckon.report.theory.grid import gridworld
from deadreckon.report.theory.normalised import nml
from deadreckon.report.theory.rollout_bounds import bounds
from deadreckon.report.theory.sampled_mmd import mmd

EXPERIMENTS: dict[str, tuple[Callable[[Path, int], Made], str]] = {
    "gridworld": (gridworld, "error propagation and the support threshold (Figure 4.2), a diverging projection, stitching"),
    "mmd": (mmd, "what sampled MMD can distinguish (Figure A.1), and what a threshold allows"),
    "bounds": (bounds, "Theorems 5.2.1 to 5.2.3, how loose they are, rollout lengths, Algorithm 2"),
    "cnml": (nml, "normalised maximum likelihood in exact arithmetic (Figures 6.1 and 6.3), regret and its bounds"),
}
