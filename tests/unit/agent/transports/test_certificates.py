"""Certificate files: each fault is named, with the remedy."""

import datetime
import os
import ssl
import subprocess
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from support.certificates import Authority
from support.examples import examples

from uros.agent.transports import certificates as module
from uros.agent.transports.base import TransportError
from uros.agent.transports.certificates import Certificates


@pytest.fixture(scope="module")
def authority(tmp_path_factory):
    return Authority(tmp_path_factory.mktemp("ca"))


@pytest.fixture
def files(authority, tmp_path):
    """Return (certificate, key), which a test may damage."""
    paths = []
    for path, name in zip(authority.agent(), ("agent.pem", "agent.key"), strict=True):
        (tmp_path / name).write_bytes(Path(path).read_bytes())
        paths.append(tmp_path / name)
    return paths


def refused(cert, key, ca=None):
    with pytest.raises(TransportError) as caught:
        Certificates(str(cert), str(key), ca and str(ca))
    return caught.value.strerror


def test_valid_files(files, authority):
    for ca in (None, authority.ca):
        certificates = Certificates(str(files[0]), str(files[1]), ca)
        context = certificates.context()
        assert certificates.doubt() == ""
        assert context.minimum_version == ssl.TLSVersion.TLSv1_2
        assert context.verify_mode == (ssl.CERT_NONE if ca is None else ssl.CERT_REQUIRED)


@pytest.mark.parametrize("option", ["--tls-cert", "--tls-key", "--tls-ca"])
def test_a_missing_file_and_a_folder_are_refused(files, tmp_path, option):
    files_by_option = {"--tls-cert": files[0], "--tls-key": files[1], "--tls-ca": files[0]}
    for path, why in (
        (tmp_path / "none", "No such file or directory: correct the name"),
        (tmp_path, "Is a directory"),
        ("a\0b", "null"),
    ):
        message = refused(*{**files_by_option, option: path}.values())
        assert message.startswith(f"{option} {path} cannot be read: ") and why in message


def test_a_file_without_read_permission(files, monkeypatch):
    """root can read every file."""
    real = open

    def denied(path, *rest):
        if str(path) == str(files[1]):
            raise PermissionError(13, "Permission denied")
        return real(path, *rest)

    monkeypatch.setattr(module, "open", denied, raising=False)
    assert "--tls-key" in refused(*files) and "let the agent's user read it" in refused(*files)


def test_an_endless_file(files):
    assert "is over 1048576 bytes" in refused("/dev/zero", files[1])


@pytest.mark.parametrize("text", [b"", b"hello", b"\xff\xfe\x80", b"0\x82\x01\x0a\x02"])
def test_content_that_is_no_certificate_or_key_is_refused(files, tmp_path, text):
    other_file = tmp_path / "other"
    other_file.write_bytes(text)
    assert f"--tls-cert {other_file} holds no valid certificate" in refused(other_file, files[1])
    assert "openssl x509 -inform DER" in refused(other_file, files[1])
    assert f"--tls-key {other_file} holds no private key" in refused(files[0], other_file)
    assert f"--tls-ca {other_file} holds no valid certificate" in refused(*files, other_file)


def test_certificate_and_key_that_are_swapped(files):
    cert, key = files
    assert f"--tls-key {cert} holds no private key" in refused(cert, cert)
    assert f"--tls-cert {key} holds no valid certificate" in refused(key, key)
    assert f"--tls-ca {key} holds no valid certificate" in refused(cert, key, key)


def test_damaged_certificate_and_key(files):
    cert, key = files
    for path, message in ((cert, "holds no valid certificate"), (key, "holds a key that cannot")):
        text = path.read_text()
        lines = text.splitlines()
        path.write_text("\n".join([lines[0], "A" * 64, *lines[2:]]))
        assert message in refused(cert, key)
        path.write_text(text)


def test_text_around_a_certificate_is_ignored(files):
    cert, key = files
    cert.write_bytes("Issuer: Müller\n".encode() + cert.read_bytes())
    certificates = Certificates(str(cert), str(key), str(cert))
    assert certificates.doubt() == ""


def test_a_key_of_another_certificate(authority, files):
    other_key = authority.issue("other")[1]
    assert f"--tls-key {other_key} does not belong to the certificate {files[0]}" in refused(
        files[0], other_key
    )


