"""Certificates for tests, created in each run: of a CA, the agent and boards."""

import datetime
import ssl
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import trustme
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization

from uros.agent.transports.certificates import Certificates

HOSTS = ("localhost", "127.0.0.1", "::1")


class Authority:
    """A CA that writes the certificates into a folder; ``ca`` is the file with its own one."""

    def __init__(self, folder, name="ca"):
        self.folder = Path(folder)
        self.folder.mkdir(exist_ok=True)
        self._ca = trustme.CA()
        self.ca = str(self.folder / f"{name}.pem")
        self._ca.cert_pem.write_to_path(self.ca)

    def issue(self, name, *hosts, **options):
        """Issue a certificate: (certificate file, key file). ``options`` are those of trustme."""
        issued = self._ca.issue_cert(*(hosts or HOSTS), common_name=name, **options)
        cert, key = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        cert.write_bytes(b"".join(pem.bytes() for pem in issued.cert_chain_pems))
        issued.private_key_pem.write_to_path(str(key))
        key.chmod(0o600)
        return str(cert), str(key)

    def agent(self, **options):
        """(certificate, key) of an agent on this machine."""
        return self.issue("agent", **options)

    def revoke(self, *certificates, path=None, days=7, age=30):
        """Write a revocation list of these certificate files; return its path.

        It was made ``age`` days ago and ends in ``days`` days. It has no other certificates, also
        if another list was written before.
        """
        now = datetime.datetime.now(datetime.timezone.utc)
        issuer = x509.load_pem_x509_certificate(self._ca.cert_pem.bytes())
        key = serialization.load_pem_private_key(self._ca.private_key_pem.bytes(), None)
        builder = (
            x509.CertificateRevocationListBuilder()
            .issuer_name(issuer.subject)
            .last_update(now - datetime.timedelta(age))
            .next_update(now + datetime.timedelta(days))
        )
        for file in certificates:
            serial = x509.load_pem_x509_certificate(Path(file).read_bytes()).serial_number
            revoked = x509.RevokedCertificateBuilder().serial_number(serial).revocation_date(now)
            builder = builder.add_revoked_certificate(revoked.build())
        signed = builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
        path = Path(path or self.folder / "crl.pem")
        path.write_bytes(signed)
        return str(path)

    def client(self, name=None, trust=None):
        """An SSLContext of a client; ``name`` is that in its certificate, None: without one."""
        context = ssl.create_default_context(cafile=trust or self.ca)
        if name is not None:
            context.load_cert_chain(*self.issue(name))
        return context


@lru_cache
def authority():
    """The CA of the test run; its folder is removed when the process ends."""
    ca = Authority(_folder().name)
    ca.files = ca.agent()
    return ca


@lru_cache
def _folder():
    return TemporaryDirectory(prefix="uros-certificates-")


def own_certificates():
    """The certificates of the run's agent, which asks boards for none."""
    return Certificates(*authority().files)
