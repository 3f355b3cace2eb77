"""Hosts with several interfaces, which come and go, and IPv6: each in network namespaces."""

import pytest
from support.networks import run_isolated

pytestmark = pytest.mark.timeout(180)


# These wait for the end of a lease, 20 s.
LEASE = pytest.mark.slow


@pytest.mark.parametrize(
    "scenario",
    [
        "each_interface_carries_announcements",
        "an_interface_that_appears_is_used",
        pytest.param("an_interface_that_vanishes_is_left", marks=LEASE),
        "a_network_that_is_away_for_a_moment_changes_nothing",
        "a_link_that_goes_at_either_end_is_left_at_once",
        "an_address_of_ours_that_vanishes_is_left",
        pytest.param("an_address_that_changes_is_followed", marks=LEASE),
        "ipv6",
        "link_local_ipv6",
        "both_versions_of_ip",
        "cyclone_over_ipv6",
        "cyclone_over_two_interfaces",
    ],
)
def test_hosts(scenario):
    run_isolated("support.rtps_hosts", scenario)
