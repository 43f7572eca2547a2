"""Small sound logs in every format that is read, as bytes: what the fuzzers damage."""

import gzip
import io
import json
import pickle
import sqlite3
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

Files = dict[str, bytes]  # {path below a folder: content}
ROWS = 12


def of_folder(folder: Path) -> Files:
    """All files of a folder."""
    found = sorted(path for path in folder.rglob("*") if path.is_file())
    return {str(path.relative_to(folder)): path.read_bytes() for path in found}


def log(discrete: bool = False) -> Any:
    """Three episodes with an extra column."""
    from deadreckon.data.dataset import Dataset
    from deadreckon.data.spec import Box, Discrete

    rng = np.random.default_rng(1)
    ends = np.array([3, 7, ROWS - 1])
    terminals, timeouts = np.zeros((2, ROWS), bool)
    terminals[ends[:2]], timeouts[ends[2]] = True, True
    return Dataset.from_arrays(
        observations=rng.normal(size=(ROWS, 3)).astype(np.float32),
        actions=rng.integers(0, 3, ROWS) if discrete else rng.uniform(-1, 1, (ROWS, 2)).astype(np.float32),
        rewards=rng.normal(size=ROWS).astype(np.float32), terminals=terminals, timeouts=timeouts,
        final_observations=rng.normal(size=(3, 3)).astype(np.float32), behavior_log_probs=-rng.random(ROWS),
        action_space=Discrete(3) if discrete else Box((-1, -1), (1, 1)), name="small",
    )  # fmt: skip


def logs(kind: str) -> list[Files]:
    """A format of `data.formats.io`: logs that we write, and files of others."""
    from deadreckon.data.formats import io as formats

    found: list[Files] = []
    with tempfile.TemporaryDirectory() as place:
        for number, each in enumerate((log(), log(discrete=True))):
            target = Path(place, f"{number}" + ("" if kind == "folder" else f".{kind}"))
            formats._writer(target)(each, target, False)
            files = of_folder(target) if target.is_dir() else {f"log.{kind}": target.read_bytes()}
            found.append({f"log/{name}": data for name, data in files.items()} if kind == "folder" else files)
    return found


