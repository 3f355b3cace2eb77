"""What is read of certificates and revocation lists, and what arbitrary bytes are."""

import datetime
from pathlib import Path

import pytest
from cryptography import x509
from hypothesis import given
from hypothesis import strategies as st
from support.certificates import Authority, authority

from uros.agent.transports.x509 import certificate, certificates_in, revocation_lists_in


@pytest.mark.parametrize("ends", [(2049, 12, 31), (2050, 1, 1), (9999, 12, 31)])
def test_a_certificate_is_read_as_an_independent_reader_does(tmp_path, ends):
    moment = datetime.datetime(*ends, 23, 59, 58, tzinfo=datetime.timezone.utc)
    path, _ = Authority(tmp_path).issue("left", not_after=moment)
    text = Path(path).read_text()
    found = certificates_in(text)[0]
    other = x509.load_pem_x509_certificate(text.encode())
    assert found.serial == other.serial_number
    assert found.issuer == other.issuer.public_bytes()
    assert found.subject == other.subject.public_bytes()
    assert found.begins == other.not_valid_before_utc.timestamp()
    assert found.ends == moment.timestamp()


def test_a_revocation_list_is_read(tmp_path):
    ca = Authority(tmp_path)
    files = [ca.issue(name)[0] for name in ("a", "b")]
    (found,) = revocation_lists_in(Path(ca.revoke(*files)).read_text())
    shown = [certificates_in(Path(file).read_text())[0] for file in files]
    assert found.serials == {each.serial for each in shown}
    assert found.issuer == shown[0].issuer
    text = Path(ca.revoke(days=1)).read_text()
    (empty,) = revocation_lists_in(text)
    other = x509.load_pem_x509_crl(text.encode())
    assert empty.begins == other.last_update_utc.timestamp()
    assert empty.ends == other.next_update_utc.timestamp()
    assert empty.serials == frozenset()


@given(st.data())
def test_any_bytes_are_a_certificate_or_a_value_error(data):
    text = Path(authority().ca).read_text()
    der = bytearray(x509.load_pem_x509_certificate(text.encode()).public_bytes(_der()))
    for _ in range(data.draw(st.integers(0, 4))):
        der[data.draw(st.integers(0, len(der) - 1))] = data.draw(st.integers(0, 255))
    try:
        certificate(bytes(der[: data.draw(st.integers(0, len(der)))]))
    except ValueError:
        pass


def _der():
    from cryptography.hazmat.primitives.serialization import Encoding

    return Encoding.DER
