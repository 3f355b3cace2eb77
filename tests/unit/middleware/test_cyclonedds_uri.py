"""CYCLONEDDS_URI: its parts, safe XML, and what rtps reads of it."""

import pytest

from uros.middleware import cyclonedds_uri
from uros.middleware.base import MiddlewareError
from uros.middleware.cyclonedds_uri import InterfaceChoice, read_settings

WHOLE = """<?xml version="1.0" encoding="utf-8"?>
<CycloneDDS xmlns="https://cdds.io/config" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
  xsi:schemaLocation="https://cdds.io/config https://example.org/cyclonedds.xsd">
  <Domain Id="any">
    <General>
      <Interfaces>
        <NetworkInterface name="eth0" priority="default" multicast="default"/>
        <NetworkInterface address="10.0.0.7" multicast="false"/>
      </Interfaces>
      <AllowMulticast>spdp</AllowMulticast>
      <Transport>udp6</Transport>
    </General>
    <Discovery>
      <ParticipantIndex>auto</ParticipantIndex>
      <MaxAutoParticipantIndex>60</MaxAutoParticipantIndex>
      <Peers><Peer address="10.0.0.9"/><Peer Address="[fd00::1]:7410"/></Peers>
    </Discovery>
  </Domain>
</CycloneDDS>
"""


def test_a_whole_configuration():
    settings = read_settings(WHOLE, 0)
    assert settings.interfaces == [InterfaceChoice("eth0"), InterfaceChoice("10.0.0.7", False)]
    assert settings.multicast is True and settings.ipv6 is True
    assert settings.index == "auto" and settings.max_index == 60
    assert settings.peers == ["10.0.0.9", "[fd00::1]:7410"]
    assert settings.unknown == []


def test_nothing_configured():
    settings = read_settings("", 0)
    assert settings == cyclonedds_uri.CycloneSettings()
    assert settings.multicast is settings.index is settings.ipv6 is None


@pytest.mark.parametrize(
    "uri, parts",
    [
        ("", []),
        ("a.xml, file:///b.xml", ["a.xml", "file:///b.xml"]),
        ("<A/>,<B/>", ["<A/>,<B/>"]),
        ("a.xml,<A/>,b.xml", ["a.xml", "<A/>", "b.xml"]),
        ("a.xml,<A", ["a.xml", "<A"]),
        ("<A/>,/etc/x.xml,<B/>", ["<A/>", "/etc/x.xml", "<B/>"]),
        ("<A>,<B/>,c</A> , d.xml", ["<A>,<B/>,c</A>", "d.xml"]),
        ('<A b=">,"/>,c,<D/>', ['<A b=">,"/>', "c", "<D/>"]),
        (
            "<?xml version='1.0'?>\n<!-- <a>, --><A/>,c",
            ["<?xml version='1.0'?>\n<!-- <a>, --><A/>", "c"],
        ),
        ("<A><![CDATA[</A>,]]></A>,c,<B/>", ["<A><![CDATA[</A>,]]></A>", "c", "<B/>"]),
        ("<A>,b,<C/>", ["<A>,b,<C/>"]),
        ("</A>,b,<C/>", ["</A>,b,<C/>"]),
    ],
)
def test_parts(uri, parts):
    assert cyclonedds_uri.parts(uri) == parts


def test_files_and_xml_add_up_and_the_last_value_counts(tmp_path):
    file = tmp_path / "own.xml"
    file.write_text(WHOLE)
    more = (
        "<General><NetworkInterfaceAddress>lo, auto</NetworkInterfaceAddress>"
        "<AllowMulticast>FALSE</AllowMulticast></General>,"
        "<Discovery><ParticipantIndex>7</ParticipantIndex>"
        '<Peers><Peer Address="robot"/></Peers></Discovery>'
    )
    for uri in (f"{file},{more}", f"file://{file},{more}"):
        settings = read_settings(uri, 0)
        assert [one.name for one in settings.interfaces] == ["eth0", "10.0.0.7", "lo", ""]
        assert settings.multicast is False and settings.index == 7
        assert settings.peers[-1] == "robot" and len(settings.peers) == 3


def test_a_file_between_two_elements_counts(tmp_path):
    file = tmp_path / "own.xml"
    file.write_text(WHOLE)
    uri = f"<General><UseIPv6>false</UseIPv6></General>,{file},<Discovery><Tag>x</Tag></Discovery>"
    settings = read_settings(uri, 0)
    assert settings.ipv6 is True and settings.max_index == 60 and settings.unknown == ["Tag"]


