"""ArduPilot's ``AP_DDS_Client``, from its public sources (libraries/AP_DDS).

Up to 4.5 it refers to profiles (``by_reference``), for which the agent needs the file
``dds_xrce_profile.xml`` of ArduPilot; :func:`profiles` writes an equivalent one. From 4.6 on it
describes all entities in binary, and the agent needs no file. All messages, samples too, use the
reliable streams, eight messages deep.
"""

from support import autopilot
from support.autopilot import (
    BY_REFERENCE,
    BY_XML,
    KEEP_LAST,
    PARTICIPANT,
    PUBLISHER,
    READER,
    RELIABLE,
    RELIABLE_STREAM,
    REPLIER,
    SUBSCRIBER,
    TOPIC,
    TRANSIENT_LOCAL,
    WRITER,
    object_id,
)

KEY = 0xAAAABBBB
SENSOR = KEEP_LAST, 5
CLOCK = RELIABLE | KEEP_LAST, 20
LATCHED = RELIABLE | KEEP_LAST | TRANSIENT_LOCAL, 1

# (topic, type, whether it publishes, (QoS flags, depth), ms between samples)
TOPICS_46 = [
    ("ap/time", "builtin_interfaces/Time", True, CLOCK, 10),
    ("ap/navsat", "sensor_msgs/NavSatFix", True, SENSOR, 200),
    ("ap/tf_static", "tf2_msgs/TFMessage", True, LATCHED, 0),
    ("ap/battery", "sensor_msgs/BatteryState", True, SENSOR, 1000),
    ("ap/imu/experimental/data", "sensor_msgs/Imu", True, SENSOR, 5),
    ("ap/pose/filtered", "geometry_msgs/PoseStamped", True, SENSOR, 33),
    ("ap/twist/filtered", "geometry_msgs/TwistStamped", True, SENSOR, 33),
    ("ap/airspeed", "geometry_msgs/Vector3Stamped", True, SENSOR, 33),
    ("ap/geopose/filtered", "geographic_msgs/GeoPoseStamped", True, SENSOR, 33),
    ("ap/goal_lla", "geographic_msgs/GeoPointStamped", True, LATCHED, 200),
    ("ap/clock", "rosgraph_msgs/Clock", True, CLOCK, 10),
    ("ap/gps_global_origin/filtered", "geographic_msgs/GeoPointStamped", True, SENSOR, 1000),
    ("ap/status", "ardupilot_msgs/Status", True, LATCHED, 100),
    ("ap/joy", "sensor_msgs/Joy", False, SENSOR, 0),
    ("ap/tf", "tf2_msgs/TFMessage", False, SENSOR, 0),
    ("ap/cmd_vel", "geometry_msgs/TwistStamped", False, SENSOR, 0),
    ("ap/cmd_gps_pose", "ardupilot_msgs/GlobalPosition", False, SENSOR, 0),
]
SERVICES_46 = [
    ("ap/arm_motors", "ardupilot_msgs/ArmMotors"),
    ("ap/mode_switch", "ardupilot_msgs/ModeSwitch"),
    ("ap/prearm_check", "std_srvs/Trigger"),
    ("ap/experimental/takeoff", "ardupilot_msgs/Takeoff"),
    ("ap/set_parameters", "rcl_interfaces/SetParameters"),
    ("ap/get_parameters", "rcl_interfaces/GetParameters"),
]
# The profiles of 4.5 leave out a writer's durability and all of a reader's QoS. The defaults of
# Fast DDS are transient local for a writer, volatile and best effort for a reader.
DEFAULTED = RELIABLE | KEEP_LAST | TRANSIENT_LOCAL, 20
READERS = KEEP_LAST, 1
TOPICS_45 = [
    ("ap/time", "builtin_interfaces/Time", True, DEFAULTED, 10),
    ("ap/navsat/navsat0", "sensor_msgs/NavSatFix", True, SENSOR, 200),
    ("ap/tf_static", "tf2_msgs/TFMessage", True, LATCHED, 0),
    ("ap/battery/battery0", "sensor_msgs/BatteryState", True, SENSOR, 1000),
    ("ap/pose/filtered", "geometry_msgs/PoseStamped", True, SENSOR, 33),
    ("ap/twist/filtered", "geometry_msgs/TwistStamped", True, SENSOR, 33),
    ("ap/geopose/filtered", "geographic_msgs/GeoPoseStamped", True, SENSOR, 33),
    ("ap/clock", "rosgraph_msgs/Clock", True, DEFAULTED, 10),
    ("ap/joy", "sensor_msgs/Joy", False, READERS, 0),
    ("ap/tf", "tf2_msgs/TFMessage", False, READERS, 0),
    ("ap/cmd_vel", "geometry_msgs/TwistStamped", False, READERS, 0),
    ("ap/cmd_gps_pose", "ardupilot_msgs/GlobalPosition", False, READERS, 0),
]
SERVICES_45 = SERVICES_46[:2]
NODE_45 = "ardupilot_dds"
NODE_46 = "ap"


def dds_type(name, kind="msg", suffix=""):
    package, name = name.split("/")
    return f"{package}::{kind}::dds_::{name}{suffix}_"


def label(topic):
    """A profile's name; ArduPilot's own names differ, and are as arbitrary."""
    return topic.removeprefix("ap/").replace("/", "")


