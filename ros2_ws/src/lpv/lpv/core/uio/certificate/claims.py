"""What is claimed of designed gains, on which region, and by which check."""

from lpv.core.serial_arm.certificate.claims import Claim

CLAIMS = (
    Claim(
        'The angle errors of the observer decay with the stated rate (method exact).',
        'abs(cos theta_i) >= cos_min, every slope of gravity, constant or changing',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The sampled recursion of the observer contracts (method exact).',
        'the same',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'Noise and white disturbance of the arm file give fault estimates the stated standard '
        'deviation at most.',
        'the same, links moved slowly; continuous-time noise model',
        'exact arithmetic (--proof) and eigenvalue (H2 inequality with the stored P)',
    ),
    Claim(
        'A healthy arm stays below its threshold, but for noise beyond `sigmas` standard '
        'deviations: model error, payload, friction, mean disturbance, bias and relative error of '
        'the rates may have any time profile within the arm file.',
        'everywhere (method exact), without torque_tolerance, delay and bandwidth of efforts in '
        'the arm file; held links: dead reckoning',
        'bound (reachable set and dead reckoning), attacked by lpv falsify',
    ),
    Claim(
        'A lasting fault above threshold plus bound is found.',
        'at rest, where gravity bounds the error',
        'bound (static map)',
    ),
    Claim(
        'The tracking loop decays with alpha (LMI (67)).',
        'region, exact polytope without Coriolis terms (method paper: its box)',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The sampled loop with one sample of delay is stable at every vertex.',
        'vertices of the polytope, each held constant',
        'eigenvalue (spectral radius)',
    ),
    Claim(
        'The sampled loop with one sample of delay settles at a pose with the stated decay, from '
        'any motion up to the stated link rate: one common Lyapunov matrix, Coriolis torques '
        'included.',
        'region, exact polytope at link rates up to that of the gains file (method exact); arm of '
        'the file, without friction',
        'eigenvalue (norm of every vertex, and a bound of what sampling leaves out)',
    ),
    Claim(
        'The loop carries model error and payload.',
        'corners of the stated ranges; between them no proof',
        'eigenvalue at the corners, experiment between',
    ),
    Claim(
        'Observer and controller together are stable.',
        'vertices, each held constant; in motion as the claims on each of them: the error of the '
        'observer does not depend on the loop',
        'eigenvalue (spectral radius); in motion: cascade of two contracting systems',
    ),
    Claim(
        'No number that observer, bound or decision uses was changed after the design.',
        'the gains file',
        'checksum, and recomputed where it follows from others',
    ),
)
