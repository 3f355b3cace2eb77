"""PX4's ``uxrce_dds_client``, from its public sources (src/modules/uxrce_dds_client).

=========  ==============================  ===================  =========
release    topics are                      writers created      services
=========  ==============================  ===================  =========
v1.14      ``fmu/out/NAME``, in binary     when first needed    none
v1.15      the same, names from a table    when first needed    one
v1.16 on   with ``_vN`` behind versioned   at the start         one
           ones
=========  ==============================  ===================  =========

The participant alone comes as XML, or as the reference ``px4_participant``.
"""

import re
import struct
import time

from support import autopilot
from support.autopilot import (
    BEST_EFFORT_STREAM,
    BY_REFERENCE,
    BY_XML,
    KEEP_LAST,
    PARTICIPANT,
    PUBLISHER,
    READER,
    RELIABLE_STREAM,
    REPLIER,
    SUBSCRIBER,
    TOPIC,
    TRANSIENT_LOCAL,
    WRITER,
    object_id,
)

# The publications of dds_topics.yaml, and after them topics that users add.
PUBLICATIONS = """
    register_ext_component_reply arming_check_request mode_completed battery_status
    collision_constraints estimator_status_flags failsafe_flags manual_control_setpoint
    message_format_response position_setpoint_triplet sensor_combined timesync_status
    transponder_report vehicle_land_detected vehicle_attitude vehicle_control_mode
    vehicle_command_ack vehicle_global_position vehicle_local_position vehicle_odometry
    vehicle_status airspeed_validated vtol_vehicle_status home_position wind
    gimbal_device_attitude_status input_rc
    actuator_motors actuator_outputs actuator_servos airspeed cpuload distance_sensor
    esc_status estimator_status event hover_thrust_estimate log_message mission_result
    optical_flow power_button_state rate_ctrl_status sensor_accel sensor_baro sensor_gyro
    sensor_mag system_power takeoff_status vehicle_acceleration vehicle_angular_velocity
    vehicle_imu vehicle_thrust_setpoint vehicle_torque_setpoint
""".split()

SUBSCRIPTIONS = """
    register_ext_component_request unregister_ext_component config_overrides_request
    arming_check_reply message_format_request mode_completed config_control_setpoints
    distance_sensor manual_control_input offboard_control_mode onboard_computer_status
    obstacle_distance sensor_optical_flow goto_setpoint telemetry_status trajectory_setpoint
    vehicle_attitude_setpoint vehicle_mocap_odometry vehicle_rates_setpoint
    vehicle_visual_odometry vehicle_command vehicle_command_mode_executor
    vehicle_thrust_setpoint vehicle_torque_setpoint actuator_motors actuator_servos
    aux_global_position landing_gear
""".split()

# Topics whose type is not their own name.
TYPES = {
    "config_control_setpoints": "VehicleControlMode",
    "config_overrides_request": "ConfigOverrides",
    "manual_control_input": "ManualControlSetpoint",
    "vehicle_mocap_odometry": "VehicleOdometry",
    "vehicle_visual_odometry": "VehicleOdometry",
    "vehicle_command_mode_executor": "VehicleCommand",
    "aux_global_position": "VehicleGlobalPosition",
}
# Some topics with a version (msg/versioned), as of v1.16 and later.
VERSIONS = {"battery_status": 1, "vehicle_status": 1, "arming_check_request": 1, "home_position": 1}

LOCALHOST_XML = (
    "<dds><profiles><transport_descriptors><transport_descriptor>"
    "<transport_id>udp_localhost</transport_id><type>UDPv4</type>"
    "<interfaceWhiteList><address>127.0.0.1</address></interfaceWhiteList>"
    "</transport_descriptor></transport_descriptors></profiles>"
    "<participant><rtps><name>%s/px4_micro_xrce_dds</name>"
    "<useBuiltinTransports>false</useBuiltinTransports>"
    "<userTransports><transport_id>udp_localhost</transport_id></userTransports>"
    "</rtps></participant></dds>"
)
DEFAULT_XML = (
    "<dds><participant><rtps><name>%s/px4_micro_xrce_dds</name></rtps></participant></dds>"
)
CUSTOM_REFERENCE = "px4_participant"

# Writers have the number of their uORB topic; readers and services are numbered from this one.
SECOND_HALF = 65535 // 32 + 1
QUEUE = 4


def type_name(topic):
    """``vehicle_status`` → ``px4_msgs::msg::dds_::VehicleStatus_``."""
    camel = TYPES.get(topic) or re.sub(r"(?:^|_)(\w)", lambda match: match[1].upper(), topic)
    return f"px4_msgs::msg::dds_::{camel}_"


