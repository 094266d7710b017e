"""What is said of sensors and estimates: states, modes, alarms; values as in the messages."""

from dataclasses import dataclass, field
from enum import IntEnum


class Mode(IntEnum):
    """What the last estimate rests on; values as in lpv_msgs/StateEstimate."""

    OBSERVING = 0
    HOLDING = 1
    INITIALISING = 2
    STALE = 3
    NO_ESTIMATE = 4


class SensorState(IntEnum):
    """State of a sensor's diagnosis; values as in lpv_msgs/FaultEstimate."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3
    NOT_DIAGNOSABLE = 4


class AlarmEvent(IntEnum):
    """Kinds of alarm events; values as in lpv_msgs/FaultAlarm."""

    RAISED = 0
    UPDATED = 1
    CLEARED = 2


KINDS = ('bias', 'drift', 'scale', 'stuck', 'noise', 'spike', 'dropout', 'rate_bias')
"""Kinds of faults that alarms name."""
RATE_BIAS = KINDS[-1]
"""The kind that is about a sensor's rate: its alarm stands beside one of the position."""
GUARANTEED, STATISTICAL = 'guaranteed', 'statistical'
"""Bases of an alarm: no healthy arm inside its file shows this, or the mean time between false
alarms."""


def subject(kind: str) -> str:
    """What alarms of a kind are about: one sensor may have one of each subject at a time.

    Parameters
    ----------
    kind : str
        One of `KINDS`.

    Returns
    -------
    str
        `RATE_BIAS` or 'dropout', else '': the error of the position, whose kind may change.
    """
    return kind if kind in (RATE_BIAS, 'dropout') else ''


def blamed(sensor: str, kind: str) -> str:
    """What an alarm of a kind blames, in words: the sensor, or its rate."""
    return f'{sensor} (rate)' if kind == RATE_BIAS else sensor


def size_unit(kind: str, unit: str) -> str:
    """Unit of the size of a fault, from that of the sensor's positions."""
    return f'{unit}/s' if kind == RATE_BIAS else unit


@dataclass(frozen=True)
class Alarm:
    """One alarm event of one sensor."""

    event: AlarmEvent  # raised, updated or cleared
    sensor_index: int  # index of the physical sensor
    sensor: str  # its name
    onset: int  # when the fault began [ns]
    detected: int  # time of the decision [ns]
    size: float  # fault at the event, with sign [rad]; [rad/s] of a rate sensor's
    bound: float  # on the error of the size
    kind: str  # one of `KINDS`
    confidence: float  # that this sensor is to blame; 1, exactly, where that is guaranteed
    # `GUARANTEED` or `STATISTICAL`; no field of the message
    basis: str = field(default=STATISTICAL, kw_only=True)
    unit: str = field(default='rad', kw_only=True)  # of positions of the sensor
    # of a drift, where it is known [unit/s]; no field of the message
    rate: float = field(default=0.0, kw_only=True, compare=False)
