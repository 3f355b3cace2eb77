"""Certificates of the tests' own, made anew in each run: a CA, the agent's, boards'."""

import ssl
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import trustme

from uros.agent.transports.certificates import Certificates

HOSTS = ("localhost", "127.0.0.1", "::1")


class Authority:
    """A CA that writes what it signs into a folder; ``ca`` is the file with its own certificate."""

    def __init__(self, folder, name="ca"):
        self.folder = Path(folder)
        self.folder.mkdir(exist_ok=True)
        self._ca = trustme.CA()
        self.ca = str(self.folder / f"{name}.pem")
        self._ca.cert_pem.write_to_path(self.ca)

    def issue(self, name, *hosts, **options):
        """(certificate, key): files. ``options`` are trustme's, such as not_after."""
        made = self._ca.issue_cert(*(hosts or HOSTS), common_name=name, **options)
        cert, key = self.folder / f"{name}.pem", self.folder / f"{name}.key"
        cert.write_bytes(b"".join(it.bytes() for it in made.cert_chain_pems))
        made.private_key_pem.write_to_path(str(key))
        return str(cert), str(key)

    def agent(self, **options):
        """(certificate, key) of an agent on this machine."""
        return self.issue("agent", **options)

    def client(self, name=None, trust=None):
        """An SSLContext for connecting; ``name`` is whose certificate it shows."""
        context = ssl.create_default_context(cafile=trust or self.ca)
        if name is not None:
            context.load_cert_chain(*self.issue(name))
        return context


@lru_cache
def authority():
    """The run's, with its folder, which goes when the process does."""
    made = Authority(_folder().name)
    made.files = made.agent()
    return made


@lru_cache
def _folder():
    return TemporaryDirectory(prefix="uros-certificates-")


def own_certificates():
    """What an agent of the run speaks TLS with; boards need none."""
    return Certificates(*authority().files)
