"""What may be asked of a case and of a decision, and what is refused before anything is fitted."""

import numpy as np
import pytest

from deadreckon.errors import UserError
from deadreckon.ope import FQE, BehaviorModel, OPEInput
from deadreckon.ope.behavior import out_of_fold
from deadreckon.ope.fits import Fits
from deadreckon.theory import garnet
from tests.ope.worlds import as_policy, tables

TINY = FQE(members=2, hidden=(8,), steps=60, batch_size=16)


def test_fits_that_learn_from_other_episodes_have_other_checkpoints(tmp_path, monkeypatch):
    """Held episodes and clusters say which rows teach the models of a fold; a policy that does the same everywhere does not."""
    world = garnet(states=3, actions=2, ending=0.3)
    log = world.log(tables(world, 1, 0.2)[0], 60, 10, np.random.default_rng(0))
    same = as_policy(np.tile([0.3, 0.7], (3, 1)))
    folders = []

    def stop(self, learner, rows, steps, what, folder):
        folders.append(folder)
        raise InterruptedError

    monkeypatch.setattr(Fits, "_train", stop)
    asked = [{}, {"clusters": np.arange(60) // 4}, {"held": np.arange(30)}, {"held": np.arange(30, 60)}, {}]
    for options in asked:
        case = OPEInput(log, same, discount=0.9, out=tmp_path, **options)
        for fit in (lambda case=case: TINY.out_of_fold(case, 3, 1), lambda case=case: out_of_fold(case, BehaviorModel(), 3)):
            with pytest.raises(InterruptedError):
                fit()
    assert len(set(folders[:-2])) == 8
    assert folders[-2:] == folders[:2]


@pytest.mark.parametrize("held", [[-1], [0, 60], [3, 3], [0.5], np.ones(60, bool), [], [[1]]])
def test_held_episodes_are_different_ones_of_the_log(held):
    """-1 would be judged as the last episode, and teach as one that is not judged."""
    world = garnet(states=3, actions=2, ending=0.3)
    log = world.log(tables(world, 1, 0.2)[0], 60, 10, np.random.default_rng(0))
    with pytest.raises(UserError, match="held must be"):
        OPEInput(log, as_policy(np.full((3, 2), 0.5)), discount=0.9, held=held)
