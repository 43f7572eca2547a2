import json
import pickle
from dataclasses import replace

import h5py
import layout_files as files
import layout_forms as forms
import numpy as np
import pytest
from layout_files import ACTIONS, BANDIT, LIBRARIES, WORLD, stacked
from layout_forms import ALIKE, D4RL, TIANSHOU, TORCHRL, flat_file

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import convert, read
from deadreckon.data.spec import Discrete
from deadreckon.errors import UserError

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:minari")


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "minari"))


def opened(source):
    return Dataset.from_dict(source) if isinstance(source, dict) else read(source)


def check(log, world, *, finals=True, whole=True):
    """The transitions of `log` are those of `world`.

    Args:
        log: as it was read.
        world: its episodes.
        finals: what follows a cut-off episode is known; its last transition is missing otherwise.
        whole: the last row of the log is there.
    """
    kept = np.ones(len(stacked(world, "actions")), bool) if finals else ~stacked(world, "truncated")
    kept[-1] &= whole
    rows = np.flatnonzero(log.usable)
    terminal = stacked(world, "terminated")[kept]
    np.testing.assert_array_equal(log.observations[rows], stacked(world, "observations")[kept])
    np.testing.assert_array_equal(log.actions[rows], stacked(world, "actions")[kept])
    np.testing.assert_array_equal(log.rewards[rows], stacked(world, "rewards")[kept])
    np.testing.assert_array_equal(log.terminals[rows], terminal)
    following = log.next_observations_at(rows)
    np.testing.assert_array_equal(following[~terminal], stacked(world, "next_observations")[kept][~terminal])
    if log.successors is not None:
        raise AssertionError("next observations are those of the next rows, and need no column of their own")
    number = np.repeat(np.arange(len(world)), [len(e.actions) for e in world])[kept]
    np.testing.assert_array_equal(np.diff(log.episode_of[rows]) != 0, np.diff(number) != 0)
    assert log.action_space == Discrete(ACTIONS)


@pytest.mark.parametrize("library", LIBRARIES)
def test_twelve_layouts_give_the_same_rounds(library, tmp_path):
    write, _, _ = LIBRARIES[library]
    log = opened(write(BANDIT, tmp_path))
    check(log, BANDIT, whole=library != "CORL")  # D4RL's function leaves the last row of a file out
    assert log.terminals.all()
    if library not in ("Minari", "CORL"):
        assert log.warnings[0].startswith(f"read as {library}'s layout: ")
    if library in ("RLlib", "Open Bandit", "VW"):
        np.testing.assert_allclose(log.extras["behavior_log_probs"], np.log(stacked(BANDIT, "probabilities")), rtol=1e-6)


@pytest.mark.parametrize("library", [name for name, (_, episodes, _) in LIBRARIES.items() if episodes])
def test_layouts_of_episodes_give_the_same_transitions(library, tmp_path):
    write, _, finals = LIBRARIES[library]
    source = write(WORLD, tmp_path)
    log = opened(source)
    check(log, WORLD, finals=finals)
    if library != "Minari":
        assert log.warnings[0].startswith(f"read as {library}'s layout: ")
        assert log.provenance.extra["layout"] == library
    assert convert(source, tmp_path / "ours.hdf5").fingerprint == log.fingerprint
    assert read(tmp_path / "ours.hdf5", mmap=True).fingerprint == log.fingerprint


@pytest.mark.parametrize("kind", ALIKE)
def test_further_forms_give_the_same_transitions(kind, tmp_path):
    columns = ALIKE[kind]
    check(Dataset.from_dict(columns), WORLD)
    (tmp_path / "log.pickle").write_bytes(pickle.dumps(columns))
    check(read(tmp_path / "log.pickle"), WORLD)
    if not any(isinstance(value, dict) for value in columns.values()):
        np.savez(tmp_path / "log.npz", **columns)
        check(read(tmp_path / "log.npz"), WORLD)


def test_steps_of_dm_env_and_a_dict_of_observations():
    steps = forms.rlds_steps(WORLD)
    kinds = np.where(steps.pop("is_first"), 0, np.where(steps.pop("is_last"), 2, 1))
    seen = steps.pop("observation")
    del steps["is_terminal"]
    log = Dataset.from_dict(
        {**steps, "step_type": kinds, "observation/position": seen[:, :2], "observation/height": seen[:, 2]}
    )
    assert log.provenance.extra["observation_names"] == ["height", "position[0]", "position[1]"]
    check(Dataset.from_dict({**steps, "step_type": kinds, "observation": {"a": seen[:, :1], "b": seen[:, 1:]}}), WORLD)


