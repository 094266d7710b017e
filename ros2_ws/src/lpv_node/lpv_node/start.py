"""Start of a node's process: signals to stop are handled before the imports, which last.

Needs no ROS itself.
"""

import importlib
import signal
import sys
import threading

from lpv.core.support.limits import QUIET
from lpv.core.support.signals import STOPS, StopRequest
from lpv.core.support.threads import one_thread


def start(module: str, node: str) -> None:
    """Run a node, a class of a module, and leave with its exit code: 0 if told to stop."""
    stop = StopRequest()
    one_thread()
    note = threading.Timer(QUIET, print, [f'{module} is loading ...'], {'flush': True})
    note.daemon = True
    note.start()
    try:
        node_class = getattr(importlib.import_module(module), node)
        run_node = importlib.import_module('lpv_node.managed').run_node
        note.cancel()
        if stop.is_set:  # its exception was lost in an import
            sys.exit(0)
        sys.exit(run_node(node_class))
    except KeyboardInterrupt:
        sys.exit(0)
    except SystemExit as leaving:
        if stop.is_set and leaving.code in [128 + number for number in STOPS]:
            sys.exit(0)
        raise
    finally:
        for number in STOPS:
            signal.signal(number, signal.SIG_IGN)
