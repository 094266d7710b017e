"""What a launch says: on the screen, and in a log file."""

import os
import socket
import sys
import threading
import time
from pathlib import Path

from lpv_ros2cli.errors import CliError


class LaunchLog:
    """Lines of the launch and of its processes."""

    def __init__(self, debug: bool = False, show_all: bool = False) -> None:
        self._debug, self._show_all = debug, show_all
        self._lock = threading.Lock()
        try:
            self.folder = _new_folder()
            self._file = open(self.folder / 'launch.log', 'w', encoding='utf-8')  # noqa: SIM115
        except OSError as error:
            raise CliError(f'the log folder cannot be made (set ROS_LOG_DIR): {error}') from error

    def close(self) -> None:
        """Close the log file."""
        with self._lock:
            self._file.close()

    def note(self, level: str, name: str, text: str) -> None:
        """Say something about the launch or a process."""
        self._write(f'[{level}] [{name}]: {text}', level, name, text, True)

    def debug(self, name: str, text: str) -> None:
        """Say something that is shown only if asked for."""
        if self._debug:
            self.note('DEBUG', name, text)

    def line(self, name: str, output: str, line: str, is_error: bool) -> None:
        """A line that a process printed."""
        shown = (
            output in ('screen', 'both', 'full') or self._show_all or (output == 'log' and is_error)
        )
        self._write(f'[{name}] {line}', 'INFO', name, line, shown)

    def _write(self, shown_text: str, level: str, name: str, text: str, shown: bool) -> None:
        with self._lock:
            if not self._file.closed:
                self._file.write(f'{time.time():.7f} [{level}] [{name}]: {text}\n')
                self._file.flush()
            if shown:
                try:
                    print(shown_text, flush=True)
                except OSError:  # stdout is closed; processes must still be stopped
                    sys.stdout = open(os.devnull, 'w')  # noqa: SIM115


def _new_folder() -> Path:
    home = Path(os.environ.get('ROS_HOME') or Path.home() / '.ros')
    parent = Path(os.environ.get('ROS_LOG_DIR') or home / 'log')
    stamp = time.strftime('%Y-%m-%d-%H-%M-%S')
    folder = (
        parent / f'{stamp}-{time.time_ns() % 10**9 // 1000:06d}-{socket.gethostname()}-'
        f'{os.getpid()}'
    )
    folder.mkdir(parents=True)
    return folder
