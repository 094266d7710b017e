"""Opening of bags: MCAP by this package, which reads damaged ones; others by rosbags."""

import contextlib
import functools
from collections.abc import Collection, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Connection, MessageDefinitionFormat
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from lpv_bag.errors import BagError, DamageError
from lpv_bag.rosbag.interfaces import decode, make_typestore
from lpv_bag.rosbag.mcap_bag import McapBag
from lpv_bag.rosbag.metadata import FILE_NAME, BagMetadata, read_metadata
from lpv_core.support.errors import LpvError
from lpv_core.support.timestamps import NANOSECONDS


class BagReader:
    """A bag that is open for reading."""

    def __init__(self, path: Path, source: McapBag | AnyReader, typestore: Typestore) -> None:
        self.paths, self._source, self._typestore = [path], source, typestore
        self.warnings = getattr(source, 'warnings', [])
        self.known = getattr(source, 'known', {})
        self._types: dict[str, Typestore] = {}

    @property
    def source(self) -> McapBag | AnyReader:
        """What reads: an `McapBag`, or an AnyReader of rosbags."""
        return self._source

    @property
    def connections(self) -> list[Connection]:
        """Topics of the bag."""
        return self._source.connections

    @property
    def start_time(self) -> int:
        """Log time of the first message [ns]; 2**63 - 1 without messages."""
        return self._source.start_time

    @property
    def end_time(self) -> int:
        """Time after the log time of the last message [ns]; 0 without messages."""
        return self._source.end_time

    def log_time(self, seconds: float | None) -> int | None:
        """Log time of a moment counted from the first message [ns]; None stays None."""
        return None if seconds is None else self.start_time + round(seconds * NANOSECONDS)

    @functools.cached_property
    def typestore(self) -> Typestore:
        """Typestore that knows all types of the bag."""
        found = {}
        for msgtype in sorted({connection.msgtype for connection in self.connections}):
            found.update(self.typestore_of(msgtype).fielddefs)
        store = get_typestore(Stores.EMPTY)
        with damage(self.paths[0]):
            store.register(found)
        return store

    def messages(
        self,
        connections: Collection[Connection] = (),
        start: int | None = None,
        stop: int | None = None,
    ) -> Iterator[tuple[Connection, int, bytes]]:
        """Messages in the order of their log times.

        Parameters
        ----------
        connections : collection of rosbags.interfaces.Connection, optional
            Wanted ones; all if empty.
        start, stop : int, optional
            First log time, and the one before which to end [ns].

        Yields
        ------
        tuple
            Connection, log time [ns], raw data.

        Raises
        ------
        BagError
            If the bag is damaged so that it cannot be read on.
        """
        with damage(self.paths[0]):
            yield from self._source.messages(connections, start=start, stop=stop)

    def deserialize(self, rawdata: bytes, typ: str) -> Any:
        """Decode a message.

        Parameters
        ----------
        rawdata : bytes
            CDR.
        typ : str
            Message type.

        Returns
        -------
        object
            Message.

        Raises
        ------
        BagError
            If the data does not fit the type, or the bag's definition of the type is damaged.
        """
        with damage(self.paths[0]):
            if isinstance(self._source, AnyReader):  # which knows ROS 1 as well
                return decode(self._source.deserialize, rawdata, typ)
            return decode(self.typestore_of(typ).deserialize_cdr, rawdata, typ)

    def typestore_of(self, msgtype: str) -> Typestore:
        """Typestore that knows a type as this bag defines it.

        Parameters
        ----------
        msgtype : str
            Message type.

        Returns
        -------
        rosbags typestore
            Shared: not to be changed.

        Raises
        ------
        BagError
            If the definition is damaged, or topics of the bag define the type differently.
        """
        if msgtype not in self._types:
            with damage(self.paths[0]):
                self._types[msgtype] = self._find_types(msgtype)
        return self._types[msgtype]

    def _find_types(self, msgtype: str) -> Typestore:
        found = {
            (c.msgdef, c.digest) for c in self.connections if c.msgtype == msgtype and c.msgdef.data
        }
        if len({definition for definition, _ in found}) > 1:
            raise BagError(
                f'{self.paths[0]}: topics of type {msgtype} have different definitions of it'
            )
        if not found:
            return self._typestore
        definition = next(iter(found))[0]
        store, digest = _types(msgtype, definition.format, definition.data)
        for claimed in {claimed for _, claimed in found if claimed.startswith('RIHS01_')}:
            if claimed != digest:
                raise BagError(
                    f'{self.paths[0]}: the definition of {msgtype} does not have the '
                    'type hash that the bag says'
                )
        return store


