import gzip
import json

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import pytest
from small_logs import images, make_log, same

from deadreckon.data.dataset import Dataset
from deadreckon.data.formats.io import convert, read
from deadreckon.data.formats.npz import read_npz, write_npz
from deadreckon.data.formats.spread import to_table
from deadreckon.data.formats.tables import write_csv, write_parquet
from deadreckon.errors import UserError


@pytest.mark.parametrize("ending", ["parquet", "npz"])
def test_a_log_comes_back_exactly(variant, tmp_path, ending):
    path = tmp_path / f"log.{ending}"
    {"parquet": write_parquet, "npz": write_npz}[ending](variant, path)
    again = read(path)
    same(variant, again)
    assert again.fingerprint == variant.fingerprint
    assert again.name == variant.name


@pytest.mark.parametrize("extra", ["reward", "terminal", "episode", "final_observation_0"])
def test_a_column_that_would_be_another_in_a_table_is_refused(extra, tmp_path):
    """It would be read back as the log's reward, and the reward would be lost."""
    rows = np.arange(6, dtype=np.float32)
    log = Dataset.from_arrays(
        observations=rows[:, None], actions=rows[:, None] / 10, rewards=rows, terminals=rows == 5, name="a", **{extra: rows + 7}
    )
    for path in (tmp_path / "a.csv", tmp_path / "a.parquet"):
        with pytest.raises(UserError, match=f"column {extra} would be the table's column {extra}"):
            (write_csv if path.suffix == ".csv" else write_parquet)(log, path)
        assert not path.exists()


def test_a_number_behind_a_name_of_ours_is_ambiguous(tmp_path):
    (tmp_path / "a.csv").write_text("observation_0,action,reward,reward_1\n0.5,0.1,1,99\n0.6,0.2,2,98\n")
    with pytest.raises(UserError, match="there are columns reward and reward_1"):
        read(tmp_path / "a.csv")
    (tmp_path / "b.csv").write_text("observation_0,action,reward,goal,goal_1\n0.5,0.1,1,99,3\n0.6,0.2,2,98,4\n")
    log = read(tmp_path / "b.csv")
    assert (log.extras["goal"].tolist(), log.extras["goal_1"].tolist()) == ([99, 98], [3, 4])


def test_an_empty_text_is_missing_in_csv_as_in_parquet(tmp_path):
    (tmp_path / "a.csv").write_text("x,arm,r\n1,l,0\n2,,1\n3,r,1\n")
    with pytest.raises(UserError, match="column arm is empty in row 1"):
        read(tmp_path / "a.csv", action="arm", reward="r")
    (tmp_path / "b.csv").write_text("site,arm,r\na,l,0\n,l,1\nb,r,1\n")
    log = read(tmp_path / "b.csv", action="arm", reward="r")
    assert log.provenance.extra["observation_names"] == ["site=a", "site=b", "site_missing"]
    assert any("missing values in 1 of 3 rows" in text for text in log.warnings)


def test_csv_brings_back_the_values(variant, tmp_path):
    write_csv(variant, tmp_path / "log.csv")
    again = read(tmp_path / "log.csv")
    for key in variant.extras:
        np.testing.assert_array_equal(np.float32(again.extras[key]), np.float32(variant.extras[key]))
    same_but_extras = {"extras": variant.extras, "name": variant.name, "action_space": variant.action_space}
    same(variant, type(again)(**{**vars_of(again), **same_but_extras}))


def vars_of(log):
    return {key: getattr(log, key) for key in log.__dataclass_fields__}


def test_csv_keeps_every_bit_of_a_float32(tmp_path):
    rng = np.random.default_rng(0)
    bits = rng.integers(0, 2**32, 40_000, np.uint64).astype(np.uint32).view(np.float32)
    bits = bits[np.isfinite(bits)]
    log = Dataset.from_arrays(observations=bits, actions=np.arange(len(bits)) % 2, rewards=bits)
    write_csv(log, tmp_path / "log.csv")
    again = read(tmp_path / "log.csv")
    np.testing.assert_array_equal(again.rewards, bits)
    np.testing.assert_array_equal(again.observations[:, 0], bits)


