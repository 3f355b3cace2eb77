"""Names the new place of each module that moved, and tells a program that imports the old one.

`install` does it on CPython, by a finder that ``import`` asks first: an old import raises
ModuleNotFoundError or ImportError with the new name. Nothing of the old modules is kept.
MicroPython has no such finders; the builder tells it when it builds a program for a board.

`MODULES` and `NAMES` are the one place that knows old names. When a module moves again, change the
right side here too, and add the name that it had; tests/unit/test_moved.py looks at each entry.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False
if TYPE_CHECKING:  # "import uros" loads this, so it imports nothing else
    from collections.abc import Sequence
    from importlib.machinery import ModuleSpec
    from types import ModuleType
    from typing import Final

MODULES: Final = {
    "uros.agent.admission": "uros.agent.policy.admission",
    "uros.agent.application": "uros.agent.objects.application",
    "uros.agent.backlog": "uros.agent.policy.reader_backlog",
    "uros.agent.budget": "uros.agent.policy.memory_budget",
    "uros.agent.capture": "uros.agent.observability.capture",
    "uros.agent.client": "uros.agent.objects.client",
    "uros.agent.control": "uros.agent.policy.rules",
    "uros.agent.delivery": "uros.agent.session.delivery",
    "uros.agent.describe": "uros.agent.observability.format",
    "uros.agent.endpoint": "uros.agent.objects.endpoints",
    "uros.agent.entry": "uros.agent.persistence.write_cursor",
    "uros.agent.graph": "uros.agent.objects.ros_graph",
    "uros.agent.handler": "uros.agent.session.handler",
    "uros.agent.heap": "uros.agent.malloc_trim",
    "uros.agent.info": "uros.agent.objects.object_info",
    "uros.agent.inspection": "uros.agent.observability.status_socket",
    "uros.agent.jsonlines": "uros.agent.observability.jsonl",
    "uros.agent.keeper": "uros.agent.persistence.session_store",
    "uros.agent.kept": "uros.agent.persistence.records",
    "uros.agent.kinds": "uros.agent.objects.kinds",
    "uros.agent.limits": "uros.agent.policy.limits",
    "uros.agent.lines": "uros.agent.policy.line_loss",
    "uros.agent.liveliness": "uros.agent.policy.liveliness",
    "uros.agent.making": "uros.agent.objects.factory",
    "uros.agent.metrics": "uros.agent.observability.prometheus",
    "uros.agent.owners_values": "uros.agent.policy.config_values",
    "uros.agent.pace": "uros.agent.policy.time_budget",
    "uros.agent.pcapng": "uros.agent.observability.pcapng",
    "uros.agent.profiles": "uros.agent.objects.xml_profiles",
    "uros.agent.representation": "uros.agent.objects.representation",
    "uros.agent.restoring": "uros.agent.persistence.restore",
    "uros.agent.rivals": "uros.agent.policy.key_conflict",
    "uros.agent.shares": "uros.agent.policy.eviction",
    "uros.agent.snapshot": "uros.agent.observability.snapshot",
    "uros.agent.splices": "uros.agent.session.reassembly",
    "uros.agent.state": "uros.agent.persistence.journal",
    "uros.agent.taps": "uros.agent.observability.message_hooks",
    "uros.boards.air": "uros.boards.virtual.modems.radio_network",
    "uros.boards.arena": "uros.boards.virtual.world.arena",
    "uros.boards.bh1750": "uros.boards.virtual.devices.bh1750",
    "uros.boards.board": "uros.boards.virtual.hardware.board",
    "uros.boards.build": "uros.boards.builder.file_system",
    "uros.boards.bundle": "uros.boards.builder.passes.bundle",
    "uros.boards.camera": "uros.boards.virtual.devices.camera",
    "uros.boards.catalog": "uros.boards.virtual.models.catalog",
    "uros.boards.clock": "uros.boards.virtual.hardware.clock",
    "uros.boards.console": "uros.boards.deploy.console",
    "uros.boards.drv8835": "uros.boards.virtual.devices.drv8835",
    "uros.boards.encoder": "uros.boards.virtual.devices.encoder",
    "uros.boards.engine": "uros.boards.virtual.engine.process",
    "uros.boards.engine_console": "uros.boards.virtual.engine.console",
    "uros.boards.engine_cores": "uros.boards.virtual.engine.cores",
    "uros.boards.engine_cpython": "uros.boards.virtual.engine.cpython",
    "uros.boards.engine_host": "uros.boards.virtual.engine.syscalls",
    "uros.boards.engine_micropython": "uros.boards.virtual.engine.micropython",
    "uros.boards.engine_pins": "uros.boards.virtual.engine.pin_syscalls",
    "uros.boards.engine_plugs": "uros.boards.virtual.engine.peripheral_syscalls",
    "uros.boards.esp32": "uros.boards.virtual.models.esp32",
    "uros.boards.esp8266": "uros.boards.virtual.modems.esp8266",
    "uros.boards.fields": "uros.boards.builder.field_check",
    "uros.boards.flatten": "uros.boards.builder.passes.merge_classes",
    "uros.boards.foreign": "uros.boards.builder.foreign_names",
    "uros.boards.gnss": "uros.boards.virtual.devices.gnss",
    "uros.boards.gs2200": "uros.boards.virtual.modems.gs2200",
    "uros.boards.i2c": "uros.boards.virtual.hardware.i2c",
    "uros.boards.infer": "uros.boards.builder.type_inference",
    "uros.boards.lean": "uros.boards.builder.passes.terse_errors",
    "uros.boards.link": "uros.boards.builder.passes.link_imports",
    "uros.boards.lis3mdl": "uros.boards.virtual.devices.lis3mdl",
    "uros.boards.literal": "uros.boards.deploy.literal",
    "uros.boards.max17048": "uros.boards.virtual.devices.max17048",
    "uros.boards.mcp9600": "uros.boards.virtual.devices.mcp9600",
    "uros.boards.mip": "uros.boards.deploy.mip",
    "uros.boards.modem": "uros.boards.virtual.modems.modem",
    "uros.boards.motor": "uros.boards.virtual.devices.motor",
    "uros.boards.mpu6050": "uros.boards.virtual.devices.mpu6050",
    "uros.boards.named": "uros.boards.deploy.known_boards",
    "uros.boards.outdoors": "uros.boards.virtual.world.outdoors",
    "uros.boards.parts": "uros.boards.virtual.hardware.parts",
    "uros.boards.passes": "uros.boards.builder.pipeline",
    "uros.boards.pins": "uros.boards.virtual.hardware.pins",
    "uros.boards.plugs": "uros.boards.virtual.hardware.peripherals",
    "uros.boards.ra6m5": "uros.boards.virtual.models.ra6m5",
    "uros.boards.rawrepl": "uros.boards.deploy.raw_repl",
    "uros.boards.registers": "uros.boards.virtual.hardware.registers",
    "uros.boards.rename": "uros.boards.builder.passes.mangle",
    "uros.boards.room": "uros.boards.virtual.world.room",
    "uros.boards.rover": "uros.boards.virtual.world.rover",
    "uros.boards.running": "uros.boards.virtual.engine.runner",
    "uros.boards.scene": "uros.boards.virtual.world.renderer",
    "uros.boards.shake": "uros.boards.builder.passes.tree_shake",
    "uros.boards.shims": "uros.boards.virtual.shims",
    "uros.boards.shrink": "uros.boards.builder.passes.strip",
    "uros.boards.sht3x": "uros.boards.virtual.devices.sht3x",
    "uros.boards.spresense": "uros.boards.virtual.models.spresense",
    "uros.boards.spresense_sensors": "uros.boards.virtual.models.spresense_sensors",
    "uros.boards.sprturtlebot": "uros.boards.virtual.models.sprturtlebot",
    "uros.boards.tfluna": "uros.boards.virtual.devices.tfluna",
    "uros.boards.unfold": "uros.boards.builder.passes.inline_methods",
    "uros.boards.usb": "uros.boards.virtual.hardware.usb",
    "uros.boards.usb_descriptors": "uros.boards.virtual.hardware.usb_descriptors",
    "uros.boards.vcnl4010": "uros.boards.virtual.devices.vcnl4010",
    "uros.client.aio": "uros.client.asyncio_support",
    "uros.client.guard": "uros.client.guard_condition",
    "uros.client.latch": "uros.client.latched_publisher",
    "uros.client.let": "uros.client.logical_execution_time",
    "uros.client.shapes": "uros.client.dynamic_messages",
    "uros.host.graph": "uros.host.graph_queries",
    "uros.middleware.dds.announce": "uros.middleware.discovery_info.codec",
    "uros.middleware.dds.announced": "uros.middleware.discovery_info.intake",
    "uros.middleware.dds.conflicts": "uros.middleware.dds.type_conflict_detector",
    "uros.middleware.dds.forms": "uros.middleware.dds.service_peers",
    "uros.middleware.dds.gids": "uros.middleware.discovery_info.gid_size",
    "uros.middleware.dds.graph": "uros.middleware.dds.paced_discovery",
    "uros.middleware.dds.offers": "uros.middleware.dds.late_writer_heartbeat",
    "uros.middleware.dds.shared": "uros.middleware.ref_counted",
    "uros.middleware.dds.watched": "uros.middleware.dds.dispatcher",
    "uros.middleware.ros2.names": "uros.middleware.ros_names",
    "uros.middleware.wake": "uros.middleware.wakeup_fd",
    "uros.tools.agent_admission": "uros.tools.agent.options.admission",
    "uros.tools.agent_capture": "uros.tools.agent.options.capture",
    "uros.tools.agent_control": "uros.tools.agent.options.rules",
    "uros.tools.agent_inspection": "uros.tools.agent.options.status_socket",
    "uros.tools.agent_limits": "uros.tools.agent.options.limits",
    "uros.tools.agent_process": "uros.tools.agent.child_process",
    "uros.tools.agent_state": "uros.tools.agent.options.state",
    "uros.tools.agent_status": "uros.tools.agent.status",
    "uros.tools.agent_transports": "uros.tools.agent.options.transports",
    "uros.tools.board_build": "uros.tools.board.build",
    "uros.tools.board_console": "uros.tools.board.console",
    "uros.tools.board_deploy": "uros.tools.board.deploy",
    "uros.tools.board_index": "uros.tools.board.index",
    "uros.tools.board_list": "uros.tools.board.list",
    "uros.tools.board_named": "uros.tools.board.board_option",
    "uros.tools.board_run": "uros.tools.board.run",
    "uros.tools.board_screen": "uros.tools.board.screen",
    "uros.tools.board_session": "uros.tools.board.simulation",
    "uros.tools.calibrate": "uros.tools.rover.calibrate",
    "uros.tools.doctor_agents": "uros.tools.doctor.agents",
    "uros.tools.doctor_clock": "uros.tools.doctor.clock",
    "uros.tools.doctor_finding": "uros.tools.doctor.finding",
    "uros.tools.doctor_graph": "uros.tools.doctor.graph",
    "uros.tools.doctor_network": "uros.tools.doctor.network",
    "uros.tools.doctor_process": "uros.tools.doctor.process",
    "uros.tools.doctor_qos": "uros.tools.doctor.qos",
    "uros.tools.doctor_serial": "uros.tools.doctor.serial",
    "uros.tools.doctor_snapshots": "uros.tools.doctor.snapshots",
    "uros.tools.fill": "uros.tools.values.fill",
    "uros.tools.image_save": "uros.tools.image.save",
    "uros.tools.image_source": "uros.tools.image.source",
    "uros.tools.image_view": "uros.tools.image.view",
    "uros.tools.inspection": "uros.tools.agent.running_agents",
    "uros.tools.interface_build": "uros.tools.interface.build",
    "uros.tools.interface_list": "uros.tools.interface.list",
    "uros.tools.interface_package": "uros.tools.interface.package",
    "uros.tools.interface_packages": "uros.tools.interface.packages",
    "uros.tools.interface_proto": "uros.tools.interface.proto",
    "uros.tools.interface_show": "uros.tools.interface.show",
    "uros.tools.node_info": "uros.tools.node.info",
    "uros.tools.node_list": "uros.tools.node.list",
    "uros.tools.pid_view": "uros.tools.rover.pid",
    "uros.tools.qos_options": "uros.tools.values.qos_subscribe",
    "uros.tools.qos_publish": "uros.tools.values.qos_publish",
    "uros.tools.recordings": "uros.tools.capture.recordings",
    "uros.tools.recordings_pcapng": "uros.tools.capture.pcapng",
    "uros.tools.replay": "uros.tools.capture.replay",
    "uros.tools.replay_lines": "uros.tools.capture.connections",
    "uros.tools.replay_script": "uros.tools.capture.script",
    "uros.tools.run_listener": "uros.tools.run.listener",
    "uros.tools.run_node": "uros.tools.run.command",
    "uros.tools.run_talker": "uros.tools.run.talker",
    "uros.tools.run_trigger_service": "uros.tools.run.trigger_service",
    "uros.tools.service_call": "uros.tools.service.call",
    "uros.tools.service_find": "uros.tools.service.find",
    "uros.tools.service_list": "uros.tools.service.list",
    "uros.tools.service_type": "uros.tools.service.type",
    "uros.tools.topic_echo": "uros.tools.topic.echo",
    "uros.tools.topic_hz": "uros.tools.topic.hz",
    "uros.tools.topic_info": "uros.tools.topic.info",
    "uros.tools.topic_list": "uros.tools.topic.list",
    "uros.tools.topic_pub": "uros.tools.topic.pub",
    "uros.tools.trace": "uros.tools.capture.trace",
    "uros.tools.typed_values": "uros.tools.values.typed_values",
    "uros.tools.yaml_read": "uros.tools.values.yaml_read",
    "uros.tools.yaml_text": "uros.tools.values.yaml_text",
    "uros.transport.addresses": "uros.addresses",
    "uros.transport.base": "uros.agent.transports.base",
    "uros.transport.baud": "uros.agent.transports.baud",
    "uros.transport.canboard": "uros.transport.can",
    "uros.transport.canport": "uros.transport.can_host",
    "uros.transport.canpyb": "uros.transport.can_pyb",
    "uros.transport.certificates": "uros.agent.transports.certificates",
    "uros.transport.custom": "uros.agent.transports.custom",
    "uros.transport.datagram": "uros.transport.udp",
    "uros.transport.device": "uros.transport.serial_host",
    "uros.transport.discoveryboard": "uros.transport.discovery",
    "uros.transport.http": "uros.http_server",
    "uros.transport.ip": "uros.agent.transports.ip",
    "uros.transport.line": "uros.agent.transports.line",
    "uros.transport.memory": "uros.agent.transports.memory",
    "uros.transport.modem": "uros.transport.at_modem",
    "uros.transport.multiserial": "uros.agent.transports.multiserial",
    "uros.transport.portable_serial": "uros.agent.transports.portable_serial",
    "uros.transport.remedies": "uros.agent.transports.remedies",
    "uros.transport.rfcomm": "uros.agent.transports.rfcomm",
    "uros.transport.sockets": "uros.agent.transports.sockets",
    "uros.transport.stream": "uros.transport.serial",
    "uros.transport.tally": "uros.token_bucket",
    "uros.transport.tcpboard": "uros.transport.tcp",
    "uros.transport.terminal": "uros.agent.transports.terminal",
    "uros.transport.tlsboard": "uros.transport.tls",
    "uros.transport.worker": "uros.agent.transports.worker",
}
"""The new name of each module that moved, by its old one."""

_SPLIT: Final = {
    "uros.agent.objects": (
        "uros.agent.objects.object_table",
        "XrceObject",
    ),
    "uros.agent.session": (
        "uros.agent.session.session",
        "Session WriteSample",
    ),
    "uros.boards.deploy": (
        "uros.boards.deploy.deploy",
        "DeployError Device Plan Progress carry_out make_plan",
    ),
    "uros.tools.agent": (
        "uros.tools.agent.command",
        "add_arguments run",
    ),
    "uros.tools.doctor": (
        "uros.tools.doctor.command",
        "Doctor add_arguments run",
    ),
    "uros.tools.values": (
        "uros.tools.values.plain",
        """
        FieldError Show csv describe_array describe_string element fields is_message
        select text
        """,
    ),
    "uros.transport.can": (
        "uros.agent.transports.can",
        "CHANNEL_GONE CanServer MAX_UNSENT RETRY check_socketcan python_can",
    ),
    "uros.transport.discovery": (
        "uros.agent.transports.discovery",
        """
        DEFAULT_PORT DiscoveryServer FAULT_PAUSE GROUP MAX_ANSWERS
        MAX_ANSWERS_IN_ALL MAX_LOCATORS SCAN_PAUSE read_question write_answer
        """,
    ),
    "uros.transport.serial": (
        "uros.agent.transports.serial",
        "DeviceServer PseudoTerminalServer SerialServer has_termios is_url serial_server",
    ),
    "uros.transport.tcp": (
        "uros.agent.transports.tcp",
        """
        IDLE_SECONDS MAX_CONNECTIONS MAX_FROM_ONE MAX_UNSENT MAX_UNSENT_OF_ALL TcpServer
        is_client_hello
        """,
    ),
    "uros.transport.tls": (
        "uros.agent.transports.tls",
        "HANDSHAKE_SECONDS MAX_HANDSHAKES SHARE TlsServer tls_server",
    ),
    "uros.transport.udp": (
        "uros.agent.transports.udp",
        "UdpServer",
    ),
}
"""Old modules whose name means another module now: where their content is, and their public names.

