"""A Ray cluster of two node processes gives what this machine gives, though its workers are killed."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from deadreckon.bench.cluster import Cluster
from deadreckon.bench.executor import run
from deadreckon.bench.local import Local
from deadreckon.bench.plan import plan
from deadreckon.bench.store import Store
from deadreckon.bench.suite import read
from deadreckon.cli.main import main
from deadreckon.errors import UserError

SUITE = """
seeds = 6
lanes = 2
steps = 6000
evaluations = 2
episodes = 2
logs = ["maze2d-umaze-v1"]
rows = 2000

[methods]
BC = { agent = "bc", fields = { hidden = [8], batch_size = 16 } }
TD3 = { agent = "td3", fields = { hidden = [8], batch_size = 16 } }
"""


def test_what_no_cluster_can_do_is_refused(tmp_path, capsys, monkeypatch):
    assert main(["bench", "quick", "--cpus", "2"]) == 2
    assert "--cpus needs --executor ray" in capsys.readouterr().err
    assert main(["bench", "quick", "--executor", "ray", "--workers", "2"]) == 2
    assert "--workers needs --executor local" in capsys.readouterr().err
    with pytest.raises(UserError, match="1 or more cpus"):
        Cluster(tmp_path, cpus=0)
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UserError, match=r"install the extra ray"):
        Cluster(tmp_path)

    def late(address, **options):
        raise Exception("The current node timed out during startup.\nMore of it.")  # as Ray does, on a machine that is busy

    monkeypatch.setitem(sys.modules, "ray", SimpleNamespace(is_initialized=lambda: False, init=late))
    with pytest.raises(UserError, match=r"at this machine: The current node timed out during startup.$"):
        Cluster(tmp_path)


@pytest.fixture
def nodes():
    """A cluster of two nodes with a core each, on this machine."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster as Nodes

    made = Nodes(initialize_head=True, head_node_args={"num_cpus": 1})
    made.add_node(num_cpus=1)
    yield made
    made.shutdown()


def at_work(nodes) -> list[int]:
    """Processes of the cluster's nodes, whose children they are, that run one of our tasks."""
    owners = [str(each.process.pid) for node in nodes.list_all_nodes() for each in node.all_processes["raylet"]]
    find = ["pgrep", "-P", ",".join(owners), "-f", "^ray::_task"]
    found = subprocess.run(find, capture_output=True, text=True, check=False)
    return [int(number) for number in found.stdout.split()]


def at_work_on(folder, nodes) -> list[int]:
    """The one of them that has a run folder to itself, if any has: it holds the lock open."""
    lock, found = str(folder.with_name(f".{folder.name}.lock")), []
    for number in at_work(nodes):
        with contextlib.suppress(OSError):  # it has ended since
            if lock in [os.readlink(each) for each in Path(f"/proc/{number}/fd").iterdir()]:
                found.append(number)
    return found


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.skipif(sys.platform != "linux", reason="/proc is Linux's")
def test_a_cluster_whose_workers_are_killed_finds_what_this_machine_finds(nodes, tmp_path):
    path = tmp_path / "small.toml"
    path.write_text(SUITE)
    jobs = plan(read(path))
    assert len(jobs) == 6
    events, rng, killed = [], random.Random(0), []

    def told(event):
        events.append(event)
        # A job may lose three processes before it is given up, so each loses one at most.
        wanted = event.what == "progress" and event.program.name not in killed and len(killed) < 3 and rng.random() < 0.3
        for number in at_work_on(store.folder(event.program), nodes) if wanted else ():
            os.kill(number, signal.SIGKILL)
            killed.append(event.program.name)

    store = Store(tmp_path / "ray")
    cluster = Cluster(store.path, nodes.address)
    assert cluster.workers == 2
    run(jobs, store, told, cluster)
    whats = [event.what for event in events]
    assert 1 <= whats.count("died") <= len(killed)  # one may have ended before the kill
    assert {event.program.name for event in events if event.what == "died"} <= set(killed)
    assert whats.count("failed") == 0
    done = [event.program.name for event in events if event.what == "done"]
    assert sorted(done) == sorted(job.name for job in jobs)  # each once

    here = Store(tmp_path / "local")
    run(jobs, here, lambda event: None, Local(here.path, workers=2))
    for kind in ("results", "curves"):
        apart = ["seconds", "finished"] if kind == "results" else []
        tables = [getattr(each, kind)().drop_columns(apart) for each in (store, here)]
        by = [("cell", "ascending"), ("seed" if kind == "results" else "step", "ascending")]
        assert tables[0].sort_by(by).equals(tables[1].sort_by(by)), kind  # bit by bit
    time.sleep(1)
    assert at_work(nodes) == []
