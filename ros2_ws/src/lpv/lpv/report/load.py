"""All that a report says of a recorded run, loaded at once."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from lpv.bag.rosbag.output_folder import GAINS_NAME, SCENARIO_NAME
from lpv.bag.run.node_reports import NodeReport, node_reports
from lpv.bag.run.record import load_run
from lpv.bag.run.streams import RunRecord
from lpv.core.control.path import TimedPath
from lpv.core.serial_arm.description import SerialArm
from lpv.core.simulation.scenario import load_scenario
from lpv.core.support.errors import LpvError
from lpv.report.certificate import Certificate, beside_bag, examine
from lpv.report.history import (
    Episode,
    FaultSpan,
    Motion,
    Phase,
    episodes,
    missed_faults,
    motion,
    phases,
)
from lpv.report.table import Row, make_table


@dataclass(frozen=True)
class Run:
    """All that is known of a recorded run."""

    record: RunRecord
    arm: SerialArm
    title: str  # heading of its page
    certificate: Certificate  # of the gains
    alarms: list[Episode]
    missed: list[FaultSpan]  # true faults without an alarm
    phases: list[Phase]  # intervals without an answer, stops, speeds above the limits
    motion: Motion  # extremes
    table: list[Row]  # of `make_table`
    path: TimedPath | None = None  # reference, with the obstacle


def load(
    bag: str | Path,
    arm: SerialArm,
    path: TimedPath | None = None,
    title: str = 'Run',
    gains: str | Path | None = None,
    source: str = '',
    topic: str | None = None,  # of the measurements, in a bag of several arms
) -> Run:
    """Read all that a report needs; path and gains are those of the bag if not given."""
    record = load_run(bag, topic, arm.joint_names)
    streams = ('fault_estimate', 'state_estimate', 'torque_command')
    known = next((record.topics[name] for name in streams if name in record.topics), None)
    reports = {} if known is None else node_reports(bag, known.rpartition('/')[0])
    if gains is None and (gains := beside_bag(bag, GAINS_NAME)) is not None:
        source = f'{gains.name} of the bag'
    scenario = beside_bag(bag, SCENARIO_NAME)
    if path is None and scenario is not None:
        path = planned_path(scenario, arm)
    return analyse(record, arm, reports, examine(gains, arm, source), title, path)


def planned_path(scenario: str | Path, arm: SerialArm) -> TimedPath | None:
    """Path of a scenario; None where it is damaged."""
    try:
        return load_scenario(scenario).path(arm)
    except LpvError:  # a damaged copy must not stand in the way of a report
        return None


def analyse(
    record: RunRecord,
    arm: SerialArm,
    reports: Mapping[str, Sequence[NodeReport]],
    certificate: Certificate,
    title: str = 'Run',
    path: TimedPath | None = None,
) -> Run:
    """What a record says: alarms, misses, phases, motion, table."""
    alarms = episodes(record)
    missed, found = missed_faults(record, alarms), phases(record, arm, reports)
    table, moved = make_table(record, arm), motion(record, arm)
    return Run(record, arm, title, certificate, alarms, missed, found, moved, table, path)