A name that changed since is written ``old:new``.
"""

NAMES: Final = {
    f"{old}.{name.partition(':')[0]}": f"{new}.{name.rpartition(':')[2]}"
    for old, (new, names) in _SPLIT.items()
    for name in names.split()
}
"""The new full name of each name that moved out of a module which still exists, by its old one."""


def advice(name: str) -> str:
    """The new name of a module, or of a name in one, as a sentence.

    Args:
        name: The full name, such as ``uros.transport.stream`` or ``uros.transport.udp.UdpServer``.

    Returns:
        ``uros.transport.stream is now uros.transport.serial``, or "" where nothing of it moved.
    """
    if name in NAMES:
        return f"{name} is now {NAMES[name]}"
    old = name
    while old and old not in MODULES:
        old = old.rpartition(".")[0]
    return f"{old} is now {MODULES[old]}" if old else ""


def install() -> None:
    """Tell programs that import an old name the new one, from now on. Idempotent."""
    if _Finder not in sys.meta_path:
        sys.meta_path.insert(0, _Finder)


class _Finder:
    """A finder of ``sys.meta_path`` that finds nothing: it refuses what moved."""

    @staticmethod
    def find_spec(
        name: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if name in MODULES:
            # Without name=: "from package import module" ignores an error that carries the name.
            raise ModuleNotFoundError(advice(name))
        if name not in _SPLIT:
            return None
        others = [finder for finder in sys.meta_path if finder is not _Finder]
        found = (finder.find_spec(name, path, target) for finder in others)
        spec = next((spec for spec in found if spec is not None), None)
        if spec is not None and spec.loader is not None:
            _refuse_names(spec)
        return spec


def _refuse_names(spec: ModuleSpec) -> None:
    """Make the module of ``spec`` refuse the names that moved out of it."""
    loader = spec.loader
    assert loader is not None
    execute = loader.exec_module

    def exec_module(module: ModuleType) -> None:
        execute(module)
        module.__dict__["__getattr__"] = missing

    def missing(name: str) -> object:
        full = f"{spec.name}.{name}"
        if full in NAMES:
            raise ImportError(advice(full), name=spec.name)
        raise AttributeError(f"module {spec.name!r} has no attribute {name!r}")

    loader.exec_module = exec_module  # type: ignore[method-assign]
