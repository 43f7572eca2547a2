"""A small world, and writers that lay it out exactly as other libraries do; each names the source that it follows."""

import json
import pickle
import sys
import types
from dataclasses import dataclass

import h5py
import minari
import numpy as np
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer

ACTIONS = 3


@dataclass
class Episode:
    """(T + 1, 3) observations, (T,) actions, rewards and probabilities of the logged actions, and whether the task ended."""

    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    terminated: bool
    probabilities: np.ndarray

    @property
    def last(self):
        return np.arange(len(self.actions)) == len(self.actions) - 1


def make_world(lengths, terminated, seed=0):
    rng = np.random.default_rng(seed)
    world = [
        Episode(
            rng.integers(1, 100, (steps + 1, 3)).astype(np.float32) / 8, rng.integers(0, ACTIONS, steps),
            rng.integers(-20, 20, steps).astype(np.float32) / 4, ended, rng.integers(1, 9, steps) / 8,
        )
        for steps, ended in zip(lengths, terminated, strict=True)
    ]  # fmt: skip
    world[0].actions[0] = ACTIONS - 1  # so that the number of actions can be told
    return world


# Two halves of 7 steps, for buffers of two environments that step together; the last episode is cut off, and others too.
WORLD = make_world((3, 4, 2, 5), (True, False, True, False))
BANDIT = make_world((1,) * 6, (True,) * 6, seed=1)


def stacked(world, key):
    """(rows, ...) of all episodes, one after the other."""
    values = {
        "observations": lambda e: e.observations[:-1], "next_observations": lambda e: e.observations[1:],
        "terminated": lambda e: e.last & e.terminated, "truncated": lambda e: e.last & (not e.terminated),
        "done": lambda e: e.last,
    }  # fmt: skip
    return np.concatenate([values[key](e) if key in values else getattr(e, key) for e in world])


def identifiers(world):
    return np.concatenate([np.full(len(e.actions), 100 - index) for index, e in enumerate(world)])


def by_minari(world, tmp_path):
    """minari itself."""
    buffers = [
        EpisodeBuffer(
            observations=e.observations, actions=e.actions, rewards=e.rewards.tolist(),
            terminations=(e.last & e.terminated).tolist(), truncations=(e.last & (not e.terminated)).tolist(),
        )
        for e in world
    ]  # fmt: skip
    box = spaces.Box(-np.inf, np.inf, (3,), np.float32)
    minari.create_dataset_from_buffers(
        "theirs/world-v0", buffer=buffers, observation_space=box, action_space=spaces.Discrete(ACTIONS)
    )
    return "theirs/world-v0"


def by_d3rlpy(world, tmp_path):
    """takuseno/d3rlpy, d3rlpy/dataset/io.py (dump) of episode_generator.py's episodes: no observation after the last row."""
    path = tmp_path / "d3rlpy.h5"
    with h5py.File(path, "w") as file:
        file["columns"] = ["observations", "actions", "rewards", "terminated"]
        file["num_episodes"] = len(world)
        for index, e in enumerate(world):
            file[f"observations_{index}"] = e.observations[:-1]
            file[f"actions_{index}"] = e.actions[:, None]
            file[f"rewards_{index}"] = e.rewards[:, None]
            file[f"terminated_{index}"] = e.terminated
        file["version"] = "2.1"
    return path


def by_rllib(world, tmp_path):
    """ray-project/ray, rllib/offline/json_writer.py without compression; columns of rllib/policy/sample_batch.py."""
    path = tmp_path / "output-2026-01-01_00-00-00_worker-0_0.json"
    columns = {
        "obs": stacked(world, "observations"), "new_obs": stacked(world, "next_observations"),
        "actions": stacked(world, "actions"), "rewards": stacked(world, "rewards"), "prev_rewards": stacked(world, "rewards"),
        "terminateds": stacked(world, "terminated"), "truncateds": stacked(world, "truncated"),
        "action_logp": np.log(stacked(world, "probabilities")), "eps_id": identifiers(world),
        "unroll_id": np.zeros(len(identifiers(world)), int), "infos": np.array([{}] * len(identifiers(world))),
    }  # fmt: skip
    rows = len(columns["actions"])
    with open(path, "w") as file:
        for batch in np.array_split(np.arange(rows), 3):
            file.write(json.dumps({"type": "SampleBatch", **{key: c[batch].tolist() for key, c in columns.items()}}) + "\n")
    return tmp_path


