"""Method ``paper``: the observer LMIs (54) and (55) on the box of phi1, phi2, phi3."""

import math
from dataclasses import dataclass, replace

import cvxpy as cp
import numpy as np

from lpv.core.serial_arm.two_links import ArmParameters
from lpv.core.support.config import Section
from lpv.core.support.entries import entry
from lpv.core.support.limits import LARGEST
from lpv.core.uio.certificate.conditions import observer_margin
from lpv.core.uio.certificate.error_system import paper_fault_sigma
from lpv.core.uio.certificate.lmi import paper_inequalities
from lpv.core.uio.model.joints import JointMap
from lpv.core.uio.model.polytope import paper_descriptor, sinc_box
from lpv.core.uio.observer.paper_observer import PaperObserverGains, decoupling
from lpv_design.solve import InfeasibleError, NotDetectableError, bisect, solve, symmetric_below


@dataclass(frozen=True)
class PaperRequirement:
    """Requirements of the literal observer design."""

    # '55', literally, or '54+disc': (54) and the disc as separate inequalities
    lmi: str = entry('text', default='55', choices=('55', '54+disc'))
    # lower end of the box of phi2 and phi3
    sinc_min: float = entry('number', default=0.96, low=-0.3, high=0.999)
    gamma: float = entry('number', default=1.0, above=0.0, high=LARGEST)  # attenuation level
    q: float = entry('number', default=20.0, above=0.0, high=LARGEST)  # disc [1/s]
    r: float = entry('number', default=15.0, above=0.0, high=LARGEST)  # disc [1/s]

    def check(self, section: Section) -> None:
        """ConfigError for a disc that reaches unstable poles."""
        if not self.r < self.q:
            raise section.error('r', 'must be below q, or the disc reaches unstable poles')


def design_paper(arm: ArmParameters, wanted: PaperRequirement) -> tuple[PaperObserverGains, str]:
    """Observer that fulfils a requirement, and the solver's word.

    Raises
    ------
    NotDetectableError
        If the box holds a point where faults cannot be told from states.
    InfeasibleError
        If the rebuilt inequalities do not hold.
    """
    lost = undetectable_point(arm, wanted.sinc_min)
    if lost is not None:
        phi, vector = (values.tolist() for values in lost)
        raise NotDetectableError(
            f'observer: at phi = {phi}, inside the box, the mode 0 with vector {vector} is not '
            'observable: without gravity torque a joint angle and a bias of its sensor cannot be '
            'told apart. ' + _largest_box(arm, wanted)
        )
    observer, status = solve_paper(arm, wanted)
    margin = np.inf if observer is None else observer_margin(arm, observer)
    if observer is None or not margin < 0.0:
        raise InfeasibleError(
            f'observer: LMI ({wanted.lmi}) with gamma = {wanted.gamma:g} has no '
            f'solution for phi2, phi3 in [{wanted.sinc_min:g}, 1] (solver: {status}, '
            f'largest eigenvalue {margin:.3g}): ask for a larger disc (q, r), a '
            "larger gamma or lmi '54+disc'"
        )
    return replace(observer, fault_sigma=paper_fault_sigma(arm, observer)), status


def _largest_box(arm: ArmParameters, wanted: PaperRequirement) -> str:
    """On which box the same figures are feasible."""

    def works(width: float) -> bool:
        observer, _ = solve_paper(arm, replace(wanted, sinc_min=1.0 - width))
        return observer is not None and observer_margin(arm, observer) < 0.0

    width = bisect(works, 0.5, 0.002)
    if width <= 0.0:
        return 'No box down to phi = 0.999 is feasible with these figures'
    return (
        f'The largest box on which gamma = {wanted.gamma:g}, q = {wanted.q:g}, '
        f'r = {wanted.r:g} are feasible is phi2, phi3 in [{1.0 - width:.3f}, 1]'
    )


def undetectable_point(arm: ArmParameters, sinc_min: float) -> tuple[np.ndarray, np.ndarray] | None:
    """A point phi of a box where a fault cannot be told from states, and the mode that is lost.

    C~ v = 0 makes v = (theta, 0, -S theta), and (41) then N v = lambda v the same as
    [lambda theta; Xi^-1 G phi theta] = 0: zero is lost, where phi2 or phi3 is zero, and nothing
    else ever is.
    """
    if sinc_min > 0.0:
        return None
    first = JointMap(arm).sensor_matrix[:, 0]
    return np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0, 0.0, *(0.0 - first)])


def solve_paper(
    arm: ArmParameters, wanted: PaperRequirement, minimise: bool = False
) -> tuple[PaperObserverGains | None, str]:
    """P and K_i by LMI (55), or by LMI (54) with the disc apart, T1 and T2 by eq. (49).

    Gamma is as wanted or as small as can be.  Returns gains without their ``fault_sigma``, None if
    no point was found, and the solver's word.
    """
    box = sinc_box(wanted.sinc_min)
    d = paper_descriptor(arm, box)
    t1, t2 = decoupling(d.e, d.c)
    p = cp.Variable((6, 6), symmetric=True)
    y = [cp.Variable((6, 4)) for _ in d.a]
    level = cp.Variable(nonneg=True) if minimise else cp.Constant(wanted.gamma**2)
    matrices = paper_inequalities(d, p, p @ t1, y, level, wanted.q, wanted.r, wanted.lmi, cp.bmat)
    constraints = [p >> 1e-6 * np.eye(6), *(symmetric_below(m, 1e-8) for m in matrices)]
    status = solve(level if minimise else 0, constraints)
    if p.value is None or level.value is None:
        return None, status
    try:
        k = np.array([np.linalg.solve(p.value, np.asarray(y_i.value)) for y_i in y])
    except np.linalg.LinAlgError:
        return None, status
    gamma = math.sqrt(max(float(level.value), 0.0)) if minimise else wanted.gamma
    return PaperObserverGains(
        'paper', box, t1, t2, k, p.value, wanted.lmi, gamma, wanted.q, wanted.r, np.zeros(2)
    ), status
