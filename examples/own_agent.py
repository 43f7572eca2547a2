"""An agent of your own, return-weighted regression, beside imitation of the same log: `python examples/own_agent.py`.

    cd examples && deadreckon train --agent own_agent:RWR --data LOG --steps 20000        (every command takes it by its name)

The page "Your own agent" of the documentation says what each method must do.
"""

import jax
import jax.numpy as jnp

import deadreckon as dr
from deadreckon.data.batch import BatchSpec
from deadreckon.nets.distributions import gaussian_head, log_prob
from deadreckon.nets.mlp import MLP
from deadreckon.nets.optim import apply_gradients, init_opt
from deadreckon.policies.kinds import TanhGaussian
from deadreckon.training.hyperparameters import Positive, Sizes, static


class RWR(dr.agents.Agent):
    """Maximises E[w log pi(a | s)], w = softmax of return to go / temperature over the batch."""

    temperature: Positive = 10.0  # temperature of the weights; smaller is greedier
    lr: Positive = 3e-4  # learning rate of the policy
    hidden: Sizes = static((256, 256))  # width of each hidden layer

    def needs(self, spec):
        return BatchSpec(("observation", "action", "return_to_go"), 256)

    def init(self, spec, key):
        net = MLP.create(spec.observation_size, self.hidden, 2 * spec.action_size, key)
        return net, init_opt(net)  # what is learned: any tree of arrays

    def update(self, state, batch, *, step, key):
        def loss(net):
            weight = jax.nn.softmax(batch.return_to_go / self.temperature)
            return -(weight * log_prob(gaussian_head(net(batch.observation)), jnp.arctanh(batch.action))).sum()

        net, opt = state
        value, grads = jax.value_and_grad(loss)(net)
        return apply_gradients(net, grads, opt, self.lr), {"loss": value}

    def policy(self, state):
        return TanhGaussian(state[0])


def main(rows=100_000, steps=10_000, episodes=20):
    log = dr.read(dr.collect_log("maze2d-umaze-v1", steps=rows))
    for agent in (RWR(), dr.agents.BC()):
        run = dr.train(agent, log, steps=steps, evaluate_every=steps, episodes=episodes)
        print(type(agent).__name__, dr.evaluate(run.policy, "maze2d-umaze", episodes=episodes))


if __name__ == "__main__":
    main()
