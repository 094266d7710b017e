"""Parameter file of a serial arm's tracker: bandwidth, and the certificate of the loop."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lpv.core.serial_arm.certificate.model_bounds import BOUNDS, ModelBounds, twists_of
from lpv.core.serial_arm.chain import MAX_JOINTS, FloatArray
from lpv.core.support.config import Section, read_yaml, sha256_of, write_parameters
from lpv.core.support.errors import ConfigError

FORMAT = 1
"""Of the file; others are not read."""
COEFFICIENTS = {1: 7, 2: 26}
"""Of one matrix that commutes with rotations about z, by the number of twists."""


@dataclass(frozen=True)
class LoopProof:
    """A Lyapunov function, and what it proves."""

    decay: float  # alpha: sqrt(V) falls with exp(-alpha t) [1/s]
    lyapunov: FloatArray  # P, shape (3, 3), of the sampled loop (4, 4)
    multipliers: FloatArray  # of the sectors of Gamma and Phi, shape (2,)


@dataclass(frozen=True)
class ErrorProof(LoopProof):
    """`LoopProof` of a region of motion on which the tracking error is bounded."""

    rate_share: float  # of the velocity limits, of all joints at once [-]
    acceleration: float  # largest of the reference [rad/s2]
    level: float  # mu: V ends below mu abs(omega)^2 [-]
    bound: FloatArray  # of the tracking error of each joint, shape (n,) [rad]


@dataclass(frozen=True)
class LoopGains:
    """Tracking of a serial arm, with its certificate."""

    arm_name: str
    arm_sha256: str
    bandwidth: float  # w [rad/s]
    model_error: float  # d: of each link's pseudo-inertia, in the matrix order [-]
    rate_share: float  # region: share of the velocity limits, of all joints at once [-]
    model: ModelBounds
    motion: LoopProof  # at rate_share
    sampled: LoopProof  # at rate_share
    error: ErrorProof  # at its own, smaller one
    checksum: str = ''  # of the numbers as they were written; '' if not read from a file

    def check_arm(self, arm_name: str, arm_sha256: str) -> None:
        """Refuse an arm that the certificate is not about (ConfigError)."""
        if self.arm_sha256 != arm_sha256:
            raise ConfigError(
                'loop.arm_sha256',
                f'this certificate is for another arm ({self.arm_name!r}, {self.arm_sha256[:12]}) '
                f'than the one in use ({arm_name!r}, {arm_sha256[:12]}); run lpv design for it',
                'gains',
            )


def loop_checksum(gains: LoopGains) -> str:
    """Hash of every number."""
    data = loop_to_dict(gains)
    return sha256_of({name: value for name, value in data.items() if name != 'checksum'})


def loop_to_dict(gains: LoopGains) -> dict[str, Any]:
    """The mapping below ``loop`` in the parameter file, and ``bandwidth``; arrays row by row."""

    def flat(array: FloatArray) -> list[float]:
        return [float(v) for v in np.asarray(array).ravel()]

    def proof(part: LoopProof) -> dict[str, Any]:
        return {
            name: flat(value) if isinstance(value, np.ndarray) else float(value)
            for name, value in vars(part).items()
        }

    model = gains.model
    return {
        'format': FORMAT,
        'arm_name': gains.arm_name,
        'arm_sha256': gains.arm_sha256,
        'bandwidth': float(gains.bandwidth),
        'model_error': float(gains.model_error),
        'rate_share': float(gains.rate_share),
        'motion': proof(gains.motion),
        'sampled': proof(gains.sampled),
        'error': proof(gains.error),
        'model': {
            'payload': float(model.payload),
            'damping': float(model.damping),
            'growth': float(model.growth),
            'inertia': flat(model.inertia),
            'forms': {bound: flat(model.forms[bound]) for bound in BOUNDS},
        },
        'checksum': gains.checksum,
    }


def parse_loop(data: dict[str, Any], source: str = 'gains') -> LoopGains:
    """Rebuild from nested data.

    Parameters
    ----------
    data : dict
        As of `loop_to_dict`.
    source : str, optional
        Name for error messages.

    Returns
    -------
    LoopGains
        Of checked sizes and finite numbers.

    Raises
    ------
    ConfigError
        If anything is missing, unknown, of the wrong size or not finite.
    """
    top = Section(data, source, 'loop')
    if top.integer('format') != FORMAT:
        raise top.error('format', f'must be {FORMAT}; design again')
    model, parts = top.section('model'), {}
    for name in ('motion', 'sampled', 'error'):
        parts[name] = top.section(name)
    inertia = model.numbers('inertia', MAX_JOINTS)
    n, error = len(inertia), parts['error']
    gains = LoopGains(
        arm_name=top.text('arm_name'),
        arm_sha256=top.text('arm_sha256'),
        bandwidth=top.number('bandwidth', low=0.1, high=100.0),
        model_error=top.number('model_error', low=0.0, high=0.5),
        rate_share=top.number('rate_share', above=0.0, high=1.0),
        model=ModelBounds(
            model.number('payload', low=0.0),
            model.number('damping', low=0.0),
            model.number('growth', above=0.0),
            np.array(inertia),
            _forms(model.section('forms'), n),
        ),
        motion=LoopProof(*_proof(parts['motion'], 3)),
        sampled=LoopProof(*_proof(parts['sampled'], 4)),
        error=ErrorProof(
            *_proof(error, 3),
            rate_share=error.number('rate_share', above=0.0, high=1.0),
            acceleration=error.number('acceleration', low=0.0),
            level=error.number('level', above=0.0),
            bound=np.array(error.vector('bound', n, low=0.0)),
        ),
        checksum=top.text('checksum'),
    )
    for section in (model, *parts.values(), top):
        section.finish()
    return gains


def _proof(section: Section, size: int) -> tuple[float, FloatArray, FloatArray]:
    return (
        section.number('decay', above=0.0),
        section.matrix('lyapunov', (size, size)),
        np.array(section.vector('multipliers', 2, low=0.0)),
    )


def _forms(section: Section, joints: int) -> dict[str, FloatArray]:
    forms = {
        bound: section.matrix(bound, (joints - 1, COEFFICIENTS[twists_of(bound)]))
        for bound in BOUNDS
    }
    section.finish()
    return forms


def save_loop_gains(gains: LoopGains, path: str | Path, comment: str = '') -> None:
    """Write the parameter file (``/**: ros__parameters: bandwidth, loop``), with its checksum.

    Parameters
    ----------
    gains : LoopGains
        What to write.
    path : str or pathlib.Path
        File to write; parent directories are made.
    comment : str, optional
        Text for the head of the file.
    """
    loop = loop_to_dict(gains)
    loop['checksum'] = loop_checksum(gains)
    bandwidth = loop.pop('bandwidth')
    write_parameters(path, {'bandwidth': bandwidth, 'loop': loop}, comment)


def serial_parameters(path: str | Path) -> dict[str, Any] | None:
    """Parameters of a file that tunes the tracker of a serial arm; None of any other file."""
    nodes = read_yaml(path).get('/**')
    values = nodes.get('ros__parameters') if isinstance(nodes, dict) else None
    if not isinstance(values, dict) or 'bandwidth' not in values:
        return None
    return values if set(values) <= {'bandwidth', 'loop'} else None


def load_loop_gains(path: str | Path) -> LoopGains:
    """Read a parameter file with a certificate.

    Parameters
    ----------
    path : str or pathlib.Path
        As written by `save_loop_gains`.

    Returns
    -------
    LoopGains
        Validated, but not verified.

    Raises
    ------
    ConfigError
        If the file is none, or has a bandwidth and no certificate.
    """
    values = serial_parameters(path)
    if values is None or not isinstance(values.get('loop'), dict):
        raise ConfigError(
            '/**.ros__parameters.loop',
            'is missing: no certificate; lpv design writes one for a serial arm',
            str(path),
        )
    return parse_loop({**values['loop'], 'bandwidth': values['bandwidth']}, str(path))
