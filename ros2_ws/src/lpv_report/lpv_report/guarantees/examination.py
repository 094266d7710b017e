"""The certificate of the gains of a run, verified again."""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from lpv_core.certificate.conditions import verify
from lpv_core.certificate.error_system import link_errors
from lpv_core.certificate.exact_proof import prove
from lpv_core.certificate.gains import Gains
from lpv_core.model.arm import ArmParameters
from lpv_core.support.errors import LpvError
from lpv_report.guarantees.gains_source import UsedGains

_OF_THE_FILE = 'gains file: '
_RELATIVE, _ABSOLUTE = 1e-4, 1e-8
"""By how much margins may differ from those in the file: processors round differently."""


@dataclass(frozen=True)
class CheckRow:
    """One inequality."""

    name: str  # what it is
    margin: float  # rebuilt now; negative where it holds
    stored: float | None  # the margin that the file claims; None where it claims none
    holds: bool  # whether it is satisfied now

    @property
    def changed(self) -> bool:
        """Whether the file claims another margin than its gains have."""
        if self.stored is None:
            # What is checked of the file as a whole has no margin in it.
            return not self.name.startswith(_OF_THE_FILE)
        return not np.isclose(self.margin, self.stored, rtol=_RELATIVE, atol=_ABSOLUTE)


@dataclass(frozen=True)
class Certificate:
    """What the gains prove, as far as it could be verified."""

    facts: list  # name and value
    checks: list  # all inequalities
    proved: int  # how many were proved in exact rational arithmetic
    refuted: list  # those that exact arithmetic refutes
    seconds: float  # time that all of it took [s]
    problem: str = ''  # why nothing could be rebuilt; empty otherwise

    @property
    def failed(self) -> list[str]:
        """Names of the inequalities that do not hold."""
        names = [check.name for check in self.checks if not check.holds]
        return names + [name for name in self.refuted if name not in names]

    @property
    def changed(self) -> bool:
        """Whether margins in the file are not those of its gains."""
        return any(check.changed for check in self.checks)

    @property
    def holds(self) -> bool:
        """Whether the certificate holds now, and is the one that the design wrote."""
        return not (self.problem or self.failed or self.changed) and bool(self.checks)


def examine(used: UsedGains, arm: ArmParameters) -> Certificate | None:
    """Verify the certificate of some gains, without any solver.

    Parameters
    ----------
    used : UsedGains
        The gains.
    arm : ArmParameters
        The arm of the run.

    Returns
    -------
    Certificate or None
        What holds now; None if the gains are not known.
    """
    gains, begin = used.gains, time.perf_counter()
    if gains is None:
        return None
    origin = _origin(used, gains)
    try:
        gains.check_arm(arm, used.source)
        checks = verify(arm, gains)
        exact = prove(arm, gains)
    except (LpvError, ArithmeticError, np.linalg.LinAlgError) as error:
        return Certificate(origin, [], 0, [], time.perf_counter() - begin, str(error))
    stored = gains.certificate.get('margins')
    stored = stored if isinstance(stored, dict) else {}
    rows = [
        CheckRow(c.name, float(c.margin), _number(stored.get(c.name)), bool(c.holds))
        for c in checks
    ]
    return Certificate(
        [*origin, *_properties(arm, gains)],
        rows,
        sum(exact.values()),
        [name for name, holds in exact.items() if not holds],
        time.perf_counter() - begin,
    )


def _number(value: object) -> float | None:
    return float(value) if isinstance(value, (int, float)) else None


def _origin(used: UsedGains, gains: Gains) -> list[tuple[str, str]]:
    kept: dict[str, Any] = gains.certificate
    observer: Any = gains.observer
    controller: Any = gains.controller
    versions = [
        f'{name.removesuffix("_version")} {value}'
        for name, value in kept.items()
        if str(name).endswith('_version')
    ]
    status = [
        f'{part} {kept[key]}'
        for part, key in (('observer', 'observer_status'), ('controller', 'controller_status'))
        if key in kept
    ]
    return [
        ('gains file', used.source),
        ('SHA-256 of the file', used.digest),
        ('designed for arm', gains.arm_name),
        ('SHA-256 of the arm', gains.arm_sha256),
        ('method', f'observer {observer.method}, controller {controller.method}'),
        ('solver', ', '.join([str(kept.get('solver', 'unknown')), *versions])),
        ('solver said', '; '.join(status) or 'nothing'),
    ]


def _properties(arm: ArmParameters, gains: Gains) -> list[tuple[str, str]]:
    observer: Any = gains.observer
    controller: Any = gains.controller
    sigma = ', '.join(f'{value:.4f}' for value in observer.fault_sigma)
    return [
        ('certified region', _region(arm)),
        *(_exact if observer.method == 'exact' else _paper)(arm, observer),
        ('standard deviation of the fault estimates', f'at most {sigma} rad'),
        ('decay of the tracking error, \u03b1', f'{controller.decay:g} /s'),
    ]


def _region(arm: ArmParameters) -> str:
    limits = [
        f'link {i + 1} within {np.degrees(np.arccos(low)):.1f}\u00b0 (cos \u03b8 \u2265 {low:g})'
        for i, low in enumerate(arm.cos_min)
    ]
    way = 'upwards' if arm.sign > 0 else 'downwards'
    return f'{", ".join(limits)} of the vertical {way}'


def _exact(arm: ArmParameters, observer: Any) -> list[tuple[str, str]]:
    torque = ', '.join(f'{1.0 / link.slopes[0]:.3g}' for link in link_errors(arm))
    return [
        (
            'decay of the estimation error',
            f'{observer.decay:g} /s, poles up to {observer.fastest:g} /s',
        ),
        ('\u03b3, from unknown torques to the angle errors', f'{torque} rad/(N m)'),
    ]


def _paper(_: ArmParameters, observer: Any) -> list[tuple[str, str]]:
    box = ', '.join(f'[{low:g}, {high:g}]' for low, high in observer.box)
    return [
        (
            'decay of the estimation error',
            f'{observer.decay:g} /s, poles up to {observer.q + observer.r:g} /s',
        ),
        ('\u03b3, from disturbances and faults', f'{observer.gamma:g}'),
        ('box of \u03c6\u2081, \u03c6\u2082, \u03c6\u2083', f'{box}, LMI ({observer.lmi})'),
    ]
