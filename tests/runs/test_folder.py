"""A damaged part of a run or a store of results is told by its name."""

import pytest

from deadreckon.bench.store import Store
from deadreckon.errors import UserError
from deadreckon.runs.folder import Folder


def test_a_damaged_part_is_one_line_that_names_it(tmp_path):
    part = Folder(tmp_path).part("metrics", 20)
    part.parent.mkdir()
    part.write_bytes(b"PAR1 cut short")
    with pytest.raises(UserError, match=f"{part}: cannot be read as a table of a run, it is damaged or cut short"):
        Folder(tmp_path).table("metrics")
    (tmp_path / "results").mkdir()
    (tmp_path / "results" / "job.parquet").write_bytes(b"PAR1 cut short")
    with pytest.raises(UserError, match="job.parquet: cannot be read as a table of results, it is damaged"):
        Store(tmp_path).results()