@pytest.mark.parametrize("form", [["pkcs8", "-topk8", "-v2", "aes256"], ["ec", "-aes256"]])
def test_an_encrypted_key_is_refused_without_a_prompt(files, tmp_path, form):
    locked = tmp_path / "locked.key"
    subprocess.run(
        ["openssl", *form, "-in", files[1], "-out", locked, "-passout", "pass:secret"],
        check=True, capture_output=True,
    )  # fmt: skip
    assert "is encrypted" in refused(files[0], locked)
    assert f"openssl pkey -in {locked} -out NEW" in refused(files[0], locked)


def test_a_key_that_is_too_short(tmp_path):
    cert, key = tmp_path / "c.pem", tmp_path / "k.pem"
    subprocess.run(
        ["openssl", "req", "-x509", "-newkey", "rsa:1024", "-nodes", "-subj", "/CN=old",
         "-out", cert, "-keyout", key], check=True, capture_output=True,
    )  # fmt: skip
    message = refused(cert, key)
    assert "is too weak (ee key too small): make a new one" in message


def test_warnings_about_dates(authority, tmp_path):
    day = datetime.timedelta(days=1)
    now = datetime.datetime.now(datetime.timezone.utc)
    old = Authority(tmp_path).agent(not_after=now - day)
    assert Certificates(*old).doubt() == "certificate has expired"
    early = Authority(tmp_path).agent(not_before=now + day)
    assert Certificates(*early).doubt().startswith("certificate is not yet valid")


def test_each_file_that_ends_is_named_with_the_day(tmp_path):
    day = datetime.timedelta(days=1)
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = Authority(tmp_path)
    files = *authority.agent(not_before=now - day, not_after=now + 400 * day), authority.ca
    certificates = Certificates(*files, authority.revoke(days=60))

    def doubts(days):
        return certificates.doubts((now + days * day).timestamp())

    assert doubts(0) == []
    (early,) = doubts(-3)
    assert early.startswith(f"--tls-cert {files[0]} is valid from {now - day:%Y-%m-%d} on")
    assert doubts(50) == []  # the list lives for 90 days, a tenth of which is 9
    (soon,) = doubts(52)
    assert soon == (
        f"--tls-crl {tmp_path}/crl.pem: a revocation list ends on {now + 60 * day:%Y-%m-%d}:"
        " make a new one before"
    )
    cert, ended = doubts(390)
    assert cert.startswith(f"--tls-cert {files[0]} expires on {now + 400 * day:%Y-%m-%d}")
    assert f"ended on {now + 60 * day:%Y-%m-%d}, so no board of its CA is admitted" in ended
    assert any("expired on" in doubt and files[0] in doubt for doubt in doubts(401))
    assert any(f"--tls-ca {authority.ca} expired on" in doubt for doubt in doubts(1000 * 365))


def test_which_files_that_have_ended_let_no_board_connect(tmp_path):
    """A CA that is followed by another one is a trouble, and boards of the other one connect."""
    day = 86_400.0
    now = time.time()
    old, new = Authority(tmp_path / "old"), Authority(tmp_path / "new")
    files = old.agent()
    both = tmp_path / "both.pem"
    both.write_bytes(Path(old.ca).read_bytes() + Path(new.ca).read_bytes())
    lists = tmp_path / "lists.pem"

    def judged(*parts, days=0, cas=both):
        lists.write_text("".join(Path(part).read_text() for part in parts))
        certificates = Certificates(*files, str(cas), str(lists) if parts else None)
        later = now + days * day
        return certificates.admits_boards(later), len(certificates.troubles(later))

    first, second = old.revoke(days=3), new.revoke(days=7)
    assert judged(cas=old.ca) == judged(first, second) == (True, 0)
    assert judged(second) == (True, 0)  # the old one may be there to sign the new one
    assert judged(second, cas=old.ca) == (False, 1)
    assert judged(first, second, days=4) == (True, 1)
    assert judged(first, second, days=8) == (False, 2)
    assert judged(first, second, days=4, cas=old.ca) == (False, 1)
    assert judged(first, second, days=-40) == (False, 2)  # the lists are not valid yet
    ends = Certificates(*files, str(both), str(lists)).not_after()
    assert list(ends) == ["tls_cert", "tls_ca", "tls_crl"]
    assert abs(ends["tls_crl"] - (now + 3 * day)) < 60
    assert list(Certificates(*files).not_after()) == ["tls_cert"]
    assert judged(days=-1000 * 365) == (False, 3)  # the certificate and the CAs are not valid yet


