"""How small BEAR's constraint can get on a log: the MMD between two sets of draws of ONE policy, a clone of the log.

    deadreckon data collect maze2d-umaze-v1 --steps 200000 --out umaze.hdf5
    deadreckon train --agent bc --data umaze.hdf5 --task maze2d-umaze --steps 25000 --seeds 2 \\
        --agent.hidden 64 64 --out runs/umaze-bc
    python evidence/studies/mmd_floor.py runs/umaze-bc umaze.hdf5

A threshold below this floor cannot be met by any policy with the clone's spread, and the multiplier climbs to its cap.
"""

from typing import Annotated

import jax
import jax.numpy as jnp
import numpy as np
import tyro

import deadreckon as dr
from deadreckon.nets import distributions as dist
from deadreckon.nets.mmd import mmd


def main(run: Annotated[str, tyro.conf.Positional], log: Annotated[str, tyro.conf.Positional]) -> None:
    """Prints the floor before and after the tanh, by kernel and number of draws.

    Args:
        run: folder of a finished `bc` run.
        log: what it was learned from.
    """
    policy, data = dr.load_run(run).policy, dr.read(log)
    rows = np.linspace(0, len(data) - 1, 500).astype(int)
    d = dist.gaussian_head(policy.inner.net(policy.view.observe(jnp.asarray(data.observations[rows]))))
    print(f"mean standard deviation before the tanh: {jnp.exp(d.log_std).mean():.1f}")
    for n in (4, 10, 100):
        x, y = (dist.sample(d, jax.random.key(seed), (n,)) for seed in (0, 1))
        for name, squash in (("before", lambda a: a), ("after", jnp.tanh)):
            values = {k: float(mmd(squash(x), squash(y), k).mean()) for k in ("laplacian", "laplacian_l1", "gaussian")}
            print(f"n = m = {n:<3}  {name:<6} the tanh  " + "  ".join(f"{k} {v:.2f}" for k, v in values.items()))


if __name__ == "__main__":
    tyro.cli(main)
