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
