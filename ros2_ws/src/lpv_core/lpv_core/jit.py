"""One switch for compiled numerics.

The recursions of plant, observer and tracker are written in the subset of Python that Numba
compiles.  The nodes, the offline replay and the design tools all call the same compiled functions,
so that their results agree bit for bit.  Where Numba is missing, or ``LPV_NO_JIT=1`` is set, the
very same functions run as plain Python: slower, same arithmetic.

Compiled code is kept between runs.  Numba's cache notices a change of the file that holds a
function, but not of the files that hold what it calls; one folder for each state of this package
keeps old machine code from running.
"""

import hashlib
import os
import tempfile
from pathlib import Path


def source_digest(folder):
    """Hash of the Python files of a package.

    Parameters
    ----------
    folder : pathlib.Path
        Of the package.

    Returns
    -------
    str
        16 hexadecimal digits.
    """
    digest = hashlib.sha256()
    for source in sorted(folder.rglob('*.py')):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder():
    """Cache folder of this state of the sources; None where no safe one can be made."""
    name = f'lpv_core-{source_digest(Path(__file__).parent)}'
    home = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache') / 'lpv_arm_fdi'
    for parent in (home, Path(tempfile.gettempdir()) / f'lpv_arm_fdi-{os.getuid()}'):
        folder = parent / name
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            # Machine code is run from here: a folder of somebody else's is not trusted.
            if parent.stat().st_uid == os.getuid() and os.access(folder, os.W_OK):
                return str(folder)
        except OSError:
            continue
    return None


def _load_numba():
    if os.environ.get('LPV_NO_JIT', '') == '1':
        return None, False
    try:
        import numba
    except ImportError:  # a machine without Numba runs the plain functions
        return None, False
    folder = _cache_folder()
    if folder is not None and 'NUMBA_CACHE_DIR' not in os.environ:
        numba.config.CACHE_DIR = folder
    return numba.njit, folder is not None


_numba_njit, _cache = _load_numba()

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
    # fastmath stays off: results must not depend on how a loop is vectorised.  Without the
    # interpreter's lock, a replay reads and writes while the recursion runs.
    return _numba_njit(cache=_cache, fastmath=False, error_model='numpy', nogil=True)(function)
