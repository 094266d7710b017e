"""What is claimed, on which region, and by which check: the table of ``lpv verify``."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Claim:
    """One line of the table."""

    text: str
    region: str
    evidence: str  # exact arithmetic, eigenvalue, bound, experiment


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
        'everywhere (method exact); held links: dead reckoning',
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

SERIAL_CLAIMS = (
    Claim(
        'The tracking error of a serial arm decays with the stated rate in the energy norm '
        '(P and M(q) as weights), for any model error, payload and viscous friction of the stated '
        'sizes, but for the torques that the model misses, which drive it.',
        'every configuration, any motion with joint rates in the region; true estimates, torques '
        'below their limits',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The same of the sampled loop with one sample of delay, while the arm moves.',
        'the same; over a sample M(q) is taken as at its start, and so are friction, Coriolis and '
        'gravity torques over sample and delay',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The tracking error ends below the stated bound, for missed torques (model error, payload, '
        'friction) of any time profile.',
        'the smaller region of rates and accelerations, as long as the arm stays in it; '
        'continuous loop',
        'exact arithmetic (--proof) and bound (energy norms), attacked by simulation',
    ),
    Claim(
        'M(q) of the model: ratio of the payload, growth in motion, damping and smallest inertia.',
        'every configuration, joint rates up to the velocity limits',
        'exact arithmetic (--proof), eigenvalue (link by link, no grid)',
    ),
    Claim(
        'No number was changed after the design.',
        'the gains file of the tracker',
        'checksum, and recomputed where it follows from others',
    ),
)


def claims_table(claims: tuple[Claim, ...] = CLAIMS) -> str:
    """The claims as a Markdown table."""
    rows = ['| Claim | Where | Evidence |', '|---|---|---|']
    rows += [f'| {claim.text} | {claim.region} | {claim.evidence} |' for claim in claims]
    return '\n'.join(rows) + '\n'
