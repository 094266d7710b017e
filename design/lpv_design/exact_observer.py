"""Method ``exact``: gains for the mean-value error dynamics on the exact polytope.

With T2 = [0; I 0] the innovation's position part C~ x^ - y = S theta^ + z_f is internal to the
observer: in the coordinates [e_x; rho], rho = S e_theta + e_f, the matrix N_i is block diagonal
once K_f = -S K_theta - kappa [I 0].  What remains to be designed is the 4-state error
e_x' = (A_i + K_x C_v) e_x + Bw w - K_x v, driven by accelerations and by velocity-sensor noise.
P and K of the full 6-state observer follow exactly.
"""

from dataclasses import dataclass

import cvxpy as cp
import numpy as np

from lpv_core.joints import JointMap
from lpv_core.polytope import exact_state_space, exact_vertices
from lpv_core.state_space import Descriptor
from lpv_core.uio import fault_feedthrough
from lpv_design.lmi import covariance, disc, largest_eigenvalue
from lpv_design.solve import solve, symmetric_below


@dataclass(frozen=True)
class ExactRequirement:
    """What the observer must fulfil.

    Attributes
    ----------
    decay : float
        Slowest allowed pole [1/s].
    fastest : float
        Fastest allowed pole [1/s]; with the sample time it fixes the margin of the recursion.
    acceleration_noise : tuple of float
        Intensity of white acceleration on both absolute axes [rad/s2/sqrt(Hz)]: disturbance and
        the part of the model error that varies fast.
    rate_noise : float
        Intensity of white noise on theta' (integration of imperfect rates) [rad/s/sqrt(Hz)].
    velocity_weight : float
        Weight of velocity estimates against fault estimates in the H2 criterion.
    """

    decay: float = 0.25
    fastest: float = 60.0
    acceleration_noise: tuple = (0.15, 0.15)
    rate_noise: float = 1e-3
    velocity_weight: float = 0.02