def test_a_buffer_that_has_been_written_around_its_end():
    fields = files.sb3_fields(WORLD, spare=0)
    moved = {key: np.roll(column, 3, 0) for key, column in fields.items() if isinstance(column, np.ndarray)}
    check(Dataset.from_dict({**moved, "pos": 3, "full": True}), WORLD)
    with pytest.raises(UserError, match="the last rows are all zeros, as rows that a replay buffer has not filled yet are"):
        Dataset.from_dict({key: column for key, column in files.sb3_fields(WORLD).items() if key not in ("pos", "full")})
    with pytest.raises(UserError, match="the replay buffer is empty"):
        Dataset.from_dict({**fields, "pos": 0})
    one = flat_file({**D4RL, "done": "dones", "truncated": "timeouts"})
    check(Dataset.from_dict(one), WORLD)
    moved = {
        key: np.roll(column, 4, 0)
        for key, column in flat_file({**TIANSHOU, "terminated": "terminated", "truncated": "truncated"}).items()
    }
    check(Dataset.from_dict({**moved, "_size": 14, "_index": 4}), WORLD)
    spare = {key: np.concatenate([np.roll(column, -4, 0), column[:2]]) for key, column in moved.items()}
    check(Dataset.from_dict({**spare, "_size": 14, "_insertion_idx": 14}), WORLD)


def lean_sb3(size, observed=lambda column: column):
    """The two environments of `WORLD` after `ReplayBuffer.add` of Stable-Baselines3 with `optimize_memory_usage`."""
    names = {"actions": "actions", "rewards": "rewards", "dones": "terminated"}
    steps = {name: np.stack(np.split(stacked(WORLD, key), 2), 1) for name, key in names.items()}
    now, after = (observed(np.stack(np.split(stacked(WORLD, f"{key}observations"), 2), 1)) for key in ("", "next_"))
    fields = {name: np.zeros((size, *column.shape[1:]), column.dtype) for name, column in steps.items()}
    fields["observations"] = np.zeros((size, *now.shape[1:]), now.dtype)
    for step in range(7):
        fields["observations"][step % size] = now[step]
        fields["observations"][(step + 1) % size] = after[step]
        for name, column in steps.items():
            fields[name][step % size] = column[step]
    made = {"timeouts": np.zeros((size, 2)), "pos": 7 % size, "full": size <= 7, "optimize_memory_usage": True}
    return now, after, fields | made


@pytest.mark.parametrize(("size", "first"), [(6, 2), (7, 1), (8, 0), (10, 0)])
def test_a_buffer_that_keeps_no_next_observations_ends_with_the_one_written_last(size, first):
    now, after, fields = lean_sb3(size)
    log = Dataset.from_dict(fields)
    rows = lambda column: np.concatenate(list(np.swapaxes(column[first:], 0, 1)))  # noqa: E731
    going = ~log.terminals
    np.testing.assert_array_equal(log.observations, rows(now))
    np.testing.assert_array_equal(log.next_observations_at(np.flatnonzero(going)), rows(after)[going])
    np.testing.assert_array_equal(log.rewards, stacked(WORLD, "rewards").reshape(2, 7)[:, first:].reshape(-1))
    assert log.usable.all()
    del fields["optimize_memory_usage"]  # then the newest observation may be that of the oldest row
    alone = Dataset.from_dict(fields)
    np.testing.assert_array_equal(alone.observations, log.observations)
    assert alone.dropped == 2
    assert len(Dataset.from_dict(fields | {"optimize_memory_usage": False})) == min(2 * size, 14)


def test_the_last_discrete_observation_of_such_a_buffer_is_one_hot():
    _, after, fields = lean_sb3(6, lambda column: column[..., :1].astype(np.int64) % 4)
    log = Dataset.from_dict(fields | {"observation_space": {"n": np.int64(4)}})
    np.testing.assert_array_equal(log.next_observations_at(np.array([4, 9])), np.eye(4)[after[6, :, 0]])


