"""What the system can be made to refuse."""

import contextlib
import resource


@contextlib.contextmanager
def files_up_to(size):
    """A limit on the size of files, which stands for a full disk: the write fails in the middle."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
