"""An estimator of your own: the reward of the nearest logged steps, compared with the truth where it is known.

    python examples/own_estimator.py

It is a function of a log, policies and a discount that gives one value per policy. The table compares it with one of the
package's by DOPE's protocol: eleven policies of Hopper whose true values are known. Page of the documentation: Off-policy
evaluation.
"""

import numpy as np
from scipy.spatial import KDTree

import deadreckon as dr


def nearest(data: dr.Dataset, policies, discount: float) -> list[float]:
    """Mean reward of the logged steps whose observation and action are nearest to what the policy does, as if it went on."""
    rows = np.random.default_rng(0).choice(len(data), min(len(data), 2_000), replace=False)
    seen, done = np.asarray(data.observations)[rows], np.asarray(data.actions)[rows]
    tree = KDTree(np.column_stack([seen / seen.std(0), done]))
    values = []
    for policy in policies:
        _, found = tree.query(np.column_stack([seen / seen.std(0), policy(seen)]))
        values.append(float(np.asarray(data.rewards)[rows][found].mean() / (1.0 - discount)))
    return values


def main(kinds=("medium", "expert"), steps=100_000, out="runs/own-estimator"):
    results = dr.dope([nearest, "is"], tasks=["hopper"], kinds=kinds, log_steps=steps, out=out)
    for metric in ("absolute_error", "rank_correlation", "regret"):
        print(dr.ope.dope.markdown(results, metric), end="\n\n")


if __name__ == "__main__":
    main()
