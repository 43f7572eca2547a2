"""MMD of a few draws, from a Gaussian or from a uniform over its support, to draws from the Gaussian (thesis Figure A.1)."""

import numpy as np

from deadreckon.theory.discrepancy import figure


def mmd(case: str, *, seed: int, of: str, draws: int, sets: int = 1000) -> dict[str, float]:
    """Root mean square of the sampled MMD over `sets` pairs of sets of draws, BEAR's Gaussian kernel.

    Args:
        case: `alpha=NUMBER`, half the uniform's width in standard deviations.
        seed: of the draws.
        of: `itself`, the Gaussian, or `uniform`.
        draws: in a set.
        sets: pairs of sets.

    Returns:
        mmd: the root mean square.
    """
    (curve,) = figure((float(case.removeprefix("alpha=")),), draws=np.array([draws]), sets=sets, seed=seed)
    return {"mmd": float((curve.self_drawn if of == "itself" else curve.uniform_drawn)[0, 0])}
