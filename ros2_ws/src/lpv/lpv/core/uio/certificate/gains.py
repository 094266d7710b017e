"""Gains of observer and controller, and the YAML parameter file that carries them."""

from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.loop_gains import serial_parameters
from lpv.core.support.config import Section, read_yaml, sha256_of, write_parameters
from lpv.core.support.errors import ConfigError
from lpv.core.uio.model.arm import ArmParameters

FORMAT = 3
"""Of the file; others are not read."""
METHODS = ('paper', 'exact')


def _entry(how: str, *details: Any, **limits: Any) -> Any:
    """An entry of a gains file: the method of `Section` that reads it, with its arguments."""
    return field(metadata={'entry': (how, details, limits)})


def _matrix(*shape: int) -> Any:
    return _entry('matrix', shape)


def _positive() -> Any:
    return _entry('number', above=0.0)


@dataclass(frozen=True)
class PaperObserverGains:
    """Observer of method ``paper``, eqs. (41) and (56), with what its certificate claims."""

    box: np.ndarray = _matrix(3, 2)  # ranges of phi1, phi2, phi3
    t1: np.ndarray = _matrix(6, 6)  # decoupling matrix T1, eq. (41), row by row
    t2: np.ndarray = _matrix(6, 4)  # decoupling matrix T2, eq. (41), row by row
    k: np.ndarray = _matrix(8, 6, 4)  # K of all vertices, eq. (56), row by row
    lyapunov: np.ndarray = _matrix(6, 6)  # Lyapunov matrix P, row by row
    lmi: str = _entry('text', choices=('55', '54+disc'))  # inequalities that hold
    gamma: float = _positive()  # attenuation level [1]
    q: float = _positive()  # distance of the centre of the poles' disc [1/s]
    r: float = _positive()  # radius of that disc [1/s]
    fault_sigma: np.ndarray = _matrix(2)  # standard deviations of the fault estimates [rad]
    method = 'paper'

    @property
    def decay(self) -> float:
        """Certified decay rate [1/s]."""
        return self.q - self.r


@dataclass(frozen=True)
class ExactObserverGains:
    """Observer of method ``exact``: one second-order error system for each link."""

    kappa: np.ndarray = _matrix(2)  # kappa of both links [1/(kg m2)]
    mu: np.ndarray = _matrix(2)  # mu of both links [1/s]
    lyapunov: np.ndarray = _matrix(2, 2, 2)  # P of each link for (e_i, m_i / Xi_ii), row by row
    decay: float = _positive()  # certified slowest pole of the error [1/s]
    fastest: float = _positive()  # certified fastest pole of the error [1/s]
    fault_sigma: np.ndarray = _matrix(2)  # standard deviations of the fault estimates [rad]
    method = 'exact'


@dataclass(frozen=True)
class MotionCertificate:
    """What `sampled_motion.SampledLoop` proves of the sampled loop in motion."""

    lyapunov: np.ndarray = _matrix(8, 8)  # P for (theta, theta rates, eps, u), row by row
    rate: float = _entry('number', low=0.0)  # fastest link that it holds for [rad/s]
    decay: float = _positive()  # certified decay rate of the sampled loop in motion [1/s]


@dataclass(frozen=True)
class ControllerGains:
    """State feedback with integral action, eq. (65), and its certificate, eqs. (67) and (68).

    Method ``paper`` is u = M1 x + M2 eps; ``exact`` adds reference feed-forward.
    """

    method: str = _entry('text', choices=METHODS)
    m1: np.ndarray = _matrix(2, 4)  # M1, absolute coordinates, row by row [N m/rad], [N m s/rad]
    m2: np.ndarray = _matrix(2, 2)  # M2, absolute coordinates, row by row [N m/(rad s)]
    lyapunov: np.ndarray = _matrix(6, 6)  # P = Q^-1 of the certificate, eq. (68), row by row
    decay: float = _positive()  # certified alpha of eq. (67) [1/s]
    # lower end of the box of method paper [1]
    sinc_min: float = _entry('number', default=-0.2, low=-0.3, high=0.99)
    # of the sampled loop in motion (method ``exact``), where there is one
    motion: MotionCertificate | None = None


