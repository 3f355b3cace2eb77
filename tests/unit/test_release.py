"""A release has the version of its tag; its workflow publishes what was built and installed."""

import importlib.util
import re

import pytest
import yaml
from support.paths import ROOT

import uros

WORKFLOW = yaml.safe_load((ROOT / ".github" / "workflows" / "release.yml").read_text("utf-8"))
JOBS = WORKFLOW["jobs"]


@pytest.fixture
def release(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT / "scripts"))
    spec = importlib.util.spec_from_file_location("release", ROOT / "scripts" / "release.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_version_is_that_of_the_package_and_of_mip(release):
    assert release.version() == uros.__version__
    for name in ("package.json", "package-all.json"):
        assert f'"version": "{uros.__version__}"' in (ROOT / name).read_text("utf-8")


def test_a_tag_of_another_version_is_refused(release):
    with pytest.raises(release.env.Unavailable, match="v1.2.0 is not that of the version 1.3.0"):
        release.check("v1.2.0", "1.3.0", "## [1.3.0] - 2027-01-31\n")


@pytest.mark.parametrize(
    "changelog", ["## [Unreleased]\n", "## [1.3.0]\n", "## [1x3x0] - 2027-01-31\n"]
)
def test_a_version_without_a_section_in_the_changelog_is_refused(release, changelog):
    with pytest.raises(release.env.Unavailable, match="no section of 1.3.0; rename"):
        release.check("v1.3.0", "1.3.0", changelog)


def test_a_tag_with_its_section_is_accepted(release):
    release.check("v1.3.0", "1.3.0", "# Changelog\n\n## [1.3.0] - 2027-01-31\n\n### Added\n")


def test_the_changelog_has_a_section_for_each_release_or_none_yet():
    text = (ROOT / "CHANGELOG.md").read_text("utf-8")
    first, *rest = re.findall(r"^## \[(.+?)\](.*)$", text, re.M)
    assert first[0] == "Unreleased"
    assert all(re.fullmatch(r" - \d{4}-\d\d-\d\d", date) for _, date in rest)


def test_nothing_is_published_that_was_not_installed_on_every_python(release):
    oldest, newest = release.env.OLDEST[1], release.env.NEWEST[1]
    pythons = JOBS["install"]["strategy"]["matrix"]["python"]
    assert pythons == [f"3.{minor}" for minor in range(oldest, newest + 1)]
    assert set(JOBS["publish"]["needs"]) == {"install", "debian"}
    assert JOBS["install"]["needs"] == JOBS["debian"]["needs"] == "build"


def test_the_workflow_stores_no_token_and_has_no_more_rights_than_it_needs():
    assert WORKFLOW["permissions"] == {"contents": "read"}
    rights = {name: job["permissions"] for name, job in JOBS.items() if "permissions" in job}
    assert rights == {"publish": {"id-token": "write"}, "release": {"contents": "write"}}
    assert JOBS["publish"]["environment"] == "pypi"
    assert "secrets." not in (ROOT / ".github" / "workflows" / "release.yml").read_text("utf-8")


def test_the_workflow_calls_what_there_is():
    makefile = (ROOT / "Makefile").read_text("utf-8")
    lines = [step.get("run", "") for job in JOBS.values() for step in job["steps"]]
    targets = set(re.findall(r"^make (\w+)", "\n".join(lines), re.M))
    assert targets == {"release"} and "\nrelease:\n" in makefile
