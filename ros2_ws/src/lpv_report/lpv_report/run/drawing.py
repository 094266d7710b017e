"""All figures of a report, in the order of the page."""

from collections.abc import Callable, Iterator

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from lpv_core.control.path import CartesianPath
from lpv_core.serial_arm.description import SerialArm
from lpv_report.guarantees.detectability_figures import over_configurations, over_time
from lpv_report.history.episodes import true_faults
from lpv_report.history.timeline import timeline
from lpv_report.run.content import Findings
from lpv_report.run.figures import cartesian, faults, measured, states, torques
from lpv_report.style import SETTINGS


def draw_all(findings: Findings, path: CartesianPath | None) -> Iterator[tuple[str, Figure]]:
    """Draw everything that a run has to show; each figure is closed when the next one is wanted."""
    record, arm, able = findings.record, findings.arm, findings.detectable
    names = arm.sensor_names
    makers: dict[str, Callable[[], Figure | None]] = {
        'timeline': lambda: timeline(record, findings.phases, true_faults(record), names),
        'path': lambda: None if isinstance(arm, SerialArm) else cartesian(record, arm, path),
        'faults': lambda: faults(record, names, isinstance(arm, SerialArm)),
        'measured': lambda: measured(record),
        'states': lambda: states(record),
        'torques': lambda: torques(record),
    }
    if able is not None and not isinstance(arm, SerialArm):
        makers['detectability'] = lambda: over_time(able, record, names)
        makers['map'] = lambda: over_configurations(able, arm)
    for name, make in makers.items():
        with plt.rc_context(SETTINGS):
            figure = make()
            if figure is not None:
                yield name, figure
                plt.close(figure)
