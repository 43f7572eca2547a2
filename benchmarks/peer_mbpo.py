"""MBPO's parts in PyTorch as one would write them down: an ensemble by batched products, loops over batches. See mbpo.py."""

import copy
import math
import sys
from itertools import pairwise
from typing import Any

import mbpo
import numpy as np
import torch
from mbpo import ACTION, EPOCHS, HELD, MADE_UP, OBSERVATION, ROWS, SLICE
from torch import nn
from torch.nn import functional

MEMBERS, ELITES, BATCH, WIDTH, DECAY = 7, 5, 256, 200, (2.5e-5, 5e-5, 7.5e-5, 7.5e-5, 1e-4)
NUMBERS = OBSERVATION + 1


class Ensemble(nn.Module):
    """Seven networks of four layers: mean and bounded log-variance of the change and the reward, and a logit of an end."""

    def __init__(self) -> None:
        super().__init__()
        sizes = [OBSERVATION + ACTION, WIDTH, WIDTH, WIDTH, WIDTH, 2 * NUMBERS + 1]
        make = lambda i, *shape: nn.Parameter((2 * torch.rand(shape) - 1) / math.sqrt(i))  # noqa: E731
        self.weights = nn.ParameterList([make(i, MEMBERS, i, o) for i, o in pairwise(sizes)])
        self.biases = nn.ParameterList([make(i, MEMBERS, 1, o) for i, o in pairwise(sizes)])
        self.low = nn.Parameter(torch.full((MEMBERS, 1, NUMBERS), -10.0))
        self.high = nn.Parameter(torch.full((MEMBERS, 1, NUMBERS), 0.5))

    def forward(self, x: torch.Tensor, which: Any = slice(None)) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        for k, (w, b) in enumerate(zip(self.weights, self.biases)):
            x = torch.baddbmm(b[which], functional.silu(x) if k else x, w[which])
        mean, log_variance, logit = x[..., :NUMBERS], x[..., NUMBERS:-1], x[..., -1]
        log_variance = self.high[which] - functional.softplus(self.high[which] - log_variance)
        return mean, self.low[which] + functional.softplus(log_variance - self.low[which]), logit

    def loss(self, x: torch.Tensor, target: torch.Tensor, terminal: torch.Tensor) -> torch.Tensor:
        mean, log_variance, logit = self(x)
        nll = 0.5 * ((target - mean).square() * (-log_variance).exp() + log_variance + math.log(2 * math.pi)).sum(-1)
        end = functional.binary_cross_entropy_with_logits(logit, terminal, reduction="none")
        decay = sum(d * w.square().sum() / 2 for d, w in zip(DECAY, self.weights))
        members = len(target)
        return 2 * (nll + end).mean(-1).sum() / target.shape[-1] + 0.01 / members * (self.high - self.low).sum() + decay


def network(inputs: int, outputs: int) -> nn.Module:
    return nn.Sequential(nn.Linear(inputs, 256), nn.ReLU(), nn.Linear(256, 256), nn.ReLU(), nn.Linear(256, outputs))


