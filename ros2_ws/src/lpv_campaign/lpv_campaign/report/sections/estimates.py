"""Error of the fault estimates against the configuration, and what the design guarantees."""

from dataclasses import replace
from typing import Any

import numpy as np

from lpv_campaign.execution.run_metrics import BINS
from lpv_campaign.report.statistics.intervals import spread
from lpv_campaign.report.statistics.results import Results
from lpv_core.model.arm import ArmParameters
from lpv_core.serial_arm.description import SerialArm
from lpv_core.support.errors import LpvError
from lpv_design.guarantee import guarantee

_LEAST_SAMPLES = 20.0
"""A run needs so many samples in a class to count in its spread."""


def estimates(results: Results) -> list[dict[str, Any]]:
    """RMS error over classes of abs(cos(theta_i)), by design and sensor.

    Returns ``design``, ``sensor``, and ``classes`` with ``low``, ``high`` (of the cosine),
    ``samples``, ``rms`` over all samples, and the spread ``runs`` of the RMS of single runs
    [rad]; ``threshold``: at rest, by cosine, least and largest over the other link's angles
    [rad].
    """
    if isinstance(results.campaign.arm, SerialArm):
        return []  # see `sensor_errors`
    entries, designs = [], results.text('design')
    for design in dict.fromkeys(designs):
        chosen = designs == design
        bounds = _guaranteed(results, design, chosen)
        for i, sensor in enumerate(results.sensors):
            squares = results.lists(f'error_squares_{i + 1}')[chosen]
            counts = results.lists(f'error_counts_{i + 1}')[chosen]
            entries.append(
                {
                    'design': design,
                    'sensor': sensor,
                    'classes': _classes(squares, counts),
                    'threshold': bounds[i],
                    'mean_threshold': spread(results.number(f'mean_threshold_{i + 1}')[chosen]),
                }
            )
    return entries


def sensor_errors(results: Results) -> list[dict[str, Any]]:
    """RMS error of each sensor's fault estimate and its mean threshold, spreads over runs [rad]."""
    return [
        {
            'sensor': sensor,
            'error': spread(results.number(f'error_rms_{i + 1}')),
            'threshold': spread(results.number(f'mean_threshold_{i + 1}')),
        }
        for i, sensor in enumerate(results.sensors)
    ]


def _classes(squares: np.ndarray, counts: np.ndarray) -> list[dict[str, Any]]:
    found = []
    for k in np.flatnonzero(counts.sum(axis=0) > 0.0):
        enough = counts[:, k] >= _LEAST_SAMPLES
        runs = np.sqrt(squares[enough, k] / counts[enough, k])
        found.append(
            {
                'low': float(BINS[k]),
                'high': float(BINS[k + 1]),
                'samples': int(counts[:, k].sum()),
                'rms': float(np.sqrt(squares[:, k].sum() / counts[:, k].sum())),
                'runs': spread(runs),
            }
        )
    return found


def _guaranteed(results: Results, design: str, chosen: np.ndarray) -> list[list[dict[str, Any]]]:
    """Thresholds at rest of both sensors over their own link's angle, by the design's map."""
    times = results.number('sample_time')[chosen]
    times, arm = times[np.isfinite(times)], results.campaign.arm
    time = float(times[0]) if times.size else arm.sample_time
    if not isinstance(arm, ArmParameters):
        return [[], []]
    try:
        found = guarantee(replace(arm, sample_time=time), results.campaign.gains(design, time))
    except (LpvError, KeyError):
        return [[], []]
    cosine = np.cos(found.deviation)
    lines = []
    for i in range(2):
        values = found.threshold[:, :, i] if i == 0 else found.threshold[:, :, i].T
        lines.append(
            [
                {
                    'cosine': float(c),
                    'least': float(row.min()),
                    'largest': float(row.max()) if np.isfinite(row.max()) else None,
                }
                for c, row in sorted(zip(cosine, values), key=lambda pair: pair[0])
                if np.isfinite(row.min())
            ]
        )
    return lines
