"""What the docs claim is what `lpv verify` prints."""

from pathlib import Path

from lpv_core.certificate.claims import CLAIMS, SERIAL_CLAIMS, claims_table

DOCS = Path(__file__).resolve().parents[4] / 'docs'


def test_given_the_table_of_claims_when_the_docs_are_read_then_they_claim_the_same():
    said = (DOCS / 'guarantees.md').read_text(encoding='utf-8')
    assert claims_table() in said and claims_table(SERIAL_CLAIMS) in said


def test_given_any_claim_when_read_then_its_evidence_is_of_a_known_kind():
    kinds = ('exact arithmetic', 'eigenvalue', 'bound', 'experiment', 'checksum')
    for claim in (*CLAIMS, *SERIAL_CLAIMS):
        assert any(kind in claim.evidence for kind in kinds)