@functools.lru_cache(maxsize=256)
def _types(msgtype: str, kind: MessageDefinitionFormat, text: str) -> tuple[Typestore, str]:
    """Typestore of one definition, and its hash; parsing takes longer than reading a small bag."""
    store = get_typestore(Stores.EMPTY)
    if kind == MessageDefinitionFormat.MSG:
        store.register(get_types_from_msg(text, msgtype))
    else:
        separator = '=' * 80 + '\n'
        for part in text.split(separator)[1:] if text.startswith(separator) else [text]:
            store.register(
                get_types_from_idl(part.split('\n', 1)[1] if part.startswith('IDL: ') else part)
            )
    return store, store.hash_rihs01(msgtype)


@contextlib.contextmanager
def damage(path: Path) -> Iterator[None]:
    """What readers, parsers and decompressors raise, as a BagError that names the bag."""
    try:
        yield
    except DamageError as error:
        raise BagError(f'{path}: cannot be read, the bag is damaged: {error}') from None
    except LpvError:
        raise
    except GeneratorExit:
        raise
    except Exception as error:  # many kinds
        text = ' '.join(str(error).split()) or type(error).__name__
        raise BagError(
            f'{path}: cannot be read, the bag is damaged or incomplete ({text})'
        ) from error


@contextlib.contextmanager
def open_bag(path: str | Path) -> Iterator[BagReader]:
    """Open a bag; whatever goes wrong in reading is a BagError with a message.

    MCAP bags that were not finished, or are damaged in places, are opened with a warning (logged,
    and in ``warnings`` of the reader) and read as far as its checksums are right.  Bags without
    message definitions are read with the standard types and lpv_msgs.

    Parameters
    ----------
    path : str or pathlib.Path
        rosbag2 directory or single ``.mcap`` or ``.db3`` file.

    Yields
    ------
    BagReader
        Open reader.

    Raises
    ------
    BagError
        If there is no such bag, or nothing of it can be read.
    """
    path = Path(path)
    if not path.exists():
        raise BagError(f'{path}: there is no such bag')
    with contextlib.ExitStack() as stack:
        with damage(path):
            source = _source(path, stack)
        yield BagReader(path, source, _standard_types())


@functools.lru_cache(maxsize=1)
def _standard_types() -> Typestore:
    return make_typestore()


def _source(path: Path, stack: ExitStack) -> McapBag | AnyReader:
    if path.is_dir():
        metadata: BagMetadata | None = None
        wrong: str | None = f'it has no {FILE_NAME}, its recording was not finished'
        if (path / FILE_NAME).exists():
            try:
                metadata, wrong = read_metadata(path), None
            except DamageError as error:
                wrong = str(error)
        if metadata is not None and (metadata.storage != 'mcap' or metadata.compressed):
            return stack.enter_context(AnyReader([path], default_typestore=_standard_types()))
        return stack.enter_context(contextlib.closing(McapBag(path, metadata, wrong)))
    if path.suffix == '.mcap':
        return stack.enter_context(contextlib.closing(McapBag(path)))
    return stack.enter_context(AnyReader([path], default_typestore=_standard_types()))