def test_discrete_observations_of_a_pickled_buffer_are_one_hot():
    fields = files.sb3_fields(WORLD)
    for key in ("observations", "next_observations"):
        fields[key] = fields[key][..., :1].astype(np.int64) % 4 + 1
    log = Dataset.from_dict({**fields, "observation_space": {"n": np.int64(4), "start": np.int64(1)}})
    number = stacked(WORLD, "observations")[:, 0].astype(int) % 4
    np.testing.assert_array_equal(log.observations, np.eye(4)[number])
    assert log.provenance.extra["observation_names"] == [f"observation={level}" for level in (1, 2, 3, 4)]


def test_buffers_without_next_observations_know_those_of_the_rows_below():
    columns = flat_file({**TIANSHOU, "terminated": "terminated", "truncated": "truncated"})
    del columns["obs_next"]
    check(Dataset.from_dict(columns), WORLD, finals=False)
    two = {"_offset": np.array([0, 7]), "_lengths": np.array([7, 7]), "last_index": np.array([6, 13])}
    columns["truncated"] = np.zeros(14, bool)  # then the rings' ends alone cut
    log = Dataset.from_dict({**columns, **two})
    assert log.lengths.tolist() == [3, 4, 2, 5]
    assert log.dropped == 2


def test_batches_of_torchrl_without_their_padding():
    columns = flat_file({"observations": "observation", "actions": "action"})
    nested = flat_file(
        {"rewards": "reward", "next_observations": "observation", "terminated": "terminated", "truncated": "truncated"}
    )
    fill = lambda column: np.stack([np.concatenate([part, part[:2]]) for part in np.split(column, 2)])  # noqa: E731
    batch = {key: fill(column) for key, column in columns.items()}
    inner = {key: fill(column) for key, column in nested.items()}
    mask = np.tile(np.arange(9) < 7, (2, 1))
    inner["reward"] = inner["reward"][..., None]
    inner["truncated"][:, 6] = False  # the end of each batch cuts
    check(Dataset.from_dict({**batch, "next": inner, "collector": {"mask": mask}}), WORLD)


def test_zeros_in_place_of_last_observations_count_as_unknown():
    columns = flat_file({**TORCHRL, "terminated": "next/terminated", "truncated": "next/truncated"})
    columns["next.observation"][stacked(WORLD, "done")] = 0
    log = Dataset.from_dict(columns)
    check(log, WORLD, finals=False)
    assert any("are all zeros, as in TorchRL's data sets, and count as unknown" in line for line in log.warnings)


def test_rows_that_are_not_together_are_put_together():
    columns = flat_file({"observations": "obs", "actions": "actions", "rewards": "rewards", "next_observations": "new_obs",
                         "terminated": "terminateds"}, {"eps_id": files.identifiers(WORLD)})  # fmt: skip
    columns["t"] = np.concatenate([np.arange(len(e.actions)) for e in WORLD])
    mixed = np.argsort(columns["t"], kind="stable")
    log = Dataset.from_dict({key: column[mixed] for key, column in columns.items()})
    check(log, WORLD)
    assert "rows are put together by eps_id, which they were not" in log.warnings


def test_ogbench_tasks_may_end_inside_a_trajectory():
    columns = {**forms.ogbench_compact(WORLD)}
    columns["masks"] = columns["masks"].copy()
    columns["masks"][5] = 0
    log = Dataset.from_dict(columns)
    assert log.lengths.tolist() == [3, 2, 2, 2, 5]
    assert any("in 1 of 14 rows the task ended (masks) inside a trajectory (terminals)" in line for line in log.warnings)


def test_done_alone_is_what_it_is_said_to_be():
    for columns in (flat_file({**D4RL, "done": "dones"}), flat_file({**TIANSHOU, "done": "done"})):
        ended = Dataset.from_dict(columns, done="terminals")
        np.testing.assert_array_equal(ended.terminals, stacked(WORLD, "done"))
        cut = Dataset.from_dict(columns, done="timeouts")
        assert not cut.terminals.any()
        assert cut.lengths.tolist() == ended.lengths.tolist() == [3, 4, 2, 5]
        with pytest.raises(UserError, match='done is \'ends\', "terminals" or "timeouts" is needed'):
            Dataset.from_dict(columns, done="ends")


def test_names_of_our_own_stay_as_they_are():
    columns = flat_file({**D4RL, "terminated": "terminals", "truncated": "timeouts"}, {"goal": np.ones((14, 2))})
    log = Dataset.from_dict(columns)
    check(log, WORLD)
    assert log.warnings == ()
    assert log.provenance.path is None
    assert log.fingerprint == Dataset.from_arrays(**columns).fingerprint


