"""Worker that proposes designs by BoTorch. Started by design.py with the peer's Python: it never sees our package.

As in BoTorch's tutorials: a `SingleTaskGP` with its usual priors (mixed kernel for categories, known noise where
there are standard errors), and a greedy batch of `qLogNoisyExpectedImprovement`, or the greatest posterior means of
many restarts. Variables are numbers in [0, 1]; whole numbers are relaxed, and rounded by who asks.
"""

import itertools
import time
import warnings
from importlib.metadata import version
from typing import Any

warnings.filterwarnings("ignore")

import protocol  # noqa: E402
import torch  # noqa: E402
from botorch.acquisition.analytic import PosteriorMean  # noqa: E402
from botorch.acquisition.logei import qLogNoisyExpectedImprovement  # noqa: E402
from botorch.fit import fit_gpytorch_mll  # noqa: E402
from botorch.models import MixedSingleTaskGP, SingleTaskGP  # noqa: E402
from botorch.models.transforms import Standardize  # noqa: E402
from botorch.optim import optimize_acqf, optimize_acqf_mixed  # noqa: E402
from gpytorch.mlls import ExactMarginalLogLikelihood  # noqa: E402

RESTARTS, RAW = 4, 64


def fitted(x: torch.Tensor, y: torch.Tensor, noise: torch.Tensor | None, levels: dict[int, int]) -> Any:
    if levels:
        model = MixedSingleTaskGP(x, y, cat_dims=list(levels), train_Yvar=noise, outcome_transform=Standardize(1))
    else:
        model = SingleTaskGP(x, y, train_Yvar=noise, outcome_transform=Standardize(1))
    fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
    return model


def planes(given: list[list[Any]]) -> list[tuple[torch.Tensor, torch.Tensor, float]]:
    return [(torch.tensor(at), torch.tensor(weights, dtype=torch.float64), bound) for at, weights, bound in given]


def propose(asked: dict[str, Any]) -> dict[str, Any]:
    """The designs of a request, and the seconds that the fit and the proposals took."""
    torch.set_num_threads(asked["threads"])
    torch.manual_seed(asked["seed"])
    x, y = (torch.tensor(asked[key], dtype=torch.float64) for key in ("x", "y"))
    noise = None if asked["noise"] is None else torch.tensor(asked["noise"], dtype=torch.float64)[:, None]
    levels, fixed = ({int(k): v for k, v in asked[key].items()} for key in ("levels", "fixed"))
    begun = time.perf_counter()
    model = fitted(x, y[:, None], noise, levels)
    fit_seconds = time.perf_counter() - begun
    bounds = torch.stack([torch.zeros(x.shape[1]), torch.ones(x.shape[1])]).double()
    for column, count in levels.items():
        bounds[1, column] = count - 1
    if asked["acquisition"] == "mean":
        acquisition, batches, q = PosteriorMean(model), asked["n"], 1
    else:
        acquisition, batches, q = qLogNoisyExpectedImprovement(model, x, prune_baseline=True), 1, asked["n"]
    ways = {
        "bounds": bounds, "q": q, "num_restarts": RESTARTS, "raw_samples": RAW,
        "inequality_constraints": planes(asked["at_least"]) or None, "equality_constraints": planes(asked["equal"]) or None,
    }  # fmt: skip
    if asked["acquisition"] == "mean":
        # Every restart's local optimum is a proposal.
        ways |= {"num_restarts": asked["n"], "raw_samples": 16 * asked["n"], "return_best_only": False}
        batches = 1
    found = []
    for _ in range(batches):
        if levels and asked["acquisition"] != "mean":
            each = itertools.product(*(range(count) for count in levels.values()))
            lists = [fixed | dict(zip(levels, map(float, values))) for values in each]
            found.append(optimize_acqf_mixed(acquisition, fixed_features_list=lists, **ways)[0])
        elif levels:
            each = [fixed | dict(zip(levels, map(float, v))) for v in itertools.product(*map(range, levels.values()))]
            parts = [optimize_acqf(acquisition, fixed_features=one, **ways) for one in each]
            every = torch.cat([part[0].reshape(-1, x.shape[1]) for part in parts])
            value = torch.cat([part[1].reshape(-1) for part in parts])
            found.append(every[value.argsort(descending=True)[: asked["n"]]])
        else:
            best, value = optimize_acqf(acquisition, fixed_features=fixed or None, **ways)
            order = value.reshape(-1).argsort(descending=True) if asked["acquisition"] == "mean" else slice(None)
            found.append(best.reshape(-1, x.shape[1])[order])
    seconds = time.perf_counter() - begun - fit_seconds
    return {"x": torch.cat(found).tolist(), "fit": fit_seconds, "search": seconds}


def versions(_: dict[str, Any]) -> dict[str, Any]:
    return {"versions": {name: version(name) for name in ("botorch", "gpytorch", "torch")}}


if __name__ == "__main__":
    protocol.serve({"propose": propose, "versions": versions})
