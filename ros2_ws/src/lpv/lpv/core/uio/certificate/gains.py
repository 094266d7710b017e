"""Gains of observer and controller, and the YAML parameter file that carries them."""

from dataclasses import MISSING, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.loop_gains import DesignedForArm, serial_parameters
from lpv.core.support.config import Section, read_yaml, sha256_of, write_parameters
from lpv.core.support.entries import array, entry, part, plain_entries, positive, read_entries
from lpv.core.support.errors import ConfigError

FORMAT = 3
"""Of the file; others are not read."""
METHODS = ('paper', 'exact')


@dataclass(frozen=True)
class PaperObserverGains:
    """Observer of method ``paper``, eqs. (41) and (56), with what its certificate claims."""

    box: np.ndarray = array(3, 2)  # ranges of phi1, phi2, phi3
    t1: np.ndarray = array(6, 6)  # decoupling matrix T1, eq. (41), row by row
    t2: np.ndarray = array(6, 4)  # decoupling matrix T2, eq. (41), row by row
    k: np.ndarray = array(8, 6, 4)  # K of all vertices, eq. (56), row by row
    lyapunov: np.ndarray = array(6, 6)  # Lyapunov matrix P, row by row
    lmi: str = entry('text', choices=('55', '54+disc'))  # inequalities that hold
    gamma: float = positive()  # attenuation level [1]
    q: float = positive()  # distance of the centre of the poles' disc [1/s]
    r: float = positive()  # radius of that disc [1/s]
    # standard deviations of the fault estimates [rad]
    fault_sigma: np.ndarray = array(2, low=0.0)
    method = 'paper'

    @property
    def decay(self) -> float:
        """Certified decay rate [1/s]."""
        return self.q - self.r


@dataclass(frozen=True)
class ExactObserverGains:
    """Observer of method ``exact``: one second-order error system for each link."""

    kappa: np.ndarray = array(2, above=0.0)  # kappa of both links [1/(kg m2)]
    mu: np.ndarray = array(2, above=0.0)  # mu of both links [1/s]
    lyapunov: np.ndarray = array(2, 2, 2)  # P of each link for (e_i, m_i / Xi_ii), row by row
    decay: float = positive()  # certified slowest pole of the error [1/s]
    fastest: float = positive()  # certified fastest pole of the error [1/s]
    # standard deviations of the fault estimates [rad]
    fault_sigma: np.ndarray = array(2, low=0.0)
    method = 'exact'


@dataclass(frozen=True)
class MotionCertificate:
    """What `sampled_motion.SampledLoop` proves of the sampled loop in motion."""

    lyapunov: np.ndarray = array(8, 8)  # P for (theta, theta rates, eps, u), row by row
    rate: float = entry('number', low=0.0)  # fastest link that it holds for [rad/s]
    decay: float = positive()  # certified decay rate of the sampled loop in motion [1/s]


@dataclass(frozen=True)
class ControllerGains:
    """State feedback with integral action, eq. (65), and its certificate, eqs. (67) and (68).

    Method ``paper`` is u = M1 x + M2 eps; ``exact`` adds reference feed-forward.
    """

    method: str = entry('text', choices=METHODS)
    m1: np.ndarray = array(2, 4)  # M1, absolute coordinates, row by row [N m/rad], [N m s/rad]
    m2: np.ndarray = array(2, 2)  # M2, absolute coordinates, row by row [N m/(rad s)]
    lyapunov: np.ndarray = array(6, 6)  # P = Q^-1 of the certificate, eq. (68), row by row
    decay: float = positive()  # certified alpha of eq. (67) [1/s]
    # lower end of the box of method paper [1]
    sinc_min: float = entry('number', default=-0.2, low=-0.3, high=0.99)
    # of the sampled loop in motion (method ``exact``), where there is one
    motion: MotionCertificate | None = part(MotionCertificate, default=None)

    @property
    def feedback(self) -> np.ndarray:
        """(M1, M2) of eq. (65), shape (2, 6)."""
        return np.hstack([self.m1, self.m2])


@dataclass(frozen=True)
class Gains(DesignedForArm):
    """Everything that a design hands to the nodes."""

    # which of both its method says
    observer: ExactObserverGains | PaperObserverGains = field(default=MISSING)  # type: ignore[assignment]
    controller: ControllerGains = part(ControllerGains)
    # margins, solver and versions, as text and numbers: information, nothing is computed from it
    certificate: dict = field(default_factory=dict)
    # of the numbers as they were written; empty for gains that were not read from a file
    checksum: str = ''
    section = 'gains'


def gains_checksum(gains: Gains) -> str:
    """Hash of every number that observer, bound, decision and controller use."""
    return str(gains_to_dict(gains)['checksum'])


def gains_to_dict(gains: Gains) -> dict[str, Any]:
    """The mapping below ``gains`` in the parameter file: plain data, arrays row by row."""
    used = {
        'arm_sha256': gains.arm_sha256,
        'observer': {'method': gains.observer.method, **plain_entries(gains.observer)},
        'controller': plain_entries(gains.controller),
    }
    return {
        'format': FORMAT, 'arm_name': gains.arm_name, **used, 'checksum': sha256_of(used),
        'certificate': dict(gains.certificate),
    }  # fmt: skip


def parse_gains(data: dict[str, Any], source: str = 'gains') -> Gains:
    """Gains from the mapping below ``gains``.

    Raises
    ------
    ConfigError
        If anything is missing, of the wrong size, or not finite; ``source`` names the file.
    """
    top = Section(data, source, 'gains')
    if top.integer('format') != FORMAT:
        raise top.error('format', f'must be {FORMAT}; design the gains again')
    section = top.section('observer')
    method = section.text('method', choices=METHODS)
    kind: Any = ExactObserverGains if method == 'exact' else PaperObserverGains
    observer = read_entries(kind, section)
    if method == 'paper' and np.any(observer.box[:, 0] >= observer.box[:, 1]):
        raise section.error('box', 'must have lower ends below upper ends')
    if method == 'paper' and not observer.r < observer.q:
        raise section.error('r', 'must be below q')
    information, checksum = top.plain('certificate'), top.text('checksum')
    return read_entries(Gains, top, observer=observer, certificate=information, checksum=checksum)


def save_gains(gains: Gains, path: str | Path, comment: str = '') -> None:
    """Write gains as a ROS 2 parameter file (``/**: ros__parameters: gains: ...``).

    ``comment`` is text for the head of the file; parent directories are made.
    """
    write_parameters(path, {'gains': gains_to_dict(gains)}, comment)


def load_gains(path: str | Path) -> Gains:
    """Gains from a file as written by `save_gains`; ConfigError if it is none."""
    data = read_yaml(path)
    try:
        nested = data['/**']['ros__parameters']['gains']
    except (KeyError, TypeError):
        reason = 'is missing: not a gains file'
        if serial_parameters(path) is not None:
            reason = 'is missing: it certifies a tracking loop; this arm has no observer with gains'
        raise ConfigError('/**.ros__parameters.gains', reason, str(path)) from None
    return parse_gains(nested, str(path))
