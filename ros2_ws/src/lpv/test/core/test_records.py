"""Records of compiled functions as plain Python reads them."""

import numpy as np

from lpv.core.support.records import new_record, plain, record_type

INNER = record_type(('angle', 'f8', (2,)), ('valid', '?'))
OUTER = record_type(('inner', INNER), ('number', 'i8'))


def test_given_a_record_when_read_plainly_then_what_is_written_later_is_seen():
    record = new_record(OUTER, number=3)
    fields = plain(record)
    assert fields['number'] == 3 and not fields['inner']['valid']
    record.number, record.inner.valid = 4, True
    record.inner.angle[1] = 0.5
    assert fields['number'] == 4 and fields['inner']['valid']
    np.testing.assert_array_equal(fields['inner']['angle'], [0.0, 0.5])
    assert not isinstance(fields['inner'], np.record)  # whose attributes would be as slow
