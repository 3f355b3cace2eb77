"""micro-ROS in Python: boards, agent and tools. Importing it costs nothing."""

__version__ = "0.1.0"
