"""The result of an identification as text, and the tables of its report."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from lpv.identify.estimation.identification import Identification
from lpv.identify.estimation.torque_error import Calibration

Column = tuple[str, str, Callable[[Any, int], Any]]
"""Header, format and value of a column of a table with one row for each joint."""

FIGURES: tuple[Column, ...] = (
    ('RMS N m', '.3f', lambda r, j: r.figures.rms[j]),
    ('in band', '.3f', lambda r, j: r.figures.rms_band[j]),
    ('share', '.1%', lambda r, j: r.figures.share[j]),
    ('R2', '.4f', lambda r, j: r.figures.r2[j]),
    ('corr.', '.2f', lambda r, j: r.figures.correlation[j]),
    ('before', '.2f', lambda r, j: r.prior_figures.rms[j]),
)
_SENSED: tuple[Column, ...] = (
    ('rates', '', lambda r, j: r.sensing.rates[j]),
    ('delay ms', '.1f', lambda r, j: 1e3 * r.sensing.effort_delay[j]),
)
DRIVES: tuple[Column, ...] = (
    ('offset N m', '.3g', lambda r, j: r.arm.joints[j].friction.offset),
    ('viscous N m s', '.3g', lambda r, j: r.arm.joints[j].friction.viscous),
    ('Coulomb N m', '.3g', lambda r, j: r.arm.joints[j].friction.coulomb),
    ('slope s/rad', '.0f', lambda r, j: r.arm.joints[j].friction.coulomb_slope),
    ('load', '.3g', lambda r, j: r.arm.joints[j].friction.load),
    ('rotor kg m²', '.3g', lambda r, j: r.arm.joints[j].rotor_inertia),
    ('gain', '.4g', lambda r, j: r.arm.joints[j].torque_gain),
    ('delay ms', '.1f', lambda r, j: 1e3 * r.arm.joints[j].effort_delay),
)
SENSORS: tuple[Column, ...] = (
    ('position noise rad', '.2g', lambda r, j: r.sensing.position_noise[j]),
    ('step rad', '.2g', lambda r, j: r.sensing.quantization[j]),
    ('rate noise rad/s', '.2g', lambda r, j: r.sensing.velocity_noise[j]),
    ('rates', '', lambda r, j: r.sensing.rates[j]),
    ('explained', '.2f', lambda r, j: r.sensing.rate_evidence[j]),
    ('rate delay ms', '.1f', lambda r, j: 1e3 * r.sensing.rate_delay[j]),
)
_ERRORS: tuple[Column, ...] = (
    ('RMS N m', '.3f', lambda r, j: r.rms[j]),
    ('slow', '.3f', lambda r, j: r.error.slow[j]),
    ('N m s/rad', '.3f', lambda r, j: r.error.growth[j]),
)


def cells(result: Any, columns: Sequence[Column]) -> list[list[str]]:
    """Formatted values, a row for each joint, its name first."""
    return [
        [name, *(format(value(result, j), form) for _, form, value in columns)]
        for j, name in enumerate(result.arm.joint_names)
    ]


def _text(result: Any, columns: Sequence[Column]) -> list[str]:
    """A table for a terminal."""
    rows = [['joint', *(name for name, _, _ in columns)], *cells(result, columns)]
    widths = [max(map(len, column)) for column in zip(*rows)]
    return [
        '  '.join([row[0].ljust(widths[0]), *(c.rjust(w) for c, w in zip(row[1:], widths[1:]))])
        for row in rows
    ]


def table(result: Identification) -> str:
    """Figures of each joint and what the data do not determine, as lines for a terminal."""
    return '\n'.join([*_text(result, (*FIGURES, *_SENSED)), '', *remarks(result)])


def calibration_table(result: Calibration) -> str:
    """What a calibration found of each joint, for a terminal."""
    last = (
        '"RMS": efforts minus the torques of the model; "slow" and per rad/s: what of that the '
        f'model misses in motion, for {result.error.time:.2g} s at a time; stamps jitter by '
        f'{1e3 * result.sensing.jitter:.2g} ms.'
    )
    return '\n'.join([*_text(result, (*_ERRORS, *SENSORS[:4])), '', last, *_slides(result)])


def _slides(result: Any) -> list[str]:
    """Units of joints that slide, which headers leave out."""
    names = [joint.name for joint in result.arm.joints if joint.is_prismatic]
    return [f'Of {", ".join(names)}: N for N m, m for rad, kg for kg m².'] if names else []


def remarks(result: Identification) -> list[str]:
    """Sentences on the fit."""
    determination = result.determination
    band = result.bands.effort
    lines = [
        f'On data held back; "in band": after a causal low-pass at '
        f'{result.bands.test:.1f} Hz; "before": with the parameters given.',
        f'{int(determination.determined.sum())} of {len(determination.names)} parameters are '
        'determined by the data.',
        *_slides(result),
    ]
    if np.isfinite(band):
        lines.append(
            f'Efforts carry nothing above {band:g} Hz: the driver filters them, and the '
            'model does the same.'
        )
    weight = 'with' if result.arm.effort_includes_gravity else 'without'
    lines.append(f"Efforts are taken {weight} the arm's weight.")
    if not result.used_rates and result.sensing.rates[0] != 'none':
        lines.append('Rates are computed from positions: measured ones predict no better.')
    return lines + determination.advice(result.arm.joint_names)