def profiles():
    """A references file equivalent to that of ArduPilot 4.5."""
    parts = [
        '<?xml version="1.0"?>\n<profiles>\n'
        '<participant profile_name="participant_profile"><rtps>'
        f"<name>{NODE_45}</name></rtps></participant>"
    ]
    for topic, kind, publishes, (flags, depth), _ in TOPICS_45:
        about = f"<name>rt/{topic}</name><dataType>{dds_type(kind)}</dataType>"
        history = f"<historyQos><kind>KEEP_LAST</kind><depth>{depth}</depth></historyQos>"
        # The <topic> has a depth for readers too, but a reader does not use it.
        topic_history = history if publishes else history.replace(f">{depth}<", ">5<")
        parts.append(f'<topic profile_name="{label(topic)}__t">{about}{topic_history}</topic>')
        if not publishes:
            parts.append(
                f'<data_reader profile_name="{label(topic)}__dr">'
                f"<topic><kind>NO_KEY</kind>{about}</topic></data_reader>"
            )
            continue
        word = "RELIABLE" if flags & RELIABLE else "BEST_EFFORT"
        qos = f"<reliability><kind>{word}</kind></reliability>"
        if (flags, depth) != DEFAULTED:
            word = "TRANSIENT_LOCAL" if flags & TRANSIENT_LOCAL else "VOLATILE"
            qos += f"<durability><kind>{word}</kind></durability>"
        parts.append(
            f'<data_writer profile_name="{label(topic)}__dw">'
            "<historyMemoryPolicy>PREALLOCATED_WITH_REALLOC</historyMemoryPolicy>"
            f"<qos>{qos}</qos><topic><kind>NO_KEY</kind>{about}{history}</topic></data_writer>"
        )
    for name, kind in SERVICES_45:
        request, reply = (dds_type(kind, "srv", suffix) for suffix in ("_Request", "_Response"))
        parts.append(
            f'<replier profile_name="{label(name)}__replier" service_name="rs/{name}Service"'
            f' request_type="{request}" reply_type="{reply}">'
            f"<request_topic_name>rq/{name}Request</request_topic_name>"
            f"<reply_topic_name>rr/{name}Reply</reply_topic_name></replier>"
        )
    return "\n".join([*parts, "</profiles>\n"])


class ArduPilot(autopilot.Vehicle):
    """A vehicle. Parameter of the firmware: DDS_DOMAIN_ID. The client key is constant."""

    history = 8

    def __init__(self, link, by_reference=False, domain=0):
        super().__init__(link, KEY)
        self.by_reference = by_reference
        self.domain = domain
        self.topics = TOPICS_45 if by_reference else TOPICS_46
        self.services = SERVICES_45 if by_reference else SERVICES_46
        self.node = "/" + (NODE_45 if by_reference else NODE_46)
        self.participant = object_id(1, PARTICIPANT)

    def connect(self):
        self.find_agent()
        self.open()
        self.create()

    def create(self):
        """Create all entities. AssertionError where one is refused."""
        self.must("participant", self.create_participant())
        for number, topic in enumerate(self.topics):
            self.must(topic[0], *self._create_topic(number, *topic))
            if not topic[2]:
                self.session.read_data(object_id(number, READER), RELIABLE_STREAM)
        for number, service in enumerate(self.services):
            self.must(service[0], self._create_service(number, *service))
            self.session.read_data(object_id(number, REPLIER), RELIABLE_STREAM)
        self.settle()

    def create_participant(self):
        """Buffer the CREATE; its request id."""
        if self.by_reference:
            return self.session.create(
                1, PARTICIPANT, BY_REFERENCE, "participant_profile", self.domain
            )
        return self.session.participant_bin(1, self.domain, NODE_46)

    def _create_topic(self, number, topic, kind, publishes, qos, _):
        session = self.session
        group_kind, end_kind = (PUBLISHER, WRITER) if publishes else (SUBSCRIBER, READER)
        topic_id, group = object_id(number, TOPIC), object_id(number, group_kind)
        if self.by_reference:
            name = label(topic)
            end = f"{name}__dw" if publishes else f"{name}__dr"
            return [
                session.create(number, TOPIC, BY_REFERENCE, f"{name}__t", self.participant),
                session.create(number, group_kind, BY_XML, "", self.participant),
                session.create(number, end_kind, BY_REFERENCE, end, group),
            ]
        return [
            session.topic_bin(number, self.participant, f"rt/{topic}", dds_type(kind)),
            session.group_bin(number, group_kind, self.participant),
            session.endpoint_bin(number, end_kind, group, topic_id, *qos),
        ]

    def _create_service(self, number, name, kind):
        if self.by_reference:
            return self.session.create(
                number, REPLIER, BY_REFERENCE, f"{label(name)}__replier", self.participant
            )
        return self.session.replier_bin(
            number,
            self.participant,
            f"rs/{name}Service",
            [dds_type(kind, "srv", suffix) for suffix in ("_Request", "_Response")],
            [f"rq/{name}Request", f"rr/{name}Reply"],
        )

    def number(self, topic):
        return [row[0] for row in self.topics].index(topic)

    def writer(self, topic):
        return object_id(self.number(topic), WRITER)

    def reader(self, topic):
        return object_id(self.number(topic), READER)

    def replier(self, name):
        return object_id([row[0] for row in self.services].index(name), REPLIER)

    def publish(self, topic, sample):
        """Publish a sample; False: the stream is full and the sample lost, as in the firmware."""
        return self.session.write_reliable(self.writer(topic), sample)