@dataclass(frozen=True)
class Gains:
    """Everything that a design hands to the nodes."""

    arm_name: str  # of the arm that the gains belong to
    arm_sha256: str  # hash of its parameters
    observer: ExactObserverGains | PaperObserverGains  # observer part
    controller: ControllerGains  # controller part
    # margins, solver and versions, as text and numbers: information, nothing is computed from it
    certificate: dict = field(default_factory=dict)
    # of the numbers as they were written; empty for gains that were not read from a file
    checksum: str = ''

    def check_arm(self, arm: ArmParameters, source: str = 'gains') -> None:
        """Refuse gains of another arm: ConfigError if the hash of its parameters differs."""
        if self.arm_sha256 != arm.sha256():
            raise ConfigError(
                'gains.arm_sha256',
                f'these gains were designed for another arm ({self.arm_name!r}, '
                f'{self.arm_sha256[:12]}) than the one in use ({arm.name!r}, '
                f'{arm.sha256()[:12]}); run the design again for this arm file',
                source,
            )


def gains_checksum(gains: Gains) -> str:
    """Hash of every number that observer, bound, decision and controller use."""
    data = _numbers(gains)
    return sha256_of({name: data[name] for name in ('arm_sha256', 'observer', 'controller')})


def gains_to_dict(gains: Gains) -> dict[str, Any]:
    """The mapping below ``gains`` in the parameter file: plain data, arrays row by row."""
    return {
        **_numbers(gains),
        'checksum': gains_checksum(gains),
        'certificate': dict(gains.certificate),
    }


def _numbers(gains: Gains) -> dict[str, Any]:
    o, c = gains.observer, gains.controller
    motion = {} if c.motion is None else {'motion': _plain(c.motion)}
    return {
        'format': FORMAT,
        'arm_name': gains.arm_name,
        'arm_sha256': gains.arm_sha256,
        'observer': {'method': o.method, **_plain(o)},
        'controller': {**_plain(replace(c, motion=None)), **motion},
    }


def _plain(part: Any) -> dict[str, Any]:
    """The fields of a part of the gains, arrays flattened row-major."""
    return {
        name: value.ravel().tolist() if isinstance(value, np.ndarray) else _scalar(value)
        for name, value in vars(part).items()
        if value is not None
    }


def _scalar(value: str | float) -> str | float:
    return value if isinstance(value, str) else float(value)


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
    obs, con = top.section('observer'), top.section('controller')
    is_exact = obs.text('method', choices=METHODS) == 'exact'
    observer = _part(obs, ExactObserverGains if is_exact else PaperObserverGains)
    _check_observer(obs, observer)
    controller = _part(con, ControllerGains)
    if 'motion' in con:
        section = con.section('motion')
        controller = replace(controller, motion=_part(section, MotionCertificate))
        section.finish()
    gains = Gains(
        top.text('arm_name'),
        top.text('arm_sha256'),
        observer,
        controller,
        top.plain('certificate'),
        top.text('checksum'),
    )
    for section in (obs, con, top):
        section.finish()
    return gains


def _part(section: Section, kind: Any) -> Any:
    """A part of the gains from its section."""
    values = {}
    for one in fields(kind):
        if one.metadata:
            how, details, limits = one.metadata['entry']
            values[one.name] = getattr(section, how)(one.name, *details, **limits)
    return kind(**values)


def _check_observer(section: Section, observer: ExactObserverGains | PaperObserverGains) -> None:
    if np.any(observer.fault_sigma < 0.0):
        raise section.error('fault_sigma', 'must not be negative')
    if isinstance(observer, ExactObserverGains):
        for name in ('kappa', 'mu'):
            if np.any(getattr(observer, name) <= 0.0):
                raise section.error(name, 'must be positive')
        return
    if np.any(observer.box[:, 0] >= observer.box[:, 1]):
        raise section.error('box', 'must have lower ends below upper ends')
    if not observer.r < observer.q:
        raise section.error('r', 'must be below q')


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
