"""Gains of observer and controller, and the YAML parameter file that carries them."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from lpv_core.model.arm import ArmParameters
from lpv_core.support.config import Section, read_yaml, sha256_of, write_parameters
from lpv_core.support.errors import ConfigError

FORMAT = 3
METHODS = ('paper', 'exact')


@dataclass(frozen=True)
class PaperObserverGains:
    """Observer of method ``paper``, eqs. (41) and (56), with what its certificate claims."""

    t1: np.ndarray  # decoupling matrix T1, eq. (41), shape (6, 6)
    t2: np.ndarray  # decoupling matrix T2, eq. (41), shape (6, 4)
    k: np.ndarray  # K_i, eq. (56), shape (8, 6, 4)
    lyapunov: np.ndarray  # P, shape (6, 6)
    box: np.ndarray  # ranges of phi1, phi2, phi3, shape (3, 2)
    lmi: str  # which inequalities hold: '55' or '54+disc'
    gamma: float  # attenuation level
    q: float  # the poles' disc has its centre at -q [1/s]
    r: float  # radius of that disc [1/s]
    fault_sigma: np.ndarray  # standard deviation of the fault estimates, shape (2,) [rad]
    method = 'paper'

    @property
    def decay(self) -> float:
        """Certified decay rate [1/s]."""
        return self.q - self.r


@dataclass(frozen=True)
class ExactObserverGains:
    """Observer of method ``exact``: one second-order error system for each link."""

    kappa: np.ndarray  # kappa_i, shape (2,) [1/(kg m2)]
    mu: np.ndarray  # mu_i, shape (2,) [1/s]
    lyapunov: np.ndarray  # P of each link, for the state (e_i, m_i / Xi_ii), shape (2, 2, 2)
    decay: float  # certified slowest pole of the error [1/s]
    fastest: float  # certified fastest pole of the error [1/s]
    # bound on the standard deviation of the fault estimates, shape (2,) [rad]
    fault_sigma: np.ndarray
    method = 'exact'


@dataclass(frozen=True)
class MotionCertificate:
    """What `sampled_motion.SampledLoop` proves of the sampled loop in motion."""

    lyapunov: np.ndarray  # P for the state (theta, theta', eps, u), shape (8, 8)
    rate: float  # largest absolute rate of a link [rad/s]
    decay: float  # certified decay rate [1/s]


@dataclass(frozen=True)
class ControllerGains:
    """State feedback with integral action, eq. (65), and its certificate, eqs. (67) and (68)."""

    method: str  # ``paper`` is u = M1 x + M2 eps; ``exact`` adds reference feed-forward
    m1: np.ndarray  # M1, absolute coordinates, shape (2, 4)
    m2: np.ndarray  # M2, absolute coordinates, shape (2, 2)
    lyapunov: np.ndarray  # P = Q^-1 of the certificate, eq. (68), shape (6, 6)
    decay: float  # certified alpha of eq. (67) [1/s]
    sinc_min: float = -0.2  # lower end of the paper's box (method ``paper``)
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
        """Refuse gains of another arm.

        Parameters
        ----------
        arm : ArmParameters
            The arm in use.
        source : str, optional
            Name for the error message.

        Raises
        ------
        ConfigError
            If the hash of the arm's parameters differs from the one the gains were made for.
        """
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
    """Nest gains as plain YAML data, arrays flattened row-major.

    Parameters
    ----------
    gains : Gains
        The gains.

    Returns
    -------
    dict
        The mapping below ``gains`` in the parameter file.
    """
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
    """Rebuild gains from nested data, checking sizes and finiteness.

    Parameters
    ----------
    data : dict
        The mapping below ``gains``.
    source : str, optional
        Name for error messages.

    Returns
    -------
    Gains
        Validated gains.

    Raises
    ------
    ConfigError
        If anything is missing, of the wrong size, or not finite.
    """
    top = Section(data, source, 'gains')
    if top.integer('format') != FORMAT:
        raise top.error('format', f'must be {FORMAT}; design the gains again')
    obs, con = top.section('observer'), top.section('controller')
    is_exact = obs.text('method', choices=METHODS) == 'exact'
    observer = _exact_observer(obs) if is_exact else _paper_observer(obs)
    if np.any(observer.fault_sigma < 0.0):
        raise obs.error('fault_sigma', 'must not be negative')
    controller = ControllerGains(
        method=con.text('method', choices=METHODS),
        m1=con.matrix('m1', (2, 4)),
        m2=con.matrix('m2', (2, 2)),
        lyapunov=con.matrix('lyapunov', (6, 6)),
        decay=con.number('decay', above=0.0),
        sinc_min=con.number('sinc_min', -0.2, -0.3, 0.99),
        motion=_motion(con.section('motion')) if 'motion' in con else None,
    )
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


def _paper_observer(section: Section) -> PaperObserverGains:
    box = section.matrix('box', (3, 2))
    if np.any(box[:, 0] >= box[:, 1]):
        raise section.error('box', 'must have lower ends below upper ends')
    gains = PaperObserverGains(
        t1=section.matrix('t1', (6, 6)),
        t2=section.matrix('t2', (6, 4)),
        k=section.matrix('k', (8, 6, 4)),
        lyapunov=section.matrix('lyapunov', (6, 6)),
        box=box,
        lmi=section.text('lmi', choices=('55', '54+disc')),
        gamma=section.number('gamma', above=0.0),
        q=section.number('q', above=0.0),
        r=section.number('r', above=0.0),
        fault_sigma=section.matrix('fault_sigma', (2,)),
    )
    if not gains.r < gains.q:
        raise section.error('r', 'must be below q')
    return gains


def _exact_observer(section: Section) -> ExactObserverGains:
    gains = ExactObserverGains(
        kappa=section.matrix('kappa', (2,)),
        mu=section.matrix('mu', (2,)),
        lyapunov=section.matrix('lyapunov', (2, 2, 2)),
        decay=section.number('decay', above=0.0),
        fastest=section.number('fastest', above=0.0),
        fault_sigma=section.matrix('fault_sigma', (2,)),
    )
    for name in ('kappa', 'mu'):
        if np.any(getattr(gains, name) <= 0.0):
            raise section.error(name, 'must be positive')
    return gains


def _motion(section: Section) -> MotionCertificate:
    motion = MotionCertificate(
        lyapunov=section.matrix('lyapunov', (8, 8)),
        rate=section.number('rate', low=0.0),
        decay=section.number('decay', above=0.0),
    )
    section.finish()
    return motion


def save_gains(gains: Gains, path: str | Path, comment: str = '') -> None:
    """Write gains as a ROS 2 parameter file (``/**: ros__parameters: gains: ...``).

    Parameters
    ----------
    gains : Gains
        The gains.
    path : str or pathlib.Path
        File to write; parent directories are made.
    comment : str, optional
        Text for the head of the file.
    """
    write_parameters(path, {'gains': gains_to_dict(gains)}, comment)


def load_gains(path: str | Path) -> Gains:
    """Read a gains file.

    Parameters
    ----------
    path : str or pathlib.Path
        As written by `save_gains`.

    Returns
    -------
    Gains
        Validated gains.

    Raises
    ------
    ConfigError
        If the file is not a gains file.
    """
    data = read_yaml(path)
    try:
        nested = data['/**']['ros__parameters']['gains']
    except (KeyError, TypeError):
        raise ConfigError(
            '/**.ros__parameters.gains', 'is missing: not a gains file', str(path)
        ) from None
    return parse_gains(nested, str(path))
