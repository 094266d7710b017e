"""Measurements that are handed over together, and their answers."""

from typing import Any, NamedTuple

import numpy as np

from lpv.core.monitoring.answers import Answers
from lpv.core.monitoring.compensation import AnswerRows, answer_rows
from lpv.core.serial_arm.chain import FloatArray, IntArray


class Batch(NamedTuple):
    """Measurements that were handed over together, and their answers."""

    stamps: IntArray
    samples: FloatArray
    records: np.recarray
    plain: np.ndarray  # the same, of which a part is taken in a tenth of the time
    rows: AnswerRows
    answers: Answers


def new_batch(kind: np.dtype, count: int, joints: int) -> Batch:
    """A batch of ``count`` measurements; ``kind`` is `answer_type`."""
    # A single row would be contiguous, another type to compiled functions.
    memory = np.zeros(count + 1, kind)
    records: Any = memory[:count].view(np.recarray)
    answers = Answers(
        records.answered,
        records.has_fault,
        records.restarted,
        records.inconsistent,
        records.state,
        records.fault,
        events=[],
        reports=[],
        warnings=[],
    )
    return Batch(
        np.empty(count, np.int64),
        np.empty((count, 3, joints)),
        records,
        records.view(np.ndarray),
        answer_rows(memory),
        answers,
    )
