"""What the docs claim is what `lpv verify` prints."""

from pathlib import Path

from lpv.core.serial_arm.certificate.claims import SERIAL_CLAIMS
from lpv.core.uio.certificate.claims import CLAIMS

DOCS = Path(__file__).resolve().parents[5] / 'docs'


def test_given_the_table_of_claims_when_the_docs_are_read_then_they_claim_the_same():
    said = (DOCS / 'guarantees.md').read_text(encoding='utf-8')
    claims = (*CLAIMS, *SERIAL_CLAIMS)
    rows = [f'| {claim.text} | {claim.region} | {claim.evidence} |' for claim in claims]
    rows += ['| Claim | Where | Evidence |', '|---|---|---|']
    assert [row for row in rows if row not in said] == []


def test_given_any_claim_when_read_then_its_evidence_is_of_a_known_kind():
    kinds = ('exact arithmetic', 'eigenvalue', 'bound', 'experiment', 'checksum')
    for claim in (*CLAIMS, *SERIAL_CLAIMS):
        assert any(kind in claim.evidence for kind in kinds)