def test_action_masks_are_obeyed_and_costs_are_kept(tmp_path):
    legal = np.eye(ACTIONS, dtype=bool)[stacked(WORLD, "actions")] | (np.arange(ACTIONS) == 1)
    columns = flat_file({**TIANSHOU, "terminated": "terminated", "truncated": "truncated"})
    columns["obs"] = {"obs": columns["obs"], "mask": legal, "agent_id": np.zeros(14)}
    following = np.roll(legal, -1, 0)
    columns["obs_next"] = {"obs": columns["obs_next"], "mask": following}
    seen = {"observations": stacked(WORLD, "observations"), "action_mask": legal}
    theirs = flat_file({"actions": "actions", "rewards": "rewards", "terminated": "terminateds", "truncated": "truncateds"})
    after = {"observations": stacked(WORLD, "next_observations"), "action_mask": following}
    for log in (Dataset.from_dict(columns), Dataset.from_dict({**theirs, "obs": seen, "new_obs": after})):
        final = log.final_observations[:, :-ACTIONS]
        plain = replace(log, observations=log.observations[:, :-ACTIONS], final_observations=final)
        check(replace(plain, action_space=Discrete(ACTIONS)), WORLD)
        np.testing.assert_array_equal(log.observations[:, -ACTIONS:], legal)
        np.testing.assert_array_equal(log.final_observations[:, -ACTIONS:], following[log.ends])
        assert log.action_space == Discrete(ACTIONS, masked=True)
        assert any("says which actions are legal and becomes the end of the observations" in line for line in log.warnings)
    costs = read(files.by_dsrl(WORLD, tmp_path))
    assert costs.extras["costs"].tolist() == list(range(14))
    assert Dataset.from_dict(files.by_open_bandit(BANDIT, None)).extras["position"].tolist() == [0, 1, 2, 0, 1, 2]


def test_buffers_in_pickles_run_nothing(tmp_path):
    path = files.by_sb3(WORLD, tmp_path)
    data = path.read_bytes()
    path.write_bytes(data.replace(b"stable_baselines3.common.buffers", b"stable_baselines3.common.Xuffers"))
    with pytest.raises(UserError, match="refused: the pickle asks for stable_baselines3.common.Xuffers.ReplayBuffer"):
        read(path)


def test_a_layout_of_another_library_is_not_memory_mapped(tmp_path):
    path = files.by_torchrl(WORLD, tmp_path)
    with pytest.raises(UserError, match="it has TorchRL's layout, so it cannot be memory-mapped"):
        read(path, mmap=True)
    with h5py.File(path, "a") as file:
        del file["next/reward"]
    with pytest.raises(UserError, match="no column actions"):
        read(path)


@pytest.mark.parametrize("ids", [["ep0", "ep1"], [2**64, 2**64 + 1], [2**63 - 1, 2**63], [2**63, "b"]])
def test_names_of_episodes_may_be_texts_and_integers_of_any_size(ids, tmp_path):
    path = tmp_path / "output-1.json"
    batch = {"obs": [[0.5], [1.5]] * 2, "actions": [0, 1] * 2, "rewards": [1.0] * 4, "eps_id": [ids[0]] * 2 + [ids[1]] * 2}
    path.write_text((json.dumps(batch) + "\n") * 2)
    log = read(path)
    assert log.lengths.tolist() == [4, 4]
    assert log.rewards.sum() == 8
    path.write_text(json.dumps({**batch, "eps_id": [*batch["eps_id"][:3], None]}))
    with pytest.raises(UserError, match="column eps_id has None in row 3, the name of an episode is a text or an integer"):
        read(path)


@pytest.mark.parametrize("given", ["dict", "npz", "list"])
def test_texts_that_name_episodes_of_rl_unplugged(given, tmp_path):
    path = files.by_rl_unplugged(WORLD, tmp_path)
    source = dict(np.load(path))
    source["episode_id"] = np.array([f"episode {number}" for number in source["episode_id"]])
    if given == "npz":
        np.savez(path, **source)
    elif given == "list":
        source["episode_id"] = source["episode_id"].tolist()
    check(read(path) if given == "npz" else Dataset.from_dict(source), WORLD)
