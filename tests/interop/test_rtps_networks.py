"""rtps and a real rclpy node with rmw_fastrtps on another host, in network namespaces."""

import pytest
from support.networks import run_isolated

pytestmark = pytest.mark.timeout(180)


@pytest.mark.parametrize(
    "scenario",
    [
        "fast_dds_over_ipv6",
        "fast_dds_over_two_interfaces",
        "fast_dds_that_lists_us_as_its_peer",
        "fast_dds_that_we_list_as_our_peer",
    ],
)
def test_hosts(ros_python, scenario):
    run_isolated("support.rtps_hosts", scenario)
