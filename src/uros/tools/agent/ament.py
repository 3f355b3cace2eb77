"""``uros agent ament``: make the ROS package ``micro_ros_agent``, which starts ``uros agent``.

``ros2 run`` and launch files find a package by the ament index of the prefixes in
``AMENT_PREFIX_PATH`` (REP 122): the first prefix that has it counts. The package is made in a
prefix on demand, so that no installation of uros hides a ``micro_ros_agent`` built from source.
"""

from __future__ import annotations

import argparse
import os
import shlex
import sys
from pathlib import Path
from typing import Any, Final

from ... import __version__
from ..errors import ToolError

NAME: Final = "ament"
PACKAGE: Final = "micro_ros_agent"
_HELP: Final = "make the ROS package micro_ros_agent, for ros2 run and launch files"
_EPILOG: Final = """\
Afterwards, in a terminal where ROS 2 is set up:

  source PREFIX/setup.bash
  ros2 run micro_ros_agent micro_ros_agent udp4 --port 8888
  ros2 launch micro_ros_agent micro_ros_agent_launch.py args:="serial --dev /dev/ttyACM0"

The prefix that was set up last is found first: source it after, or instead of, a workspace that has
eProsima's micro_ros_agent. To undo it, remove PREFIX.
"""
# In the package's own files, which a later run may replace.
_MARK: Final = "made by uros agent ament"

_MANIFEST: Final = f"""\
<?xml version="1.0"?>
<!-- {_MARK} -->
<package format="3">
  <name>{PACKAGE}</name>
  <version>{{version}}</version>
  <description>The micro-ROS agent of uros, under the name of eProsima's.</description>
  <maintainer email="uros@localhost">uros</maintainer>
  <license>Apache-2.0</license>
  <export>
    <build_type>ament_python</build_type>
  </export>
</package>
"""
_PROGRAM: Final = f"""\
#!/bin/sh
# {_MARK}
exec {{command}} "$@"
"""
_LAUNCH: Final = f'''\
"""Starts the agent; {_MARK}.

    ros2 launch {PACKAGE} {PACKAGE}_launch.py args:="serial --dev /dev/ttyACM0"
"""

import shlex

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node


def start(context):
    arguments = shlex.split(LaunchConfiguration("args").perform(context))
    return [
        Node(
            package="{PACKAGE}",
            executable="{PACKAGE}",
            name="{PACKAGE}",
            output="screen",
            arguments=arguments,
        )
    ]


def generate_launch_description():
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "args",
                default_value="udp4 --port 8888",
                description="the transport and the options, as after 'uros agent'",
            ),
            OpaqueFunction(function=start),
        ]
    )
'''
_SETUP: Final = f"""\
# {_MARK}
AMENT_PREFIX_PATH={{prefix}}${{{{AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}}}}
export AMENT_PREFIX_PATH
"""


def add_parser(transports: Any) -> None:
    """Declare ``ament``, which is given instead of a transport."""
    parser = transports.add_parser(
        NAME, help=_HELP, description=_HELP, epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument(
        "prefix", metavar="PREFIX", help="a folder of its own, such as ~/uros_ament"
    )


def run(args: argparse.Namespace) -> int:
    """Make the package and tell how to use it.

    Raises:
        ToolError: The prefix has another package of this name, or cannot be written.
    """
    prefix = Path(args.prefix).expanduser().absolute()
    make_package(prefix, [sys.executable, "-m", "uros", "agent"])
    print(f"made {PACKAGE} in {prefix}; next, where ROS 2 is set up:")
    print(f"  source {shlex.quote(str(prefix / 'setup.bash'))}")
    print(f"  ros2 run {PACKAGE} {PACKAGE} udp4 --port 8888")
    return 0


def make_package(prefix: Path, command: list[str], used_at: Path | None = None) -> None:
    """Make the package in a prefix, or update one that was made before.

    Args:
        prefix: The folder; it is created.
        command: The command that starts the agent; arguments follow it.
        used_at: Where the folder will be, if not there, as in a package of a distribution.

    Raises:
        ToolError: The prefix has another package of this name, or cannot be written.
    """
    share = prefix / "share"
    _refuse_others(prefix, share / PACKAGE / "package.xml")
    where = shlex.quote(str(used_at or prefix))
    files = {
        share / "ament_index" / "resource_index" / "packages" / PACKAGE: "",
        share / PACKAGE / "package.xml": _MANIFEST.format(version=__version__),
        share / PACKAGE / "launch" / f"{PACKAGE}_launch.py": _LAUNCH,
        **{
            prefix / f"setup.{shell}": _SETUP.format(prefix=where)
            for shell in ("sh", "bash", "zsh")
        },
    }
    program = prefix / "lib" / PACKAGE / PACKAGE
    try:
        for path, text in files.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(text, "utf-8")
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(_PROGRAM.format(command=shlex.join(command)), "utf-8")
        program.chmod(0o755)
    except OSError as error:
        raise ToolError(f"{error.filename}: {os.strerror(error.errno or 0)}") from error


def _refuse_others(prefix: Path, manifest: Path) -> None:
    """Raise ToolError if files of others would be replaced."""
    for path in (manifest, prefix / "setup.bash"):
        try:
            text = path.read_text("utf-8", "replace")
        except FileNotFoundError:
            continue
        except OSError as error:
            raise ToolError(f"{path}: {error.strerror}") from error
        if _MARK not in text:
            what = f"another {PACKAGE}" if path is manifest else "a workspace"
            raise ToolError(f"{prefix} is the prefix of {what} ({path}): name a new folder")