@pytest.mark.parametrize(
    ("lifetime", "notice"), [(400, 30), (300, 30), (30, 3), (7, 1), (2, 1), (1, 0.5)]
)
def test_a_list_that_ends_is_announced_for_a_tenth_of_its_lifetime(tmp_path, lifetime, notice):
    day = datetime.timedelta(days=1)
    now = datetime.datetime.now(datetime.timezone.utc)
    authority = Authority(tmp_path)
    files = *authority.agent(not_before=now - day, not_after=now + 900 * day), authority.ca
    certificates = Certificates(*files, authority.revoke(days=lifetime, age=0))

    def doubts(days):
        return certificates.doubts((now + days * day).timestamp())

    assert doubts(0) == doubts(lifetime - notice - 0.01) == []
    (soon,) = doubts(lifetime - notice + 0.01)
    assert "a revocation list ends on" in soon


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("", "holds no revocation list in PEM form"),
        ("-----BEGIN X509 CRL-----\nAAAA\n-----END X509 CRL-----\n", "holds no valid revocation"),
        ("{crl}{cert}", "or something else too"),
    ],
)
def test_a_file_that_is_no_revocation_list(authority, files, tmp_path, content, said):
    crl = tmp_path / "list.pem"
    texts = {"crl": Path(authority.revoke()).read_text(), "cert": files[0].read_text()}
    crl.write_text(content.format(**texts))
    with pytest.raises(TransportError) as error:
        Certificates(str(files[0]), str(files[1]), authority.ca, str(crl))
    assert error.value.strerror.startswith(f"--tls-crl {crl} ") and said in error.value.strerror


def test_a_form_that_openssl_accepts_and_we_cannot_read_is_used_without_its_dates(
    authority, files, monkeypatch
):
    def unusual(*_):
        raise ValueError("an unusual form")

    for name in ("certificate", "certificates_in", "revocation_lists_in"):
        monkeypatch.setattr(module, name, unusual)
    paths = str(files[0]), str(files[1]), authority.ca, authority.revoke()
    certificates = Certificates(*paths)
    assert certificates.context() and certificates.doubts(0.0) == []
    assert not certificates.is_revoked(b"anything")


def test_a_revocation_list_needs_a_ca(authority, files):
    with pytest.raises(TransportError, match="no effect without --tls-ca"):
        Certificates(str(files[0]), str(files[1]), None, authority.revoke())


def test_files_that_change(authority, files):
    cert, key = files
    certificates = Certificates(str(cert), str(key))
    first = certificates.context()
    assert certificates.context() is first
    cert.write_text("half a certifi")
    with pytest.raises(TransportError):
        certificates.context()
    assert certificates.context() is first  # reported once; the former certificate stays in use
    for path, new_file in zip(files, authority.issue("new"), strict=True):
        path.write_bytes(Path(new_file).read_bytes())
    assert certificates.context() is not first
    os.unlink(cert)
    with pytest.raises(TransportError):
        certificates.context()
    assert certificates.context() is certificates.context()


@settings(max_examples=examples(60), suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_file_content_is_used_or_refused(files, data):
    pieces = st.sampled_from(
        [b"-----BEGIN CERTIFICATE-----\n", b"-----END CERTIFICATE-----\n",
         b"-----BEGIN PRIVATE KEY-----\n", b"-----END PRIVATE KEY-----\n",
         b"-----BEGIN ENCRYPTED PRIVATE KEY-----\n", b"Proc-Type: 4,ENCRYPTED\n\n",
         *(file.read_bytes() for file in files)],
    )  # fmt: skip
    contents = st.lists(st.one_of(pieces, st.binary(max_size=40)), max_size=6).map(b"".join)
    paths = []
    for number, file in enumerate(files):
        path = file.with_suffix(f".{number}")
        path.write_bytes(data.draw(st.one_of(st.just(file.read_bytes()), contents)))
        paths.append(str(path))
    ca = data.draw(st.sampled_from([None, paths[0], paths[1]]))
    try:
        contents = Certificates(*paths, ca)
    except TransportError as error:
        assert error.strerror.startswith("--tls-")
    else:
        contents.doubts(0.0)
