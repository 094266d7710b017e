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
        'The loop carries model error and payload.',
        'corners of the stated ranges; between them no proof',
        'eigenvalue at the corners, experiment between',
    ),
    Claim(
        'Observer and controller together are stable.',
        'vertices, each held constant',
        'eigenvalue (spectral radius)',
    ),
    Claim(
        'No number that observer, bound or decision uses was changed after the design.',
        'the gains file',
        'checksum, and recomputed where it follows from others',
    ),
)

SERIAL_CLAIMS = (
    Claim(
        'The tracking loop of a serial arm decays with the stated rate in the energy norm '
        '(P and M(q) as weights), whatever combination of model error, payload and viscous '
        'friction of the stated sizes the arm has.',
        'every configuration, any motion with joint rates in the region; true estimates, torques '
        'below their limits',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The sampled loop with one sample of delay decays while the arm moves.',
        'the same; over a sample the arm is taken as it is at its start, friction and the torques '
        'that rates and gravity need included',
        'exact arithmetic (--proof), eigenvalue',
    ),
    Claim(
        'The tracking error ends below the stated bound: model error, payload, friction of any '
        'time profile.',
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
