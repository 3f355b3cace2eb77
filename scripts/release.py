"""Makes the files of a release in dist: ``make release``.

    release.py [--tag TAG]

The source distribution, the wheel that it builds, the Debian package, an SBOM (CycloneDX) of uros
with its extras for hosts, and SHA256SUMS. With --tag, as the workflow release.yml calls it, the tag
must be that of the version, and the changelog must have a section of the version. Builds of one
commit have the same bytes: SOURCE_DATE_EPOCH is the time of the commit if it is not set. The wheel
does not depend on it.
"""

import argparse
import hashlib
import json
import os
import re
import shutil
import sys
import tempfile
from pathlib import Path

import deb
import env

DIST = env.ROOT / "dist"
EXTRAS = "can,dds,metrics,serial"
SBOM = "sbom.cdx.json"


def version() -> str:
    text = (env.ROOT / "src" / "uros" / "__init__.py").read_text("utf-8")
    return re.findall(r'^__version__ = "(.+)"$', text, re.M)[0]


def check(tag: str, number: str, changelog: str) -> None:
    """Raise env.Unavailable unless the tag and the changelog are those of the version."""
    if tag != f"v{number}":
        raise env.Unavailable(
            f"the tag {tag} is not that of the version {number}",
            f"tag v{number}, or change __version__ in src/uros/__init__.py",
        )
    if not re.search(rf"^## \[{re.escape(number)}\] - \d{{4}}-\d\d-\d\d$", changelog, re.M):
        raise env.Unavailable(
            f"CHANGELOG.md has no section of {number}",
            f"rename [Unreleased] to [{number}] - YEAR-MONTH-DAY, and begin a new [Unreleased]",
        )


def build() -> Path:
    """Build the source distribution, and from it the wheel; return the wheel."""
    command = [sys.executable, "-m", "build", "--no-isolation", "--outdir", DIST, env.ROOT]
    # hatchling has a date of its own, so that who has the sources alone gets the same bytes.
    undated = {name: value for name, value in os.environ.items() if name != "SOURCE_DATE_EPOCH"}
    env.run("build", command, env=undated)
    (wheel,) = DIST.glob("*.whl")
    return wheel


def write_sbom(wheel: Path) -> None:
    """List the components of an environment with the wheel, its extras and nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        python = Path(folder) / "bin" / "python"
        env.run("venv", [sys.executable, "-m", "venv", "--without-pip", folder])
        command = [sys.executable, "-m", "pip", "--python", python, "install", "-q"]
        command += ["--disable-pip-version-check", "-c", "constraints.txt", f"{wheel}[{EXTRAS}]"]
        env.run("pip install", command, cwd=env.ROOT)
        command = [sys.executable, "-m", "cyclonedx_py", "environment", "--output-reproducible"]
        command += [
            "--pyproject",
            "pyproject.toml",
            "--output-format",
            "JSON",
            "--output-file",
            DIST / SBOM,
            "--validate",
            python,
        ]
        env.run("cyclonedx-py", command, cwd=env.ROOT)
    sbom = json.loads((DIST / SBOM).read_text("utf-8"))
    sbom["metadata"]["component"]["version"] = version()  # pyproject.toml does not have it
    (DIST / SBOM).write_text(json.dumps(sbom, indent=2) + "\n", "utf-8")


def write_sums() -> None:
    lines = [
        f"{hashlib.sha256(file.read_bytes()).hexdigest()}  {file.name}\n"
        for file in sorted(DIST.iterdir())
    ]
    (DIST / "SHA256SUMS").write_text("".join(lines))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--tag", help="the tag of the release, such as v1.2.0")
    tag = parser.parse_args().tag
    try:
        if tag is not None:
            check(tag, version(), (env.ROOT / "CHANGELOG.md").read_text("utf-8"))
        deb.set_source_date()
        shutil.rmtree(DIST, ignore_errors=True)
        DIST.mkdir()
        wheel = build()
        if shutil.which("dpkg-deb"):
            deb.build(DIST)
        else:
            env.say("there is no dpkg-deb, so dist has no Debian package")
        write_sbom(wheel)
        write_sums()
    except env.Unavailable as error:
        sys.exit(f"release: {error.reason}\nrelease: {error.remedy}")
    print((DIST / "SHA256SUMS").read_text(), end="")


if __name__ == "__main__":
    main()
