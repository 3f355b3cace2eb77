"""Cyclone's configuration from the environment variables of ROS 2."""

import subprocess
import sys
import xml.etree.ElementTree as ET

import pytest

from uros.middleware.base import MiddlewareError
from uros.middleware.dds import config, cyclone
from uros.middleware.environment import RANGES, discovery_range

PID = 4711


def parts(environment):
    """Return ``(<General>, <Discovery>, the user's part behind ours)``."""
    ours, _, rest = config.config_xml(environment, PID).partition("</CycloneDDS>")
    root = ET.fromstring(ours + "</CycloneDDS>")
    return root.find("Domain/General"), root.find("Domain/Discovery"), rest


def peers(environment):
    return [peer.get("Address") for peer in parts(environment)[1].iter("Peer")]


@pytest.mark.parametrize(
    ("environment", "reach"),
    [
        ({}, "SUBNET"),
        ({"ROS_LOCALHOST_ONLY": "0"}, "SUBNET"),
        ({"ROS_LOCALHOST_ONLY": "1"}, "LOCALHOST"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": ""}, "SUBNET"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "localhost"}, "LOCALHOST"),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "1"}, "SUBNET"),
        *[({"ROS_AUTOMATIC_DISCOVERY_RANGE": name}, name) for name in RANGES],
    ],
)
def test_range(environment, reach):
    assert discovery_range(environment) == reach


@pytest.mark.parametrize("value", ["LOCAL", "1", "SUBNET ", "NOT_SET"])
def test_an_unknown_range_is_refused_with_the_list_of_ranges(value):
    with pytest.raises(MiddlewareError) as failed:
        config.config_xml({"ROS_AUTOMATIC_DISCOVERY_RANGE": value}, PID)
    message = str(failed.value)
    assert repr(value) in message
    assert all(name in message for name in ("OFF", "LOCALHOST", "SUBNET", "SYSTEM_DEFAULT"))


def test_subnet_leaves_the_network_as_cyclone_has_it():
    general, discovery, rest = parts({})
    assert len(general) == 0 and rest == ""
    assert discovery.findtext("ParticipantIndex") == "auto"
    assert peers({}) == []


def test_localhost_stays_on_loopback():
    general, _, _ = parts({"ROS_LOCALHOST_ONLY": "1"})
    assert general.findtext("AllowMulticast") == "false"
    assert general.find("Interfaces/NetworkInterface").get("address") == "127.0.0.1"
    assert peers({"ROS_LOCALHOST_ONLY": "1"}) == ["127.0.0.1"]


@pytest.mark.parametrize("reach", RANGES)
def test_disposals_carry_the_key_as_fast_dds_reads_it(reach):
    ours = config.config_xml({"ROS_AUTOMATIC_DISCOVERY_RANGE": reach}, PID)
    assert ET.fromstring(ours).findtext("Domain/Internal/GenerateKeyhash") == "true"


@pytest.mark.parametrize("reach", RANGES)
def test_type_information_of_fast_dds_is_ignored(reach):
    ours = config.config_xml({"ROS_AUTOMATIC_DISCOVERY_RANGE": reach}, PID)
    ignored = ET.fromstring(ours).findtext("Domain/Compatibility/IgnoreTypeInformation")
    assert ignored == "1.15"


def test_range_off_matches_no_participant():
    environment = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF", "ROS_STATIC_PEERS": "10.0.0.1"}
    general, discovery, _ = parts(environment)
    assert general.findtext("AllowMulticast") == "false"
    assert discovery.findtext("ParticipantIndex") == "none"
    assert str(PID) in discovery.findtext("Tag")
    assert peers(environment) == []


def test_static_peers_are_added_to_what_the_range_finds():
    environment = {"ROS_STATIC_PEERS": "10.0.0.1;robot.local;"}
    assert peers(environment) == ["10.0.0.1", "robot.local"]
    environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    assert peers(environment) == ["127.0.0.1", "10.0.0.1", "robot.local"]


def test_a_peer_cannot_break_out_of_its_attribute():
    assert peers({"ROS_STATIC_PEERS": 'a"/><Peer Address="b<&'}) == ['a"/><Peer Address="b<&']


def test_system_default_leaves_the_configuration_to_the_user():
    environment = {
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "SYSTEM_DEFAULT",
        "ROS_STATIC_PEERS": "10.0.0.1",
    }
    assert len(parts(environment)[0]) == 0
    assert peers(environment) == []


def test_the_users_own_configuration_comes_last():
    own = "<General><AllowMulticast>spdp</AllowMulticast></General>"
    general, _, rest = parts({"CYCLONEDDS_URI": own, "ROS_LOCALHOST_ONLY": "1"})
    assert rest == "," + own
    # A configuration without interfaces opens nothing to the network.
    assert general.find("Interfaces/NetworkInterface").get("address") == "127.0.0.1"


OWN = "<General><Interfaces><NetworkInterface {}/></Interfaces></General>"
OLD = "<General><NetworkInterfaceAddress>{}</NetworkInterfaceAddress></General>"


@pytest.mark.parametrize(
    "uri, loopback",
    [
        (OWN.format('name="eth0"'), False),
        (OWN.format('name="lo"'), True),
        (OWN.format("priority='1' address='127.0.0.1'"), True),
        (OWN.format('address="10.0.0.1"'), False),
        (OLD.format("eth0"), False),
        (OLD.format("127.0.0.1"), True),
        (OWN.format('name="lo"') + "," + OWN.format('name="eth0"'), False),
    ],
)
def test_interfaces_that_the_user_chooses(uri, loopback, tmp_path):
    file = tmp_path / "own.xml"
    file.write_text(uri)
    for own in (uri, f"file://{file}", str(file)):
        environment = {"CYCLONEDDS_URI": own, "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
        # Interfaces add up: with ours in the configuration, the user could not choose another.
        assert "127.0.0.1" not in config.config_xml(environment, PID).partition(",")[0].replace(
            '<Peer Address="127.0.0.1" />', ""
        )
        assert config.stays_on_loopback(environment) is loopback


def test_configurations_that_stay_on_loopback():
    for reach in ("", "SUBNET", "OFF", "SYSTEM_DEFAULT"):
        assert not config.stays_on_loopback({"ROS_AUTOMATIC_DISCOVERY_RANGE": reach})
    tracing = "<Tracing><Verbosity>info</Verbosity></Tracing>"
    for own in ("", tracing, "file:///no/such/file"):
        assert config.stays_on_loopback({"ROS_LOCALHOST_ONLY": "1", "CYCLONEDDS_URI": own})


@pytest.mark.parametrize(
    "environment",
    [
        {},
        {"ROS_LOCALHOST_ONLY": "1"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"},
        {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "127.0.0.1;127.0.0.2"},
    ],
    ids=["subnet", "localhost", "off", "peers"],
)
def test_cyclone_accepts_it(environment, own_domain_id):
    if not environment:  # the tests stay on loopback
        environment = {
            "CYCLONEDDS_URI": '<General><Interfaces><NetworkInterface address="127.0.0.1"/>'
            "</Interfaces></General>"
        }
    cyclone.open_domain(own_domain_id, config.config_xml(environment, PID))
    try:
        assert cyclone.create_participant(own_domain_id, b"") > 0
    finally:
        cyclone.close_domain(own_domain_id)


def test_a_users_configuration_that_cyclone_refuses_is_an_error(own_domain_id):
    xml = config.config_xml({"CYCLONEDDS_URI": "<General><Nonsense/></General>"}, PID)
    with pytest.raises(MiddlewareError, match=f"DDS cannot join domain {own_domain_id}"):
        cyclone.open_domain(own_domain_id, xml)


def test_an_agent_does_not_load_what_only_quotes_text():
    code = "import sys, uros.middleware.dds.config; sys.exit('urllib.request' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
