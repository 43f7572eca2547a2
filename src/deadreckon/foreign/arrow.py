"""Arrow files: what their record batches unpack to is asked before they are read, in a process of limited memory."""

from pathlib import Path
from typing import Any

from deadreckon.foreign.child import read_apart
from deadreckon.foreign.door import file_size
from deadreckon.foreign.limits import UNPACKED, beyond, max_unpacked
from deadreckon.foreign.reader import alive, bound_memory


def check_arrow(path: Path | str, kind: str = "Arrow") -> None:
    """Refuses a file of which a record batch would take more memory than it may; batches are read one at a time.

    Of a compressed file all batches are unpacked for this, of others none is read.

    Args:
        path: of the file.
        kind: what it should be, in words, for errors.

    Raises:
        UserError: it is no file, is damaged, or a batch unpacks to more than it may (`foreign.limits`).
    """
    size = file_size(path)
    most = max_unpacked(size)
    largest = read_apart("arrow", path, kind, size=size, file=str(path))["largest"]
    if largest > most:
        raise beyond(path, largest, most, UNPACKED, "has a record batch that unpacks to")


def largest_batch(file: str, shared: Any) -> dict[str, int]:
    """Bytes of the `largest` record batch of a file, for the process that reads.

    Args:
        file: its path.
        shared: not used, for there are no arrays.
    """
    import pyarrow as pa

    size = file_size(file)
    bound_memory(size + int(2 * max_unpacked(size)))  # what is mapped is no memory that is taken
    largest = 0
    with pa.memory_map(file) as mapped, pa.ipc.open_file(mapped) as opened:
        for index in range(opened.num_record_batches):
            alive()
            largest = max(largest, opened.get_batch(index).get_total_buffer_size())
    return {"largest": largest}