def _table() -> pa.Table:
    rng = np.random.default_rng(2)
    return pa.table({
        "patient": [i // 4 for i in range(ROWS)], "step": [i % 4 for i in range(ROWS)], "age": rng.normal(50, 9, ROWS).round(1),
        "ward": ["a", "b", None] * 4, "seen": [True, False, True] * 4, "day": ["2024-01-02"] * ROWS,
        "action": ["none", "low", "high", "low"] * 3, "reward": rng.normal(size=ROWS).round(3), "terminal": [0, 0, 0, 1] * 3,
    })  # fmt: skip


def tables(kind: str) -> list[Files]:
    """A format of tables, as others write them."""
    from pyarrow import csv, parquet

    made, found = io.BytesIO(), _table()
    if kind == "csv":
        csv.write_csv(found, made)
        text = made.getvalue()
        own = [file["log.csv"] for file in logs("csv")]
        other = text.replace(b",", b";").replace(b".", b",")
        return [{"log.csv": each} for each in (text, *own, other)]
    if kind == "csv.gz":
        csv.write_csv(found, made)
        return [{"log.csv.gz": gzip.compress(made.getvalue(), mtime=0)}]
    if kind == "jsonl":
        lines = [json.dumps(row | {"more": {"a": i, "b": [i, None]}}, default=str) for i, row in enumerate(found.to_pylist())]
        return [{"log.jsonl": "\n".join(lines).encode()}, {"log.jsonl": ("[" + ",\n".join(lines) + "]").encode()}]
    if kind == "arrow":
        from pyarrow import feather

        with tempfile.TemporaryDirectory() as place:
            feather.write_feather(found, f"{place}/log.arrow", compression="uncompressed")
            return [{"log.arrow": Path(place, "log.arrow").read_bytes()}]
    if kind == "parquet":
        parquet.write_table(found, made)
        return [{"log.parquet": made.getvalue()}, *logs("parquet")]
    with tempfile.TemporaryDirectory() as place:
        path = Path(place, f"log.{kind}")
        names, rows = found.column_names, list(zip(*(column.to_pylist() for column in found.columns)))
        if kind == "xlsx":
            from tests.data.formats.small_sheets import write_xlsx

            write_xlsx(path, {"Sheet": [names, *rows]})
        elif kind == "sqlite":
            base = sqlite3.connect(path)
            base.execute(f"CREATE TABLE log ({', '.join(names)})")
            base.executemany(f"INSERT INTO log VALUES ({', '.join('?' * len(names))})", rows)
            base.commit()
            base.close()
        else:
            import duckdb

            with duckdb.connect(str(path)) as base:
                base.register("found", found)
                base.execute("CREATE TABLE log AS SELECT * FROM found")
                base.execute("CHECKPOINT")
        return [{f"log.{kind}": path.read_bytes()}]


def hdf5() -> list[Files]:
    """Ours, and one as D4RL's are: chunked, packed, with metadata."""
    import h5py

    made, each = io.BytesIO(), log()
    with h5py.File(made, "w") as file:
        for key in ("observations", "actions", "rewards", "terminals", "timeouts"):
            file.create_dataset(key, data=getattr(each, key), chunks=True, compression="gzip")
        file["infos/goal"] = np.ones((ROWS, 2), np.float32)
        file["metadata/algorithm"], file["metadata/policy/weight"] = b"SAC", np.ones((3, 3))
    return [*logs("hdf5"), {"log.hdf5": made.getvalue()}]


def minari() -> list[Files]:
    """One data set, in a folder."""
    import os

    from deadreckon.data.formats.minari import write_minari

    before = os.environ.get("MINARI_DATASETS_PATH")
    with tempfile.TemporaryDirectory() as place:
        os.environ["MINARI_DATASETS_PATH"] = place
        try:
            folder = write_minari(log(), "fuzz/small-v0")
        finally:
            os.environ.pop("MINARI_DATASETS_PATH")
            os.environ.update({} if before is None else {"MINARI_DATASETS_PATH": before})
        return [{f"log/{name}": data for name, data in of_folder(folder).items()}]


def pickles() -> list[Files]:
    """A dict, and a list of episodes as Adroit's demonstrations are, by old and new protocols."""
    each = log()
    keys = ("observations", "actions", "rewards", "terminals", "timeouts")
    whole = {key: np.asarray(getattr(each, key)) for key in keys}
    episodes = [{key: value[a:b] for key, value in whole.items()} for a, b in ((0, 4), (4, 8), (8, ROWS))]
    found = [pickle.dumps(whole, 5), pickle.dumps(whole, 2), pickle.dumps(episodes, 0), pickle.dumps(episodes, 4)]
    return [{"log.pkl": data} for data in found] + [{"log.pkl": gzip.compress(found[0], mtime=0)}]


def published() -> list[Files]:
    """A policy as DOPE publishes them."""
    rng = np.random.default_rng(3)
    net = {"fc0/weight": (8, 3), "fc0/bias": (8,), "fc1/weight": (8, 8), "fc1/bias": (8,), "last_fc/weight": (2, 8),
           "last_fc/bias": (2,), "last_fc_log_std/weight": (2, 8), "last_fc_log_std/bias": (2,)}  # fmt: skip
    value: dict[str, Any] = {key: rng.normal(size=shape).astype(np.float32) for key, shape in net.items()}
    return [{"policy.pkl": pickle.dumps({**value, "nonlinearity": "relu", "output_distribution": "tanh_gaussian"}, 4)}]


def network() -> list[Files]:
    """A policy as DAPG's authors published them, by operations of a pickle that need neither torch nor mjrl."""
    text = lambda value: b"X" + len(value).to_bytes(4, "little") + value  # noqa: E731
    storage = pickle.dumps(0x1950A86A20F9469CFC6C, 2) + pickle.dumps(1001, 2) + pickle.dumps({"little_endian": True}, 2)
    root = b"\x80\x02(" + text(b"storage") + b"ctorch\nFloatStorage\n" + text(b"1") + text(b"cpu") + b"K\x06NtQ."
    storage += root + pickle.dumps(["1"], 2) + (6).to_bytes(8, "little") + np.arange(6, dtype="<f4").tobytes()
    loaded = b"ctorch.storage\n_load_from_bytes\nB" + len(storage).to_bytes(4, "little") + storage + b"\x85R"
    tensor = b"ctorch._utils\n_rebuild_tensor_v2\n(" + loaded + b"K\x00K\x02K\x03\x86K\x03K\x01\x86\x89NtR"
    policy = b"\x80\x04cmjrl.policies.gaussian_mlp\nMLP\n)\x81}" + text(b"log_std") + tensor + b"sb."
    return [{"policy.pkl": policy}]


def rllib() -> list[Files]:
    """Two batches as lines of JSON."""
    each = log(discrete=True)
    batch = lambda a, b: {  # noqa: E731
        "type": "SampleBatch", "obs": each.observations[a:b].tolist(), "actions": each.actions[a:b].tolist(),
        "rewards": each.rewards[a:b].tolist(), "terminateds": each.terminals[a:b].tolist(),
        "truncateds": each.timeouts[a:b].tolist(), "eps_id": [1] * (b - a), "new_obs": each.observations[a:b].tolist(),
    }  # fmt: skip
    return [{"log.json": "\n".join(json.dumps(batch(*ends)) for ends in ((0, 4), (4, 12))).encode() + b"\n"}]


def vw() -> list[Files]:
    """Decisions of one line, and of several."""
    lines = "".join(f"{1 + i % 3}:{i}:0.5 | a:{i} b c:0.25 |s word:{-i} x=y\n" for i in range(6))
    several = "".join(f"shared | a:{i}\n0:{i}:0.5 | p:1\n| p:2 q\n\n" for i in range(3))
    return [{"log.vw": lines.encode()}, {"log.vw": several.encode()}]
