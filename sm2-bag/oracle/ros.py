"""Bags of ROS 2 that rosbags writes and SM2 plays, and that SM2 records and rosbags reads.

ros.py write FOLDER VERSION: writes a bag of rosbag2's format with random messages of several types.
ros.py check WRITTEN RECORDED INFO PLAYED REPORT: RECORDED is SM2's recording of WRITTEN while SM2 played it. INFO,
PLAYED and REPORT are the outputs of `sm2 bag info`, `sm2 play` and `sm2 record` as JSON.
"""

import json
import sys
from pathlib import Path

import numpy
from mcap.reader import make_reader
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

sys.path.insert(0, str(Path(__file__).parents[2] / "sm2-ros" / "oracle"))
from messages import random_message

CUSTOM = "my_msgs/msg/Wheel"
TYPES = [
    CUSTOM,
    "builtin_interfaces/msg/Time",
    "diagnostic_msgs/msg/DiagnosticArray",
    "geometry_msgs/msg/PoseStamped",
    "nav_msgs/msg/OccupancyGrid",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/JointState",
    "sensor_msgs/msg/PointCloud2",
    "std_msgs/msg/Empty",
    "std_msgs/msg/String",
    "tf2_msgs/msg/TFMessage",
]
MESSAGES = 20
NONE = QosTime(9223372036, 854775807)


def store():
    """The types of rosbags, and one more."""
    types = get_typestore(Stores.ROS2_JAZZY)
    text = "std_msgs/Header header\nfloat64[2] speed\nstring<=5 name\nbool[] flags\nuint8 LEFT=1\n"
    types.register(get_types_from_msg(text, CUSTOM))
    return types


def qos(number):
    """Four kinds of publishers."""
    reliable = QosReliability.BEST_EFFORT if number % 2 else QosReliability.RELIABLE
    durable = QosDurability.TRANSIENT_LOCAL if number % 4 == 2 else QosDurability.VOLATILE
    return Qos(QosHistory.KEEP_LAST, 10, reliable, durable, NONE, NONE, QosLiveliness.AUTOMATIC, NONE, False)


def write(folder, version):
    """Writes a bag."""
    types = store()
    with Writer(folder, version=version, storage_plugin=StoragePlugin.MCAP) as writer:
        connections = []
        for number, name in enumerate(TYPES):
            topic = f"/{name.replace('/', '_')}"
            added = writer.add_connection(topic, name, typestore=types, offered_qos_profiles=[qos(number)])
            connections.append(added)
        for time in range(MESSAGES):
            for connection in connections:
                message = random_message(types, connection.msgtype)
                if connection.msgtype.endswith("/Image"):
                    # Above 64 KiB, a message is a chunk of its own.
                    message.data = numpy.arange(100_000, dtype=numpy.uint8)
                data = types.serialize_cdr(message, connection.msgtype)
                writer.write(connection, 1_000_000_000 + time, data)


def read(path):
    """The connections and messages by topic; topics without the slash that ROS 2 has."""
    connections, messages = {}, {}
    with Reader(path) as reader:
        for connection in reader.connections:
            connections[connection.topic.lstrip("/")] = connection
        for connection, _, data in reader.messages():
            messages.setdefault(connection.topic.lstrip("/"), []).append(bytes(data))
    return connections, messages


def check(written, recorded, info, played, report):
    """Compares a recording with the bag that was played."""
    types = store()
    connections, messages = read(written)
    recorded_connections, recorded_messages = read(recorded)
    assert len(messages) == len(TYPES)
    assert recorded_messages == messages, {topic: len(it) for topic, it in recorded_messages.items()}
    for number, (topic, connection) in enumerate(connections.items()):
        ours = recorded_connections[topic]
        assert (ours.msgtype, ours.msgcount) == (connection.msgtype, MESSAGES), ours
        (theirs,), (profile,) = connection.ext.offered_qos_profiles, ours.ext.offered_qos_profiles
        assert theirs == qos(number), theirs
        # The player has a depth of its own.
        assert profile._replace(depth=10) == theirs, profile
        # The definition that SM2 wrote describes the same type.
        name = connection.msgtype
        own = get_typestore(Stores.EMPTY)
        own.register(get_types_from_msg(ours.msgdef.data, name))
        assert own.hash_rihs01(name) == types.hash_rihs01(name), name
        for data in recorded_messages[topic]:
            message = own.deserialize_cdr(data, name)
            assert bytes(own.serialize_cdr(message, name)) == data, (name, data)

    with recorded.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        found = {}
        for _, channel, message in reader.iter_messages():
            found.setdefault(channel.topic, []).append(message.data)
            assert channel.metadata["topic_type_hash"] == types.hash_rihs01(connections[channel.topic].msgtype)
        assert found == messages

    for path, slash in ((info, "/"), (report, "")):
        topics = {it["name"]: it for it in json.loads(path.read_text())["topics"]}
        for topic, connection in connections.items():
            shown = topics[slash + topic]
            assert (shown["type"]["name"], shown["messages"], shown["lost"]) == (connection.msgtype, MESSAGES, 0), shown
            # The index of another program has no lengths.
            assert shown["bytes"] == (None if slash else sum(map(len, messages[topic]))), shown
    topics = {it["name"]: it["messages"] for it in json.loads(played.read_text())["topics"]}
    assert topics == dict.fromkeys(connections, MESSAGES), topics
    print(f"{written.name}: {len(TYPES)} types, {MESSAGES} messages each, played and recorded with equal bytes")


def main():
    command, *arguments = sys.argv[1:]
    if command == "write":
        write(arguments[0], int(arguments[1]))
    else:
        check(*map(Path, arguments))


main()
