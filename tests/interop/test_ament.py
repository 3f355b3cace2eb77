"""ROS 2's own reader of the ament index finds the package that ``uros agent ament`` makes."""

import os
import subprocess

from uros.tools import cli

PROGRAM = """
from ament_index_python.packages import get_package_prefix, get_package_share_directory
print(get_package_prefix("micro_ros_agent"))
print(get_package_share_directory("micro_ros_agent"))
"""


def test_the_package_is_found_and_the_first_prefix_counts(ros_python, tmp_path):
    first, second = tmp_path / "first", tmp_path / "second"
    for prefix in (first, second):
        assert cli.main(["agent", "ament", str(prefix)]) == 0
    environment = {**os.environ, "AMENT_PREFIX_PATH": f"{first}:{second}"}
    done = subprocess.run(
        [ros_python, "-c", PROGRAM], env=environment, capture_output=True, text=True
    )
    assert done.stdout.split() == [str(first), str(first / "share" / "micro_ros_agent")]
