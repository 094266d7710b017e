"""Answers as records of messages, thousands at once, byte for byte as one by one."""

from typing import Any

import numpy as np
from rosbags.typesys.store import Typestore

from lpv_bag.blocks.cdr_layout import Layout
from lpv_bag.blocks.message_blocks import RECORD, record
from lpv_bag.rosbag.writing import padded_cdr
from lpv_core.support.timestamps import NANOSECONDS


class RecordTemplate:
    """Records of one message type in which only the header stamp and numbers change.

    All numbers have to be given in every call, or in none: memory is used again.
    """

    def __init__(self, typestore: Typestore, message: object, msgtype: str, channel: int) -> None:
        data = padded_cdr(typestore, message, msgtype)
        fields = Layout(data, msgtype, typestore).fields
        self._fields = {name: field for name, field in fields.items() if field.count}
        self._record = record(channel, 0, data)
        places = {name: (kind, at) for name, (kind, at, *_) in (RECORD.fields or {}).items()}
        for name, field in self._fields.items():
            # Vectors as one piece: one copy in place of one for every element.
            size = np.dtype(field.dtype).itemsize * field.count
            places[name] = (np.dtype(f'V{size}'), RECORD.itemsize + field.offset)
        self._dtype = np.dtype(
            {
                'names': list(places),
                'formats': [kind for kind, _ in places.values()],
                'offsets': [at for _, at in places.values()],
                'itemsize': len(self._record),
            }
        )
        self._records = np.empty(0, self._dtype)

    def fill(
        self, time: np.ndarray, stamp: np.ndarray, values: dict[str, np.ndarray] | np.ndarray
    ) -> np.ndarray:
        """Records of messages, from log times, header stamps and fields by name."""
        if len(self._records) < len(time):
            one = np.frombuffer(self._record, f'V{len(self._record)}')  # what is no number, too
            self._records = np.repeat(one, len(time)).view(self._dtype)
        records = self._records[: len(time)]
        records['log_time'] = records['publish_time'] = time
        seconds = stamp // NANOSECONDS
        self._set(records, 'header.stamp.sec', seconds)
        self._set(records, 'header.stamp.nanosec', stamp - seconds * NANOSECONDS)
        names = values if isinstance(values, dict) else values.dtype.names or ()
        for name in names:
            self._set(records, name, values[name])
        return records

    def _set(self, records: np.ndarray, name: str, array: np.ndarray) -> None:
        values = np.ascontiguousarray(array, self._fields[name].dtype)
        if values.size != len(records) * self._fields[name].count:
            raise ValueError(f'{name} has another size in the message')
        if len(values):
            records[name] = np.frombuffer(values, self._dtype[name])


def as_fields(zero: Any) -> dict[str, Any]:
    """Fields of a message from one record."""
    return {name: zero[name].tolist() for name in zero.dtype.names}
