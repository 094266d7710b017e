"""What the docs claim is what `lpv verify` prints."""

from places import ROOT

from lpv.core.serial_arm.certificate.claims import SERIAL_CLAIMS
from lpv.core.uio.certificate.claims import CLAIMS


def test_given_the_table_of_claims_when_the_docs_are_read_then_they_claim_the_same():
    said = (ROOT / 'docs' / 'guarantees.md').read_text(encoding='utf-8')
    claims = (*CLAIMS, *SERIAL_CLAIMS)
    rows = [f'| {claim.text} | {claim.region} | {claim.evidence} |' for claim in claims]
    rows += ['| Claim | Where | Evidence |', '|---|---|---|']
    assert [row for row in rows if row not in said] == []
    kinds = ('exact arithmetic', 'eigenvalue', 'bound', 'experiment', 'checksum')
    assert all(any(kind in claim.evidence for kind in kinds) for claim in claims)