def test_spaces_around_values_do_not_count():
    uri = (
        '<General><Interfaces><NetworkInterface name=" eth0 " multicast=" default "/>'
        '<NetworkInterface name="a" multicast=" true "/></Interfaces></General>'
        '<Discovery><Peers><Peer address=" 127.0.0.1 "/></Peers></Discovery>'
    )
    settings = read_settings(uri, 0)
    assert settings.peers == ["127.0.0.1"]
    assert settings.interfaces == [InterfaceChoice("eth0"), InterfaceChoice("a", True)]


@pytest.mark.parametrize(
    "value, multicast",
    [("true", True), ("default", True), ("spdp", True), ("asm, spdp", True), ("false", False),
     ("asm", False), ("ssm", False)],
)  # fmt: skip
def test_allow_multicast(value, multicast):
    xml = f"<General><AllowMulticast>{value}</AllowMulticast></General>"
    assert read_settings(xml, 0).multicast is multicast


def test_the_configuration_of_another_domain_does_not_count():
    xml = '<Domain Id="5"><Discovery><ParticipantIndex>3</ParticipantIndex></Discovery></Domain>'
    assert read_settings(xml, 5).index == 3
    assert read_settings(xml, 4).index is None


def test_what_is_not_read_is_named_once():
    xml = (
        '<Tracing xmlns="https://cdds.io/config"><Verbosity>fine</Verbosity></Tracing><Tracing/>'
        "<General><FragmentSize>1000B</FragmentSize>"
        '<Interfaces><NetworkInterface name="a" priority="3"/><Psmx/></Interfaces></General>'
        "<Discovery><Tag>x</Tag><ParticipantIndex>default</ParticipantIndex>"
        '<Peers addlocalhost="true" other="default"><Peer address="a" prune_delay="1s"/>'
        '<Host address="b"/></Peers></Discovery>'
    )
    unknown = ["Tracing", "FragmentSize", "NetworkInterface priority", "Psmx", "Tag",
               "Peers addlocalhost", "Peer prune_delay", "Host"]  # fmt: skip
    settings = read_settings(xml, 0)
    assert settings.unknown == unknown and settings.peers == ["a"]


@pytest.mark.parametrize(
    "value, octets",
    [("1400B", 1400), ("1400 B", 1400), ("8kB", 8192), ("14 KiB", 14336), ("1MB", 1 << 20),
     ("1 GB", 1 << 30), ("2GiB", 2 << 30), ("default", None)],
)  # fmt: skip
def test_the_size_of_messages(value, octets):
    xml = f"<General><MaxMessageSize>{value}</MaxMessageSize></General>"
    assert read_settings(xml, 0).max_message == octets


@pytest.mark.parametrize(
    "uri, words",
    [
        ("<General><MaxMessageSize>1400</MaxMessageSize></General>", "'1400' is no size.* 1400 B"),
        (
            "<General><MaxMessageSize>huge kB</MaxMessageSize></General>",
            "'huge kB' is no size.* 1400 B",
        ),
        ("<General><MaxMessageSize>1 TB</MaxMessageSize></General>", "'1 TB' is no size.* 1400 B"),
        ("<General>", "not valid XML.*correct the XML"),
        ("<nix", "not valid XML"),
        ("file:///no/such/file.xml", "names file:///no/such/file.xml, which cannot be read"),
        ("<Discovery><ParticipantIndex>many</ParticipantIndex></Discovery>", "'many' is no number"),
        ("<Discovery><ParticipantIndex>-1</ParticipantIndex></Discovery>", "'-1' is no number"),
    ],
)
def test_faults_name_the_remedy(uri, words):
    with pytest.raises(MiddlewareError, match=words):
        read_settings(uri, 0)


def test_a_document_type_is_refused(tmp_path):
    """It could define entities that grow without end, or that name other files."""
    file = tmp_path / "own.xml"
    secret = tmp_path / "secret"
    secret.write_text("10.9.9.9")
    file.write_text(
        f'<!DOCTYPE x [<!ENTITY e SYSTEM "file://{secret}">]>'
        "<General><NetworkInterfaceAddress>&e;</NetworkInterfaceAddress></General>"
    )
    with pytest.raises(MiddlewareError, match="CYCLONEDDS_URI is not valid XML"):
        read_settings(str(file), 0)
    with pytest.raises(ValueError, match="undefined entity"):
        cyclonedds_uri.parse("<General>&e;</General>")