class SAC:
    """Twin critics, tanh-Gaussian actor, temperature."""

    def __init__(self) -> None:
        self.actor = network(OBSERVATION, 2 * ACTION)
        self.critics = nn.ModuleList([network(OBSERVATION + ACTION, 1) for _ in range(2)])
        self.targets = copy.deepcopy(self.critics).requires_grad_(False)
        self.log_temperature = nn.Parameter(torch.zeros(()))
        lists = self.actor.parameters(), self.critics.parameters(), [self.log_temperature]
        self.opts = [torch.optim.Adam(params, lr=3e-4) for params in lists]

    def act(self, seen: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        mean, log_std = self.actor(seen).chunk(2, -1)
        log_std = log_std.clamp(-5, 2)
        noise = torch.randn_like(mean)
        pre = mean + log_std.exp() * noise
        squash = 2 * (math.log(2) - pre - functional.softplus(-2 * pre))
        return pre.tanh(), (-0.5 * noise.square() - log_std - 0.5 * math.log(2 * math.pi) - squash).sum(-1)

    def least(self, critics: nn.ModuleList, seen: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
        both = torch.cat([seen, action], -1)
        return torch.minimum(*(critic(both)[:, 0] for critic in critics))

    def update(self, seen, action, reward, following, terminal) -> float:
        temperature = self.log_temperature.detach().exp()
        with torch.no_grad():
            done, log_prob = self.act(following)
            value = self.least(self.targets, following, done) - temperature * log_prob
            target = reward + 0.99 * (1 - terminal) * value
        both = torch.cat([seen, action], -1)
        loss = sum((critic(both)[:, 0] - target).square().mean() for critic in self.critics)
        self.step(1, loss)
        done, log_prob = self.act(seen)
        self.critics.requires_grad_(False)
        self.step(0, (temperature * log_prob - self.least(self.critics, seen, done)).mean())
        self.critics.requires_grad_(True)
        self.step(2, -self.log_temperature * (log_prob.detach().mean() - 1.0))
        with torch.no_grad():
            for slow, fast in zip(self.targets.parameters(), self.critics.parameters()):
                slow.lerp_(fast, 0.005)
        return float(loss)

    def step(self, which: int, loss: torch.Tensor) -> None:
        self.opts[which].zero_grad(set_to_none=True)
        loss.backward()
        self.opts[which].step()


def parts() -> dict[str, Any]:
    columns = {name: torch.as_tensor(column) for name, column in mbpo.rows().items()}
    seen, action = columns["observation"], columns["action"]
    inputs = torch.cat([seen, action], 1)
    target = torch.cat([columns["next_observation"] - seen, columns["reward"][:, None]], 1)
    model, sac = Ensemble(), SAC()
    opt = torch.optim.Adam(model.parameters(), lr=1e-3)
    norm: dict[str, torch.Tensor] = {}
    rng = np.random.default_rng(0)

    def fit() -> int:
        order = torch.as_tensor(rng.permutation(ROWS))
        held, train = order[:HELD], order[HELD:]
        norm["mean"], norm["std"] = inputs[train].mean(0), inputs[train].std(0)
        x = (inputs - norm["mean"]) / norm["std"]
        own = train[torch.randint(len(train), (MEMBERS, len(train)))]
        for _ in range(EPOCHS):
            shuffled = own.gather(1, torch.rand(own.shape).argsort(1))
            for rows in shuffled.split(BATCH, 1):
                loss = model.loss(x[rows], target[rows], columns["terminal"][rows])
                opt.zero_grad(set_to_none=True)
                loss.backward()
                opt.step()
            with torch.no_grad():
                errors = (model(x[held].expand(MEMBERS, -1, -1))[0] - target[held]).square().mean((1, 2))
                kept = copy.deepcopy(model.state_dict())
        if not errors.isfinite().all() or not kept:
            raise mbpo.protocol.BenchError("the model's errors in PyTorch are not finite")
        return EPOCHS

    @torch.no_grad()
    def rollout() -> int:
        start = seen[torch.randint(ROWS, (MADE_UP,))]
        done, _ = sac.act(start)
        x = (torch.cat([start, done], 1) - norm["mean"]) / norm["std"]
        order = torch.randperm(MADE_UP)
        mean, log_variance, _ = model(x[order].view(ELITES, -1, x.shape[1]), slice(0, ELITES))
        drawn = (mean + (0.5 * log_variance).exp() * torch.randn_like(mean)).view(MADE_UP, -1)[order.argsort()]
        following, ends = start + drawn[:, :-1], torch.zeros(MADE_UP, 1)
        found = torch.cat([start, done, drawn[:, -1:], following, ends], 1)[drawn.isfinite().all(1)].numpy()
        assert len(found) == MADE_UP
        return 1

    replay = {name: column.numpy() for name, column in columns.items()}

    def update() -> int:
        for _ in range(SLICE):
            rows = rng.integers(ROWS, size=BATCH)
            last = sac.update(*(torch.as_tensor(column[rows]) for column in replay.values()))
        if not math.isfinite(last):
            raise mbpo.protocol.BenchError("SAC's loss in PyTorch is not finite")
        return SLICE

    return {"fit": fit, "rollout": rollout, "update": update}


if __name__ == "__main__":
    torch.set_num_threads(int(sys.argv[1]))
    mbpo.serve(parts())
