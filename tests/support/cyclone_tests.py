"""The tests that need cyclonedds: left out where PyPI has no wheel of it (ARM, Python 3.14).

Where it has one, a missing package makes them fail. Tests in other files have the marker
``cyclone``. Paths are relative to ``tests/unit``.
"""

FILES = (
    "host/test_settle.py",
    "middleware/dds/test_batching.py",
    "middleware/dds/test_config.py",
    "middleware/dds/test_cyclone.py",
    "middleware/dds/test_discovery_info_reader.py",
    "middleware/dds/test_endpoints.py",
    "middleware/dds/test_late_writer_heartbeat.py",
    "middleware/dds/test_middleware.py",
    "middleware/dds/test_paced_discovery.py",
    "middleware/dds/test_service_peers.py",
    "middleware/discovery_info/test_gid_size.py",
    "middleware/test_auto.py",
    "middleware/test_type_conflicts.py",
    "test_bench.py",
)
