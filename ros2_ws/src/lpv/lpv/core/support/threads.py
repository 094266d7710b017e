"""Threads of linear algebra. Needs no NumPy, which reads this once, when it is loaded."""

import os


def one_thread() -> None:
    """Let linear algebra run in one thread, unless the user has chosen another number.

    On matrices as small as an arm's, its threads wait for each other, and hold up other processes.
    """
    for name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
        os.environ.setdefault(name, '1')
