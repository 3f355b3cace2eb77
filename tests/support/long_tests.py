"""The files of unit tests that ``make quick`` leaves out, since each takes long.

Processes, real middleware and builds make them so. Paths are below ``tests/unit``.
"""

LONG = (
    "agent/observability/test_capture.py",
    "agent/persistence/test_session_store.py",
    "agent/policy/test_eviction.py",
    "agent/transports/test_exhaustion.py",
    "agent/transports/test_process.py",
    "boards/builder/test_build_identical.py",
    "boards/builder/test_field_check.py",
    "boards/builder/test_resolver.py",
    "boards/deploy/test_mip.py",
    "boards/virtual/engine/test_cores.py",
    "boards/virtual/engine/test_process.py",
    "client/portable_faults.py",
    "client/portable_starving.py",
    "client/portable_time.py",
    "client/test_faults.py",
    "host/test_leaving.py",
    "host/test_network.py",
    "host/test_node.py",
    "interfaces/test_codec.py",
    "tools/agent/options/test_state.py",
    "tools/board/test_board.py",
    "tools/board/test_build.py",
    "tools/board/test_deploy.py",
    "tools/board/test_lying_board.py",
    "tools/doctor/test_command.py",
    "tools/rover/test_calibrate.py",
    "tools/test_demo.py",
    "tools/test_fleet.py",
    "tools/test_printed.py",
    "transport/test_modems.py",
)
