"""NEMO in PyTorch as one would write it down: a loop over the models, an optimiser each. Imported by the peer's worker."""

import copy
import math
from collections.abc import Callable
from typing import Any

import protocol
import torch
from torch import nn
from torch.nn import functional


def network(width: int) -> nn.Module:
    size = protocol.NEMO["size"]
    layers = nn.Linear(size, width), nn.Softplus(), nn.Linear(width, width), nn.Softplus(), nn.Linear(width, 1)
    return nn.Sequential(*layers)


def learner(opts: dict[str, Any]) -> Callable[[int], int]:
    """A callable that makes so many updates: of every model on the batch and a claimed design, then of all designs."""
    x, y = (torch.as_tensor(part, dtype=torch.float32) for part in protocol.synthetic_designs(opts))
    bins, batch = protocol.NEMO["bins"], opts["batch"]
    edges = torch.arange(1, bins) / bins
    models = [network(opts["width"]) for _ in range(bins)]
    scales = [nn.Parameter(torch.tensor(math.log(0.1))) for _ in models]
    targets = [copy.deepcopy(model).requires_grad_(False) for model in models]
    optimisers = [torch.optim.Adam([*m.parameters(), s], lr=0.005) for m, s in zip(models, scales)]
    designs = x[torch.argsort(y)[-protocol.NEMO["designs"] :]].clone().requires_grad_()
    rising = torch.optim.Adam([designs], lr=0.1)

    def loss(k: int, inputs: torch.Tensor, label: torch.Tensor) -> torch.Tensor:
        argument = (models[k](inputs) - edges) / scales[k].exp()
        above = (torch.arange(1, bins) <= label[:, None]).float()
        return functional.binary_cross_entropy_with_logits(argument, above, reduction="none").sum(-1)

    def update() -> float:
        rows = torch.randint(len(x), (batch,))
        inputs, label = x[rows], (y[rows] * bins).long().clamp(0, bins - 1)
        claimed = designs.detach()[torch.randint(len(designs), (1,))]
        for k in range(bins):
            total = loss(k, inputs, label).mean() + loss(k, claimed, torch.tensor([k]))[0] / len(x)
            optimisers[k].zero_grad(set_to_none=True)
            total.backward()
            optimisers[k].step()
            with torch.no_grad():
                for slow, fast in zip(targets[k].parameters(), models[k].parameters()):
                    slow.lerp_(fast, 0.05)
        worth = torch.stack([target(designs)[:, 0] for target in targets]).mean(0)
        rising.zero_grad(set_to_none=True)
        (-worth.sum()).backward()
        rising.step()
        return float(total)

    def run(updates: int) -> int:
        for _ in range(updates):
            last = update()
        if not math.isfinite(last):
            raise protocol.BenchError("NEMO's loss in PyTorch is not finite")  # its speed would not be the real one
        return updates

    return run
