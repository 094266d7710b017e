"""Log of the web server: a request that is no HTTP is one line, and not one line each."""

import logging
import time

from aiohttp.http import HttpProcessingError

_QUIET = 5.0
"""Time between two lines about requests that are no HTTP [s]."""


class _BadRequests(logging.Filter):
    """Shortens what aiohttp logs with a traceback and with all that was sent."""

    def __init__(self) -> None:
        super().__init__()
        self._count, self._due = 0, 0.0

    def filter(self, record: logging.LogRecord) -> bool:
        """Pass records on; those of bad requests as a count, every few seconds."""
        error = record.exc_info[1] if record.exc_info else None
        if not isinstance(error, HttpProcessingError):
            return True
        self._count += 1
        now = time.monotonic()
        if now < self._due:
            return False
        self._due = now + _QUIET
        record.msg, record.args = 'refused: %d requests that are no HTTP so far', (self._count,)
        record.exc_info = record.exc_text = None
        record.levelno, record.levelname = logging.WARNING, 'WARNING'
        return True


def request_logger() -> logging.Logger:
    """A logger for `aiohttp.web.AppRunner`."""
    logger = logging.getLogger('lpv_view.requests')
    if not any(isinstance(one, _BadRequests) for one in logger.filters):
        logger.addFilter(_BadRequests())
    return logger
