"""How much memory this process may use."""

import os
from pathlib import Path

LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")  # of a container, on Linux


def memory() -> int:
    """Bytes: the machine's, or a container's limit where that is less."""
    found = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for limit in map(Path, LIMITS):
        try:
            told = limit.read_text().strip()
        except OSError:  # there is no such limit on this machine
            continue
        if told.isdigit():  # else "max"
            found = min(found, int(told))
    return found
