"""Formulas of the paper, written again without the code under test."""

import math

import numpy as np


def inertia(theta, c):
    """Xi(theta) of an arm with such constants."""
    off = c.rotor_coupling + c.coupling * math.cos(theta[0] - theta[1])
    return np.array([[c.inertia[0], off], [off, c.inertia[1]]])


def scheduling(theta):
    """phi of eqs. (6) and (9)."""
    return math.cos(theta[0] - theta[1]), *np.sinc(np.array(theta[:2]) / np.pi)


def weights(phi, box):
    """rho of eqs. (11) and (12); phi outside the box counts as its nearest point."""
    alpha = [min(max((high - p) / (high - low), 0.0), 1.0) for p, (low, high) in zip(phi, box)]
    return np.einsum('i,j,k->ijk', *([a, 1.0 - a] for a in alpha)).ravel()


def inverse_dynamics(theta, rate, acc, c):
    """Generalised torques Q of a motion, eq. (1), with joint friction by load."""
    swirl = c.coriolis * c.coupling * math.sin(theta[0] - theta[1])
    torque = inertia(theta, c) @ acc - c.gravity * np.sin(theta)
    torque += swirl * np.array([rate[1] ** 2, -(rate[0] ** 2)])
    joint, load = np.array([rate[0], rate[1] - rate[0]]), np.abs([torque.sum(), torque[1]])
    slip = 2.0 / np.pi * np.arctan(c.coulomb_slope * joint)
    lost = c.offset + c.viscous * joint + (c.coulomb + c.load * load) * slip
    return torque + [lost[0] - lost[1], lost[1]]