class ReplayBuffer:
    """Stands for Stable-Baselines3's, of which a pickle keeps the fields."""


def sb3_fields(world, spare=3):
    """DLR-RM/stable-baselines3, stable_baselines3/common/buffers.py (ReplayBuffer): (buffer_size, n_envs, ...), first zeros."""

    def filled(key, dtype, shape=()):
        halves = np.stack(np.split(stacked(world, key).reshape(-1, *shape), 2), 1)
        out = np.zeros((len(halves) + spare, *halves.shape[1:]), dtype)
        out[: len(halves)] = halves
        return out

    fields = {
        "observations": filled("observations", np.float32, (3,)),
        "next_observations": filled("next_observations", np.float32, (3,)),
        "actions": filled("actions", np.int64, (1,)),
        "rewards": filled("rewards", np.float32),
        "dones": filled("done", np.float32),
        "timeouts": filled("truncated", np.float32),
    }
    return {**fields, "pos": len(fields["dones"]) - spare, "full": False}


def by_sb3(world, tmp_path):
    """`save_to_pkl`: the buffer as an object, with its spaces, at the highest protocol."""
    path = tmp_path / "buffer.pkl"
    buffer = ReplayBuffer()
    space = spaces.Box(-1, 1, (3,), np.float32)
    space.seed(0)  # its generator of random numbers is pickled with it
    vars(buffer).update(
        sb3_fields(world), observation_space=space, action_space=spaces.Discrete(ACTIONS), obs_shape=(3,), n_envs=2,
        handle_timeout_termination=True,
    )  # fmt: skip
    # Pickles name the module of a class; that of the library is not installed here.
    name = "stable_baselines3.common.buffers"
    ReplayBuffer.__module__ = name
    names = [name.rsplit(".", count)[0] for count in range(name.count(".") + 1)]
    sys.modules |= {each: types.ModuleType(each) for each in names}
    sys.modules[name].ReplayBuffer = ReplayBuffer
    try:
        path.write_bytes(pickle.dumps(buffer, pickle.HIGHEST_PROTOCOL))
    finally:
        for each in names:
            del sys.modules[each]
    return path


def by_tianshou(world, tmp_path):
    """thu-ml/tianshou, data/utils/converter.py (to_hdf5) of data/buffer/manager.py: two rings of 10 rows, 7 (or 3) filled."""
    path = tmp_path / "tianshou.hdf5"
    columns = {
        "obs": stacked(world, "observations"), "act": stacked(world, "actions"), "rew": stacked(world, "rewards").astype(float),
        "terminated": stacked(world, "terminated"), "truncated": stacked(world, "truncated"), "done": stacked(world, "done"),
        "obs_next": stacked(world, "next_observations"),
    }  # fmt: skip
    half = len(columns["act"]) // 2
    with h5py.File(path, "w") as file:
        group = file.create_group("_meta")
        group.attrs["__data_type__"] = "Batch"
        for key, column in columns.items():
            out = np.zeros((20, *column.shape[1:]), column.dtype)
            out[:half], out[10 : 10 + half] = column[:half], column[half:]
            group[key] = out
            group[key].attrs["__data_type__"] = "ndarray"
        group.create_group("info").attrs["__data_type__"] = "Batch"
        file.create_group("options").attrs["stack_num"] = 1
        file["buffers"] = np.frombuffer(pickle.dumps("the rings as objects"), np.uint8)
        for key, value in {"_offset": [0, 10], "_lengths": [half, half], "last_index": [half - 1, 9 + half],
                           "_indices": np.arange(20)}.items():  # fmt: skip
            file[key] = np.asarray(value)
        file.attrs.update({"maxsize": 20, "buffer_num": 2, "_size": 0, "_index": 0})
    return path


def by_torchrl(world, tmp_path):
    """pytorch/rl: a collector's flat tensordict (docs, Data layout), one-hot actions, in the groups of PersistentTensorDict."""
    path = tmp_path / "torchrl.h5"
    rows = len(identifiers(world))
    with h5py.File(path, "w") as file:
        file["observation"] = stacked(world, "observations")
        file["action"] = np.eye(ACTIONS, dtype=np.int64)[stacked(world, "actions")]
        for key in ("done", "terminated", "truncated"):
            file[key] = np.zeros((rows, 1), bool)  # of the state before the step
            file[f"next/{key}"] = stacked(world, key)[:, None]
        file["next/observation"] = stacked(world, "next_observations")
        file["next/reward"] = stacked(world, "rewards")[:, None]
        file["collector/traj_ids"] = identifiers(world)
    return path


