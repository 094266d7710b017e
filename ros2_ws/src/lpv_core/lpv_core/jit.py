"""One switch for compiled numerics.

The recursions of plant, observer and tracker are written in the subset of Python that Numba
compiles.  The nodes, the offline replay and the design tools all call the same compiled functions,
so that their results agree bit for bit.  Where Numba is missing, or ``LPV_NO_JIT=1`` is set, the
very same functions run as plain Python: slower, same arithmetic.
"""

import os

if os.environ.get('LPV_NO_JIT', '') == '1':
    _numba_njit = None
else:
    try:
        from numba import njit as _numba_njit
    except ImportError:  # a machine without Numba runs the plain functions
        _numba_njit = None

COMPILED = _numba_njit is not None


def njit(function):
    """Compile ``function`` without reordering of floating-point operations.

    Parameters
    ----------
    function : callable
        A function of floats and float64 arrays.

    Returns
    -------
    callable
        The compiled function, or ``function`` itself without Numba.
    """
    if _numba_njit is None:
        return function
    # fastmath stays off: results must not depend on how a loop is vectorised.
    return _numba_njit(cache=True, fastmath=False, error_model='numpy')(function)
