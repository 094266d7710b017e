"""Commands of our ros2 as processes."""

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

ROS2 = Path(sys.prefix) / 'bin' / 'ros2'


class Running:
    def __init__(self, *words, program=(ROS2,), **options):
        options |= {'stdout': subprocess.PIPE, 'stderr': subprocess.STDOUT, 'text': True}
        line = [str(word) for word in (*program, *words)]
        self.lines, self.process = [], subprocess.Popen(line, start_new_session=True, **options)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:  # a test has failed
            self._stop()
            self.process.communicate()

    def until(self, pattern, timeout=300.0):
        guard = threading.Timer(timeout, self._stop)  # which ends a line that is waited for
        guard.start()
        try:
            for line in iter(self.process.stdout.readline, ''):
                self.lines.append(line)
                if re.search(pattern, line):
                    return ''.join(self.lines)
        finally:
            guard.cancel()
        raise AssertionError(f'no {pattern!r} in:\n{"".join(self.lines)}')

    def _stop(self):
        """End the command, and by it what runs in process groups of its own; at worst itself."""
        at_worst = threading.Timer(60.0, self._kill)
        at_worst.daemon = True
        at_worst.start()
        self.process.terminate()

    def _kill(self):
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGKILL)

    def interrupt(self, timeout=300.0):
        """Send SIGINT to the command alone; its exit code and all it printed."""
        self.process.send_signal(signal.SIGINT)
        return self.end(timeout)

    def end(self, timeout=250.0):
        rest, _ = self.process.communicate(timeout=timeout)
        return self.process.returncode, ''.join(self.lines) + rest