def by_ogbench(world, tmp_path):
    """seohongpark/ogbench, ogbench/utils.py (load_dataset, regular): `terminals` end trajectories, whatever ended them."""
    path = tmp_path / "ogbench.npz"
    np.savez(
        path, observations=stacked(world, "observations"), next_observations=stacked(world, "next_observations"),
        actions=stacked(world, "actions"), terminals=stacked(world, "done").astype(np.float32),
        rewards=stacked(world, "rewards"), masks=1 - stacked(world, "terminated").astype(np.float32),
    )  # fmt: skip
    return path


def by_rl_unplugged(world, tmp_path):
    """google-deepmind/deepmind-research, rl_unplugged/atari.py: transitions, `d_t` the discount after the action."""
    path = tmp_path / "atari.npz"
    np.savez(
        path, o_t=stacked(world, "observations"), a_t=stacked(world, "actions").astype(np.int32), r_t=stacked(world, "rewards"),
        d_t=1 - stacked(world, "terminated").astype(np.float32), o_tp1=stacked(world, "next_observations"),
        a_tp1=np.roll(stacked(world, "actions"), -1), episode_id=identifiers(world).astype(np.uint64),
        episode_return=np.zeros(len(identifiers(world)), np.float32),
    )  # fmt: skip
    return path


def by_dsrl(world, tmp_path):
    """liuzuxin/DSRL, dsrl/offline_env.py (get_dataset): D4RL's columns and `costs`."""
    path = tmp_path / "dsrl.hdf5"
    with h5py.File(path, "w") as file:
        for key in ("observations", "next_observations", "actions", "rewards"):
            file[key] = stacked(world, key)
        file["costs"] = np.arange(len(identifiers(world)), dtype=np.float32)
        file["terminals"] = stacked(world, "terminated")
        file["timeouts"] = stacked(world, "truncated")
    return path


def by_open_bandit(world, tmp_path):
    """st-tech/zr-obp, obp/dataset/real.py (obtain_batch_bandit_feedback)."""
    rows = len(identifiers(world))
    return {
        "n_rounds": rows, "n_actions": ACTIONS, "action": stacked(world, "actions"), "position": np.arange(rows) % 3,
        "reward": stacked(world, "rewards"), "pscore": stacked(world, "probabilities"),
        "context": stacked(world, "observations"), "action_context": np.ones((ACTIONS, 4)),
    }  # fmt: skip


def by_vw(world, tmp_path):
    """VowpalWabbit/vowpal_wabbit wiki (Input format, Logged Contextual Bandit Example): actions from 1, costs."""
    path = tmp_path / "log.vw"
    lines = []
    for e in world:
        (x, y, z), p = e.observations[0].tolist(), e.probabilities[0]
        lines.append(f"{e.actions[0] + 1}:{-e.rewards[0]}:{p} tag|user x:{x} y:{y} |item:0.5 z:{2 * z}\n")
    path.write_text("".join(lines))
    return path


def by_corl(world, tmp_path):
    """Farama-Foundation/D4RL, d4rl/__init__.py (qlearning_dataset), as tinkoff-ai/CORL takes it: the last row of the file and
    those that a time limit ends are left out, and the next observation of a terminal row is that of the next row."""
    path = tmp_path / "corl.npz"
    kept = ~stacked(world, "truncated")
    kept[-1] = False
    observations = stacked(world, "observations")
    np.savez(
        path, observations=observations[kept], next_observations=np.roll(observations, -1, 0)[kept],
        actions=stacked(world, "actions")[kept], rewards=stacked(world, "rewards")[kept],
        terminals=stacked(world, "terminated")[kept],
    )  # fmt: skip
    return path


# What writes each, whether it holds several steps, and whether it holds what followed the last row of a cut-off episode.
LIBRARIES = {
    "Minari": (by_minari, True, True), "d3rlpy 2": (by_d3rlpy, True, False), "RLlib": (by_rllib, True, True),
    "Stable-Baselines3": (by_sb3, True, True), "Tianshou": (by_tianshou, True, True), "TorchRL": (by_torchrl, True, True),
    "OGBench": (by_ogbench, True, True), "RL Unplugged (Atari)": (by_rl_unplugged, True, True), "DSRL": (by_dsrl, True, True),
    "CORL": (by_corl, True, False), "Open Bandit": (by_open_bandit, False, False), "VW": (by_vw, False, False),
}  # fmt: skip
