"""Reading ahead and writing behind in threads: what NumPy and decompressors do runs in parallel."""

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from typing import Any, TypeVar

_END = object()
T = TypeVar('T')


class _Failure:
    def __init__(self, error: BaseException) -> None:
        self.error = error


def ahead(items: Iterable[T], depth: int = 2) -> Iterator[T]:
    """Items of an iterable that is advanced by another thread."""
    waiting: queue.Queue[Any] = queue.Queue(depth)
    stop = threading.Event()

    def put(item: object) -> None:
        while not stop.is_set():
            try:
                waiting.put(item, timeout=0.1)
                return
            except queue.Full:
                continue

    def work() -> None:
        source = iter(items)
        try:
            for item in source:
                put(item)
                if stop.is_set():
                    return
            put(_END)
        except BaseException as error:  # raised again by the thread that waits for it
            put(_Failure(error))
        finally:
            close = getattr(source, 'close', None)
            if close is not None:
                close()

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    try:
        while (item := waiting.get()) is not _END:
            if isinstance(item, _Failure):
                raise item.error
            yield item
    finally:
        stop.set()
        thread.join()


class Behind:
    """Calls a function in another thread, in order; to be used in a ``with`` statement.

    What the function raises is raised by the next call or at the end.  If the block itself ends
    with an exception, calls that wait are dropped.
    """

    def __init__(self, function: Callable[..., Any], depth: int = 2) -> None:
        self._function = function
        self._waiting: queue.Queue[Any] = queue.Queue(depth)
        self._error: BaseException | None = None
        self._dropped = False
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> 'Behind':
        self._thread.start()
        return self

    def __call__(self, *arguments: Any) -> None:
        """Call the function soon."""
        if self._error is not None:
            raise self._error
        self._waiting.put(arguments)

    def _work(self) -> None:
        while (arguments := self._waiting.get()) is not _END:
            if self._error is None and not self._dropped:
                try:
                    self._function(*arguments)
                except BaseException as error:  # raised again by the thread that called
                    self._error = error

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._dropped = kind is not None
        self._waiting.put(_END)
        self._thread.join()
        if kind is None and self._error is not None:
            raise self._error