class ExactProblem:
    """LMIs of the exact observer for one arm.

    Parameters
    ----------
    arm : ArmParameters
        The arm, with its region.
    requirement : ExactRequirement
        Decay, pole and noise requirements.

    Attributes
    ----------
    descriptor : Descriptor
        Augmented vertices.
    t1, t2 : ndarray
        Decoupling matrices of `fault_feedthrough`.
    """

    # Errors are some hundredths of a radian; in these units P is of order one.
    _SCALE = 0.05

    def __init__(self, arm, requirement):
        self.requirement = requirement
        self.arm = arm
        constants = arm.constants()
        pairs = [exact_state_space(v, constants) for v in exact_vertices(arm)]
        self._a = [a for a, _ in pairs]
        self.descriptor = Descriptor(np.array(self._a), np.array([b for _, b in pairs]), arm)
        self.t1, self.t2 = fault_feedthrough(self.descriptor.c)
        self._s = JointMap(arm).sensor_matrix
        self._c_v = np.hstack([np.zeros((2, 2)), self._s])
        self._velocity_noise = arm.velocity_noise * np.sqrt(arm.sample_time)
        self._bw = np.diag([requirement.rate_noise] * 2 + list(requirement.acceleration_noise))
        self.q = 0.5 * (requirement.decay + requirement.fastest)
        self.r = 0.5 * (requirement.fastest - requirement.decay)

    def _inequalities(self, p, y, block=np.block):
        """All inequalities of the 4-state problem in scaled units (one common K)."""
        matrices = []
        stack = cp.hstack if block is cp.bmat else np.hstack
        for a_i in self._a:
            pn = p @ a_i + y @ self._c_v
            inputs = stack([p @ self._bw / self._SCALE,
                            y * self._velocity_noise / self._SCALE])
            matrices.append(covariance(pn, inputs, block))
            matrices.append(disc(p, pn, self.q, self.r, block))
        return matrices

    def _performance(self):
        c_z = np.zeros((4, 4))
        c_z[:2, :2] = self._s
        c_z[2:, 2:] = self.requirement.velocity_weight * np.eye(2)
        return c_z

    def solve(self):
        """Minimise the H2 bound.

        Returns
        -------
        tuple
            ``(k_x, p, status)``: K_x (4, 2) and P (4, 4), or None where no point was found.
        """
        p = cp.Variable((4, 4), symmetric=True)
        y = cp.Variable((4, 2))
        w = cp.Variable((4, 4), symmetric=True)
        c_z = self._performance()
        constraints = [symmetric_below(m, 1e-6) for m in self._inequalities(p, y, cp.bmat)]
        constraints.append(cp.bmat([[w, c_z], [c_z.T, p]]) >> 0)
        status = solve(cp.trace(w), constraints)
        if p.value is None:
            return None, None, status
        return np.linalg.solve(p.value, y.value), p.value, status

    def check(self, k_x, p):
        """Largest eigenvalue over all inequalities, rebuilt in NumPy (scaled units).

        Parameters
        ----------
        k_x : ndarray, shape (4, 2)
            Gain on the velocity innovation.
        p : ndarray, shape (4, 4)
            Lyapunov matrix of `solve`.

        Returns
        -------
        float
            Negative if P > 0 and everything holds.
        """
        matrices = self._inequalities(p, p @ k_x)
        return max(largest_eigenvalue(-p), *(largest_eigenvalue(m) for m in matrices))

    def lift(self, k_x, p):
        """K_i and P of the 6-state observer.

        Parameters
        ----------
        k_x : ndarray, shape (4, 2)
            Gain on the velocity innovation.
        p : ndarray, shape (4, 4)
            Lyapunov matrix of the 4-state problem.

        Returns
        -------
        tuple of ndarray
            K (16, 6, 4), the same at every vertex, and P (6, 6).
        """
        kappa = self.q
        k = np.zeros((6, 4))
        k[:4, 2:] = k_x
        k[4:, 2:] = -self._s @ k_x[:2]
        k[4:, :2] = -kappa * np.eye(2)
        coordinates = np.eye(6)
        coordinates[4:, :2] = self._s
        full = np.zeros((6, 6))
        full[:4, :4] = p
        full[4:, 4:] = np.eye(2)
        return np.repeat(k[None], len(self._a), axis=0), coordinates.T @ full @ coordinates

    def check_lifted(self, k, p):
        """Disc inequality of the full observer N_i = T1 A~_i + K_i C~ with the lifted P.

        One common K makes the certificate hold for every pair of scheduling estimate and
        mean-value slope; gains that differ between vertices would need all pairs.

        Parameters
        ----------
        k : ndarray, shape (16, 6, 4)
            K_i as written to the gains file.
        p : ndarray, shape (6, 6)
            P as written to the gains file.

        Returns
        -------
        float
            Negative if P > 0 and all pairs hold.
        """
        d = self.descriptor
        distinct = np.unique(k, axis=0)
        margins = [largest_eigenvalue(-p)]
        for a_i in d.a:
            for k_j in distinct:
                n = self.t1 @ a_i + k_j @ d.c
                margins.append(largest_eigenvalue(disc(p, p @ n, self.q, self.r)))
        return max(margins)

    def fault_sigma(self, p):
        """Bound on the standard deviation of the fault estimates [rad].

        Parameters
        ----------
        p : ndarray, shape (4, 4)
            P of `solve`: its inverse bounds the covariance of e_x.

        Returns
        -------
        ndarray, shape (2,)
            Per physical sensor, encoder noise included.
        """
        covariance_bound = np.linalg.inv(p) * self._SCALE**2
        fault = self._s @ covariance_bound[:2, :2] @ self._s.T
        return np.sqrt(np.diag(fault) + self.arm.position_noise**2)

    def spectral_radius(self, k):
        """Largest modulus of the recursion's eigenvalues over the vertices (Heun rule at Ts).

        Parameters
        ----------
        k : ndarray, shape (16, 6, 4)
            K_i.

        Returns
        -------
        float
            Below one: the sampled observer is stable at every vertex.
        """
        radius = 0.0
        for a_i, k_i in zip(self.descriptor.a, k):
            h = self.arm.sample_time * np.linalg.eigvals(self.t1 @ a_i + k_i @ self.descriptor.c)
            radius = max(radius, float(np.abs(1.0 + h + 0.5 * h**2).max()))
        return radius
