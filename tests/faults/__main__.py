"""`python -m tests.faults`: the study of faults; see `tests/faults/study.py`."""

import os

from tests.faults.process import ENVIRONMENT

if __name__ == "__main__":  # processes that `bench` begins import this file again
    os.environ.update(ENVIRONMENT)  # before numpy is imported, which starts threads
    from tests.faults.study import main

    main()
