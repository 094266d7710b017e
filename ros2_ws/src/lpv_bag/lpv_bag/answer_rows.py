"""Answers of a monitor to many measurements, as arrays with one row a measurement."""

from types import SimpleNamespace

import numpy as np

from lpv_core.errors import SampleError

STATE_FIELDS = {'position': float, 'velocity': float, 'compensated_position': float,
                'measured_position': float, 'measured_velocity': float, 'mode': np.uint8,
                'trustworthy': bool}
"""Arrays of ``answers.state`` with their types; those of float have shape (n, 2), others (n,)."""
FAULT_FIELDS = {'estimate': float, 'bound': float, 'threshold': float, 'state': np.uint8,
                'alarm': bool}
"""Arrays of ``answers.fault``, all of shape (n, 2)."""


def take_all(monitor, measured, torque, rejected):
    """Answers to the measurements of a block.

    Parameters
    ----------
    monitor : SensorMonitor
        Its state goes on from block to block.
    measured : Measurements
        n measurements.
    torque : ndarray, shape (n, 2), or None
        In place of the measured efforts [N m].
    rejected : collections.Counter
        Receives the reasons of measurements that could not be used.

    Returns
    -------
    object
        As of `SensorMonitor.take_many`.
    """
    effort = measured.effort if torque is None else torque

    def regular(a, b):
        return monitor.take_many(measured.stamp[a:b], measured.position[a:b],
                                 measured.velocity[a:b], effort[a:b])

    if not measured.odd:
        return regular(0, len(effort))
    parts, done = [], 0
    for row in sorted(measured.odd):
        parts += [regular(done, row)] if row > done else []
        parts.append(_take_one(monitor, int(measured.stamp[row]), measured.odd[row],
                               None if torque is None else torque[row], rejected))
        done = row + 1
    if done < len(effort):
        parts.append(regular(done, len(effort)))
    return _join(parts)


def _take_one(monitor, stamp, message, torque, rejected):
    try:
        return _as_row(monitor.take(stamp, message, torque))
    except SampleError as error:
        rejected[str(error)] += 1
        return _as_row(None)


def _as_row(answer):
    """One answer, or None, as arrays of one row."""
    state = answer.state if answer is not None else None
    fault = answer.fault if answer is not None else None
    return SimpleNamespace(
        answered=np.array([state is not None]), has_fault=np.array([fault is not None]),
        restarted=np.array([answer is not None and answer.restarted]),
        state=_row(state, STATE_FIELDS, ('mode', 'trustworthy')),
        fault=_row(fault, FAULT_FIELDS, ()),
        events=[(0, event) for event in answer.events] if answer is not None else [],
        reports=[(0, answer.status)] if answer is not None and answer.status is not None else [])


def _row(fields, types, single):
    return SimpleNamespace(**{
        name: np.array([fields[name]] if fields is not None
                       else [0 if name in single else [0, 0]], dtype=kind)
        for name, kind in types.items()})


def _join(parts):
    starts = np.cumsum([0] + [len(p.answered) for p in parts])

    def together(name):
        return np.concatenate([getattr(p, name) for p in parts])

    def nested(name, types):
        return SimpleNamespace(**{field: np.concatenate(
            [getattr(getattr(p, name), field) for p in parts]) for field in types})

    def rows(name):
        return [(int(start) + row, what) for start, p in zip(starts, parts)
                for row, what in getattr(p, name)]

    return SimpleNamespace(
        answered=together('answered'), has_fault=together('has_fault'),
        restarted=together('restarted'), state=nested('state', STATE_FIELDS),
        fault=nested('fault', FAULT_FIELDS), events=rows('events'), reports=rows('reports'))