def test_one_continuous_action_stays_one_though_its_values_are_whole(tmp_path):
    log = Dataset.from_arrays(observations=np.zeros((3, 1)), actions=np.array([[0.0], [1.0], [0.0]]), rewards=np.zeros(3))
    write_csv(log, tmp_path / "log.csv")
    again = read(tmp_path / "log.csv")
    assert again.actions.shape == (3, 1)
    assert again.actions.dtype == np.float32


def test_pictures(tmp_path):
    for write, ending in ((write_parquet, "parquet"), (write_npz, "npz")):
        write(images(), tmp_path / f"log.{ending}")
        assert read(tmp_path / f"log.{ending}").fingerprint == images().fingerprint
    with pytest.raises(UserError, match=r"do not fit into CSV; write .hdf5 or .parquet"):
        write_csv(images(), tmp_path / "log.csv")
    assert not (tmp_path / "log.csv").exists()


def test_gzipped_csv_and_episodes_without_flags(tmp_path):
    text = "episode,observation_0,observation_1,action,reward\n7,1,2,0,1\n7,3,4,1,0\n3,5,6,0,1\n"
    (tmp_path / "log.csv.gz").write_bytes(gzip.compress(text.encode()))
    log = read(tmp_path / "log.csv.gz")
    assert log.name == "log"
    assert log.lengths.tolist() == [2, 1]
    assert log.actions.tolist() == [0, 1, 0]
    assert log.dropped == 2
    whole = gzip.compress(("x,y\n" + text * 500).encode())
    (tmp_path / "log.csv.gz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(UserError, match="damaged or cut short"):
        read(tmp_path / "log.csv.gz")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "a,b\n1,2\n",
            "no column is the reward by its name; name the columns: --reward COLUMN .*columns: a, b.",
        ),
        (
            "x,y,z\n1,2,3\n",
            "no column is the action or the reward by its name; name the columns: --action COLUMN --reward COLUMN ",
        ),
        ("observation_0,action\n1,2\n", "no column is the reward by its name; name the columns: --reward COLUMN "),
        ("observation_0,action,reward\n1,0,1\nx,0,1\n", "column observation_0 holds string, numbers are needed; name"),
        ("observation_0,action,reward\n1,0,1\n2,0,\n", "column reward is empty in row 1"),
        ("observation_0,action,reward\n1,0,1\n2,0,nan\n", "column reward is empty in row 1"),
        ("observation_0,action,reward\n1,0,1\n2,0\n", "line 3 has 2 cells, the line of names has 3: '2,0'"),
        ("observation_0,action,reward\n", "the log has no rows"),
        ("observation_0,action,reward,terminal\n1,0,1,3\n", "column terminals has 3 in row 0, 0 or 1 is needed"),
        ("episode,observation_0,action,reward\n1,1,0,1\n2,1,0,1\n1,1,0,1\n", "rows of episode 1 are not together .row 2"),
    ],
)
def test_bad_csv_is_told_in_one_line(tmp_path, text, words):
    path = tmp_path / "log.csv"
    path.write_text(text)
    with pytest.raises(UserError, match=words) as caught:
        read(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_empty_rewards_are_told_by_action(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("x,arm,paid\n1,a,1\n2,b,\n3,b,\n4,a,\n5,a,2\n")
    with pytest.raises(UserError, match=r"paid is empty in row 1 and 2 more \(33% of the rows of a, 100% of the rows of b\):"):
        read(path, action="arm", reward="paid")
    path.write_text("x,arm,paid\n1,a,1\n2,b,\n")
    with pytest.raises(UserError, match="paid is empty in row 1: a reward that is not known may be unlike the others"):
        read(path, action="arm", reward="paid")


def test_mapped_columns(tmp_path):
    path = tmp_path / "clicks.csv"
    path.write_text("user,arm,click,p\na,x,1,0.5\nb,y,0,0.25\n")
    log = read(path, action="arm", reward="click", propensity="p")
    assert log.name == "clicks"
    assert log.provenance.path == str(path)
    assert log.provenance.extra["action_levels"] == ["x", "y"]
    assert log.terminals.all()
    with pytest.raises(UserError, match=f"^{path}: unknown column 'clic': did you mean click?"):
        read(path, action="arm", reward="clic")
    with pytest.raises(UserError, match=f"^{path}: no column is the reward by its name"):
        read(path, action="arm")
    with pytest.raises(UserError, match="unknown option 'rewards': did you mean reward"):
        read(path, action="arm", rewards="click")
    path.write_text("user,arm,click,p\na,x,1,0.5\nb,y,0,1.5\n")
    with pytest.raises(UserError, match=f"^{path}: column p has 1.5 in row 1, a probability"):
        read(path, action="arm", reward="click", propensity="p")


def test_a_table_with_next_observations(tmp_path):
    log = make_log((3, 2))
    table = to_table(log)
    for index in range(3):
        table = table.append_column(f"next_observation_{index}", pa.array(log.next_observations[:, index]))
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    same(log, read(tmp_path / "log.parquet"))


def test_damaged_files(log, tmp_path):
    for write, reader, name in ((write_parquet, read, "log.parquet"), (write_npz, read_npz, "log.npz")):
        path = tmp_path / name
        write(log, path)
        path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
        with pytest.raises(UserError, match="damaged or cut short") as caught:
            reader(path)
        assert "\n" not in str(caught.value)
    np.savez(tmp_path / "objects.npz", observations=np.array([object()]), actions=np.zeros(1), rewards=np.zeros(1))
    with pytest.raises(UserError, match="holds Python objects"):
        read_npz(tmp_path / "objects.npz")
    np.savez(tmp_path / "less.npz", observations=np.zeros(1), actions=np.zeros(1))
    with pytest.raises(UserError, match="no column rewards"):
        read_npz(tmp_path / "less.npz")
    with pytest.raises(UserError, match="no file .*nothing.csv"):
        read(tmp_path / "nothing.csv")


@pytest.mark.parametrize(
    "columns", [3, [1], {"observations": 3}, {"observations": [[3], "f4", 1]}, {"observations": [["3"], "f4"]},
                {"observations": [[4], "f4"]}, {"observations": [[3], "O"]}, {"observations": [[3], "nothing"]},
                {"rewards": [[-1], "f4"]}, {"actions": [[2, 2], "f4"]}]
)  # fmt: skip
def test_wrong_shapes_in_a_header(log, tmp_path, columns):
    path = tmp_path / "log.parquet"
    write_parquet(log, path)
    table = pa.parquet.read_table(path)
    about = json.dumps({**json.loads(table.schema.metadata[b"deadreckon"]), "columns": columns})
    pa.parquet.write_table(table.replace_schema_metadata({"deadreckon": about}), path)
    with pytest.raises(UserError, match=f"^{path}: its header is damaged") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_the_columns_of_a_table_are_told_whole(tmp_path):
    names = [f"a_rather_long_name_of_column_{'x' * i}" for i in range(20)]
    path = tmp_path / "log.csv"
    path.write_text(",".join(["", *names]) + "\n" + ",".join("1" * 21) + "\n")
    with pytest.raises(UserError, match=r"name the columns: --action COLUMN --reward COLUMN .*columns: a_rather") as caught:
        read(path)
    told = str(caught.value).partition("(columns: ")[2].removesuffix(")").split(", ")
    assert told[-1] == "..."
    assert told[:-1] == names[: len(told) - 1]


def test_a_table_of_our_names_can_be_cut_and_a_mapped_one_names_its_column(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("observation_0,action,reward\n" + "1,0,1\n" * 7)
    assert read(path, horizon=3).lengths.tolist() == [3, 3, 1]
    with pytest.raises(UserError, match="--timeout names the one that marks time limits"):
        read(path, horizon=3, action="action", reward="reward")


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_column_that_is_kept_survives_conversion(tmp_path, ending):
    lines = [f"{user},{x},{x % 2},1" for x, user in enumerate("aabbccdd")]
    (tmp_path / "log.csv").write_text("\n".join(["user,x,arm,click", *lines]) + "\n")
    log = read(tmp_path / "log.csv", action="arm", reward="click", keep="user")
    assert log.extras["user"].tolist() == [0, 0, 1, 1, 2, 2, 3, 3]
    convert(tmp_path / "log.csv", tmp_path / f"again{ending}", action="arm", reward="click", keep=("user",))
    again = read(tmp_path / f"again{ending}")
    assert again.extras["user"].tolist() == log.extras["user"].tolist()
    plain = read(tmp_path / "log.csv", action="arm", reward="click", ignore="user")
    np.testing.assert_array_equal(again.episode_ids, plain.episode_ids)


def test_decisions_that_stand_alone_need_no_options(tmp_path):
    """Nothing tells of episodes: each row is one, and a column called propensity is what it says."""
    path = tmp_path / "bandit.csv"
    path.write_text("observation_0,observation_1,action,reward,propensity\n1,2,0,0.5,0.25\n3,4,1,1,0.5\n")
    found = read(path)
    assert found.episodes == 2
    assert found.terminals.all()
    assert found.warnings[0].startswith("each row is read as an episode of one step")
    np.testing.assert_allclose(found.extras["behavior_log_probs"], np.log([0.25, 0.5]), rtol=1e-6)
    assert read(path, horizon=1).timeouts.all()  # whoever gives a horizon has a stream
    path.write_text("observation_0,action,reward,time\n1,0,0.5,1\n3,1,1,2\n")
    assert read(path).episodes == 1


@pytest.mark.parametrize(("episode", "time"), [("episode_id", "step"), ("episode", "time")])
def test_names_that_tell_count_beside_ours(tmp_path, episode, time):
    """Read by our names alone, each of these rows would be a decision that stands alone, or out of order."""
    lines = [
        f"{e},{2 - s},{s},{e},{s / 4},1,{int(s == e == 0)},{int(s == 0 and e == 1)},0.5,7" for e in (0, 1) for s in range(3)
    ]
    names = f"{episode},{time},observation_1,observation_0,action_0,reward,terminated,truncated,propensity,goal"
    (tmp_path / "log.csv").write_text("\n".join([names, *lines]) + "\n")
    log = read(tmp_path / "log.csv")
    assert log.lengths.tolist() == [3, 3]
    assert (np.flatnonzero(log.terminals).tolist(), np.flatnonzero(log.timeouts).tolist()) == ([2], [5])
    np.testing.assert_array_equal(log.observations, [[0, 2], [0, 1], [0, 0], [1, 2], [1, 1], [1, 0]])
    np.testing.assert_array_equal(log.actions, [[0.5], [0.25], [0], [0.5], [0.25], [0]])
    assert log.extras["goal"].tolist() == [7] * 6
    np.testing.assert_allclose(log.extras["behavior_log_probs"], np.log(0.5), rtol=1e-6)
    assert f"column {time} is read as the time within an episode (--time)" in log.warnings
    with pytest.raises(UserError, match=f"a horizon and a column {episode if episode != 'episode' else 'time'}, whose name"):
        read(tmp_path / "log.csv", horizon=2)


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_extras_of_our_own_files_are_extras_however_they_are_called(tmp_path, ending):
    path = tmp_path / f"log{ending}"
    given = make_log(time=np.arange(13.0)[::-1], terminated=np.ones(13), pscore=np.arange(13.0), done=np.zeros(13))
    pa.parquet.write_table(to_table(given), path) if ending == ".parquet" else write_csv(given, path)
    again = read(path)
    np.testing.assert_array_equal(again.observations, given.observations)
    np.testing.assert_array_equal(again.terminals, given.terminals)
    assert {key: column.tolist() for key, column in again.extras.items()} == {k: c.tolist() for k, c in given.extras.items()}


def test_an_empty_next_observation_is_unknown_in_a_last_row_alone(tmp_path):
    path, names = tmp_path / "log.csv", "episode,observation_0,next_observation_0,action,reward"
    path.write_text(f"{names}\n1,1,5,0,1\n1,2,,0,1\n2,5,7,0,1\n")
    log = read(path)
    assert (log.final_known.tolist(), log.dropped, log.successors[0].tolist()) == ([False, True], 1, [5])
    path.write_text(f"{names}\n1,1,,0,1\n1,2,3,0,1\n")
    with pytest.raises(UserError, match="column next_observation_0 is empty in row 0"):
        read(path)


def test_columns_that_look_like_something_else_than_an_observation(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("x,pscore,user_id,offer,reward\n1,0.25,7,a,0.5\n3,0.5,8,b,1\n")
    said = " ".join(read(path, action="offer", reward="reward").warnings)
    assert "column pscore looks like a probability of the logged action" in said
    assert "--keep user_id" in said
    named = read(path, action="offer", reward="reward", propensity="pscore", keep="user_id")
    assert not [line for line in named.warnings if "looks like" in line]


@pytest.mark.parametrize(
    ("flags", "told"),
    [([0.0, 1.0, 0.0, 0.0], None), ([0, 1, 0, 0], None), ([False, True, False, False], None),
     ([0.0, 2.0, 0.0, 0.0], "timeouts has 2.0 in row 1"), ([0.0, np.nan, 0.0, 0.0], "timeouts has nan in row 1"),
     (["a", "b", "c", "d"], "timeout holds string")],
    ids=["floats", "whole numbers", "flags", "no flag", "not a number", "texts"],
)  # fmt: skip
def test_timeouts_of_any_numbers_are_flags_beside_episodes(tmp_path, flags, told):
    numbers = {name: [1.0, 2.0, 3.0, 4.0] for name in ("observation_0", "observation_1", "action_0", "reward")}
    table = pa.table(numbers | {"terminal": [0, 0, 0, 0], "timeout": flags, "episode": [0, 0, 1, 1]})
    pa.parquet.write_table(table, tmp_path / "log.parquet")
    if told:
        with pytest.raises(UserError, match=told):
            read(tmp_path / "log.parquet")
    else:
        assert read(tmp_path / "log.parquet").timeouts.tolist() == [False, True, False, True]


def test_a_time_that_does_not_order_rows_of_our_names_is_told(tmp_path):
    path = tmp_path / "log.csv"
    times = [0, 2, 1, 5, 4, 3]
    path.write_text("time,observation_0,action,reward\n" + "".join(f"{t},{t}.5,{t % 2},1\n" for t in times))
    words = "rows are taken in the table's order, in which time falls 3 times: --time time puts them in its order"
    assert words in read(path).warnings
    path.write_text("time,observation_0,action,reward\n" + "".join(f"{t},{t}.5,{t % 2},1\n" for t in sorted(times)))
    assert not any("falls" in line for line in read(path).warnings)


def test_names_of_ours_with_texts_gaps_and_a_horizon(tmp_path):
    """Episodes are named by texts, last rows have no next observation (null or NaN), and a horizon cuts further ones."""
    x = np.arange(8.0)
    after = np.where(np.arange(8) % 4 == 3, np.nan, x + 1)
    columns = {"observation_0": x, "next_observation_0": after, "action": [0.5, 0.1] * 4, "reward": x}
    flags = {"timeout": [0, 0, 0, 1] * 2}
    for gap in (after, pa.array(after, from_pandas=True)):
        pyarrow.parquet.write_table(pa.table(columns | flags | {"next_observation_0": gap}), tmp_path / "log.parquet")
        assert read(tmp_path / "log.parquet").final_known.tolist() == [False, False]
        log = read(tmp_path / "log.parquet", horizon=2)
        assert log.final_known.tolist() == [True, False, True, False]
        np.testing.assert_array_equal(log.final_observations[[0, 2], 0], [2.0, 6.0])
    names = {"episode": ["ep_9"] * 4 + ["ep_1"] * 4}
    rest = {key: value for key, value in columns.items() if key != "next_observation_0"}
    pyarrow.parquet.write_table(pa.table(rest | names), tmp_path / "named.parquet")
    assert read(tmp_path / "named.parquet").lengths.tolist() == [4, 4]
    mixed = {"episode": ["ep_9", "ep_1"] * 4}
    pyarrow.parquet.write_table(pa.table(rest | mixed), tmp_path / "mixed.parquet")
    with pytest.raises(UserError, match=r"the rows of episode ep_9 are not together \(row 2\)"):
        read(tmp_path / "mixed.parquet")
