"""Alarms that outlive the process that raised them, so that a respawned observer knows of them."""

import json
import os
from contextlib import suppress
from pathlib import Path

from rclpy.logging import get_logging_directory
from rclpy.node import Node

from lpv.core.monitoring.alarm_text import describe
from lpv.core.serial_arm.diagnosis.alarms import Alarm, AlarmEvent, blamed
from lpv.core.support.config import MAX_BYTES, write_whole


def alarm_file(node: Node) -> Path:
    """File of a node's open alarms: of its name and ROS domain, started by the same process."""
    parts = node.context.get_domain_id(), node.get_fully_qualified_name()[1:], os.getppid()
    name = '-'.join(map(str, parts)).replace('/', '.')
    return Path(get_logging_directory()) / 'lpv_open_alarms' / f'{name}.json'


class OpenAlarms:
    """Open alarms on disk; a latched topic ends with the process that published it.

    A file that is there was left by an observer that died; ``before`` has its alarms, by sensor,
    that have not been raised again.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self.before = self._open = _read(path)

    def note(self, event: Alarm) -> None:
        """Keep what one event changes; OSError if it cannot be written."""
        if event.kind == 'dropout':
            return  # it shows as long as it lasts, and is not the end of another fault
        sensor = blamed(event.sensor, event.kind)
        known = {**self._open}
        self.before = {s: t for s, t in self.before.items() if s != sensor}
        known.pop(sensor, None)
        if event.event != AlarmEvent.CLEARED:
            known[sensor] = describe(event)
        self._open = known
        self._path.parent.mkdir(parents=True, exist_ok=True)
        write_whole(self._path, json.dumps(known))

    def forget(self) -> None:
        """Forget all: the observer ends in order, or was reset by an operator."""
        self.before = self._open = {}
        with suppress(OSError):  # it was not written either, as `note` has said
            self._path.unlink()


def _read(path: Path) -> dict[str, str]:
    """Texts of alarms by sensor; empty where there is no file of this kind."""
    try:
        if path.stat().st_size > MAX_BYTES:
            return {}
        found = json.loads(path.read_text(encoding='utf-8'))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(found, dict):
        return {}
    return {str(sensor): str(text) for sensor, text in found.items()}
