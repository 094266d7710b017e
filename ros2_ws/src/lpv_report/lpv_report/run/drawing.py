"""All figures of a report, in the order of the page."""

from collections.abc import Iterator, Sequence

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from lpv_bag.run.streams import RunRecord
from lpv_core.control.path import CartesianPath
from lpv_core.model.arm import ArmParameters
from lpv_report.guarantees.detectability import Detectability
from lpv_report.guarantees.detectability_figures import over_configurations, over_time
from lpv_report.history.episodes import true_faults
from lpv_report.history.phases import Phase
from lpv_report.history.timeline import timeline
from lpv_report.run.figures import cartesian, faults, measured, states, torques
from lpv_report.run.style import SETTINGS


def draw_all(
    record: RunRecord,
    arm: ArmParameters,
    path: CartesianPath | None = None,
    found: Sequence[Phase] = (),
    able: Detectability | None = None,
) -> Iterator[tuple[str, Figure]]:
    """Draw everything that a run has to show."""
    names = arm.sensor_names
    makers = {
        'timeline': lambda: timeline(record, found, true_faults(record), names),
        'path': lambda: cartesian(record, arm, path),
        'faults': lambda: faults(record, names),
        'measured': lambda: measured(record),
        'states': lambda: states(record),
        'torques': lambda: torques(record),
    }
    if able is not None:
        makers['detectability'] = lambda: over_time(able, record, names)
        makers['map'] = lambda: over_configurations(able, arm)
    for name, make in makers.items():
        with plt.rc_context(SETTINGS):
            figure = make()
            if figure is not None:
                yield name, figure
                plt.close(figure)