class Px4(autopilot.Vehicle):
    """A vehicle. Parameters of the firmware: UXRCE_DDS_KEY, _PTCFG, _DOM_ID, and ``-n``."""

    history = 4

    def __init__(self, link, key=1, namespace=None, config="default", domain=0, release="1.16"):
        super().__init__(link, key)
        self.namespace = namespace
        self.config = config
        self.domain = domain
        self.release = release
        self.participant = object_id(1, PARTICIPANT)
        self.writers = {}
        self.readers = {}
        self.offset = None
        self.offset_error = None

    # --- names

    def topic(self, name, direction):
        version = VERSIONS.get(name, 0) if self.release >= "1.16" else 0
        name = f"fmu/{direction}/{name}" + (f"_v{version}" if version else "")
        return f"rt/{self.namespace}/{name}" if self.namespace else f"rt/{name}"

    def service(self, name):
        """``(request topic, reply topic)``."""
        path = f"{self.namespace}/fmu" if self.namespace else "fmu"
        return f"rq/{path}/{name}Request", f"rr/{path}/{name}Reply"

    # --- setupSession

    def connect(self):
        """Do all that precedes the main loop. AssertionError where an entity is refused."""
        self.find_agent()
        self.open()
        self.must("participant", self.create_participant())
        self.synchronize()
        for name in SUBSCRIPTIONS:
            self.create_reader(name)
        if self.release >= "1.16":
            for name in PUBLICATIONS:
                self.create_writer(name)
        if self.release >= "1.15":
            self.create_service("vehicle_command", "VehicleCommand")
        self.settle()

    def create_participant(self):
        """Buffer the CREATE; its request id."""
        session = self.session
        if self.config == "custom":
            return session.create(1, PARTICIPANT, BY_REFERENCE, CUSTOM_REFERENCE, self.domain)
        xml = LOCALHOST_XML if self.config == "localhost" else DEFAULT_XML
        return session.create(1, PARTICIPANT, BY_XML, xml % (self.namespace or ""), self.domain)

    def synchronize(self, rounds=10):
        """``uxr_sync_session`` until it has converged.

        :attr:`offset` is in seconds, and :attr:`offset_error` the most by which it is wrong.
        """
        session = self.session
        best = None
        for _ in range(rounds):
            sent = time.monotonic_ns()
            session.times.clear()
            session.ask_time(*divmod(sent, 10**9))
            self.until(lambda: session.times, "no TIMESTAMP_REPLY")
            out_s, out_ns, in_s, in_ns, back_s, back_ns = session.times.popleft()
            assert (back_s, back_ns) == divmod(sent, 10**9)
            assert (out_s, out_ns) >= (in_s, in_ns)
            received = time.monotonic_ns()
            if best is None or received - sent < best:
                best = received - sent
                self.offset_error = best / 2e9
                self.offset = in_s + in_ns / 1e9 - (received + sent) / 2e9

    def _group(self, number, kind, name, direction):
        """Buffer topic and publisher or subscriber: (their request ids, ids of both)."""
        session = self.session
        requests = [
            session.topic_bin(number, self.participant, self.topic(name, direction),
                              type_name(name)),
            session.group_bin(number, kind, self.participant),
        ]  # fmt: skip
        return requests, object_id(number, TOPIC), object_id(number, kind)

    def create_writer(self, name):
        number = PUBLICATIONS.index(name)
        requests, topic, group = self._group(number, PUBLISHER, name, "out")
        # The library does not send a depth of 0.
        flags = KEEP_LAST | TRANSIENT_LOCAL
        requests.append(self.session.endpoint_bin(number, WRITER, group, topic, flags, 0))
        self.must(name, *requests)
        self.writers[name] = object_id(number, WRITER)

    def create_reader(self, name):
        number = SECOND_HALF + SUBSCRIPTIONS.index(name)
        requests, topic, group = self._group(number, SUBSCRIBER, name, "in")
        requests.append(
            self.session.endpoint_bin(number, READER, group, topic, KEEP_LAST, 2 * QUEUE)
        )
        self.must(name, *requests)
        self.readers[name] = object_id(number, READER)
        self.session.read_data(self.readers[name], BEST_EFFORT_STREAM)

    def create_service(self, name, kind):
        types = [f"px4_msgs::srv::dds_::{kind}_{suffix}_" for suffix in ("Request", "Response")]
        request = self.session.replier_bin(
            SECOND_HALF, self.participant, name, types, self.service(name)
        )
        self.must(name, request)
        self.replier = object_id(SECOND_HALF, REPLIER)
        self.session.read_data(self.replier, RELIABLE_STREAM)

    # --- the main loop

    def publish(self, name, sample):
        """Publish on the best-effort stream; before v1.16 the first call creates the writer."""
        if name not in self.writers:
            self.create_writer(name)
        self.session.write_best_effort(self.writers[name], sample)

    def answer(self, body):
        """Answer one request of the service; the body of the request."""
        requests = self.session.samples[self.replier]
        self.until(lambda: requests, "no request comes")
        request = requests.popleft()
        assert self.session.write_reliable(self.replier, request[:24] + body)
        self.session.flush()
        return request[24:]

    def disconnect(self):
        """``deleteSession`` when the agent does not answer any more: one DELETE, without answer."""
        self.session.delete_client()
        self.writers.clear()
        self.readers.clear()


def sample(counter, size=100):
    """A message: time stamp (``uint64 timestamp``), a counter, zeros up to ``size``."""
    head = struct.pack("<QI", time.monotonic_ns() // 1000, counter)
    return head + bytes(size - len(head))


def counter(sample):
    """The counter in a sample."""
    return struct.unpack_from("<I", sample, 8)[0]
