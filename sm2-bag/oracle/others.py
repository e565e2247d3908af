"""Bags of other programs have equal contents through `sm2 bag` and `sm2 play`.

others.py SM2 FOLDER: writes bags with the Python packages mcap and rosbags into FOLDER, and runs the program SM2 on
each of them. A Manager runs at SM2_SOCKET.
"""

import json
import signal
import subprocess
import sys
import time
from itertools import count, product
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, IndexType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosWriter
from rosbags.typesys import Stores, get_typestore

MESSAGES = 24
STRING = "std_msgs/msg/String"
sm2, folder = sys.argv[1], Path(sys.argv[2])
numbers = count()


def text(number):
    """A message in CDR."""
    return get_typestore(Stores.ROS2_JAZZY).serialize_cdr(
        get_typestore(Stores.ROS2_JAZZY).types[STRING](data=f"message {number} " * 20), STRING
    )


def write_mcap(path, options, overlap):
    """Writes several schemas, a channel without messages, an attachment and a metadata record. Returns the messages:
    (topic, schema, encoding, log time, publish time, data)."""
    expected = []
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=600, **options)
        writer.start(profile="", library="other")
        ros = writer.register_schema(STRING, "ros2msg", b"string data")
        schema = writer.register_schema("other", "jsonschema", b"{}")
        channels = [
            ("/text", STRING, "cdr", writer.register_channel("/text", "cdr", ros)),
            ("/json", "other", "json", writer.register_channel("/json", "json", schema)),
            ("/raw", "", "", writer.register_channel("/raw", "", 0)),
        ]
        writer.register_channel("/silent", "cdr", ros)
        times = list(range(MESSAGES))
        if overlap:
            times = times[::2] + times[1::2]
        for number in times:
            topic, name, encoding, channel = channels[number % 3]
            data = bytes(text(number))
            log_time, publish_time = 1_000_000_000 + number, 900_000_000 + number
            writer.add_message(channel, log_time, data, publish_time, number)
            expected.append((topic, name, encoding, log_time, publish_time, data))
        writer.add_attachment(5, 6, "map.png", "image/png", b"a picture")
        writer.add_metadata("robot", {"name": "R2"})
        writer.finish()
    return sorted(expected, key=lambda it: it[3])


def read(path):
    """The content of a bag of SM2, whose checksums are verified, and its attachments and metadata records."""
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        content = [
            (
                channel.topic,
                schema.name if schema else "",
                channel.message_encoding,
                it.log_time,
                it.publish_time,
                it.data,
            )
            for schema, channel, it in reader.iter_messages()
        ]
        attachments = [(it.name, it.data) for it in reader.iter_attachments()]
        records = [(it.name, it.metadata) for it in reader.iter_metadata() if not it.name.startswith("sm2.")]
    return content, attachments, records


def run(*arguments):
    """Runs `sm2`, which prints one line of JSON."""
    command = [sm2, *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, (arguments, done)
    return json.loads(done.stdout)


def new():
    return folder / f"new{next(numbers)}.mcap"


def counts(report):
    return {it["name"]: it["messages"] for it in report["topics"]}


def compare(path, expected, silent, attachments, records):
    """`info`, `check`, `convert`, `filter`, `recover` and `merge` keep the content."""
    topics = dict.fromkeys(silent, 0)
    for topic, *_ in expected:
        topics[topic] = topics.get(topic, 0) + 1
    report = run("bag", "info", path)
    assert counts(report) == topics and report["complete"], (path, report)
    assert run("bag", "check", path)["damages"] == [], path
    commands = [
        ("convert", "--compression", "zstd"),
        ("convert", "--compression", "lz4"),
        ("filter",),
        ("recover",),
    ]
    for command, *options in commands:
        to = new()
        assert counts(run("bag", command, path, "-o", to, *options)) == topics, (path, command)
        content, its_attachments, its_records = read(to)
        assert content == expected, (path, command)
        assert (its_attachments, its_records) == (attachments, records), (path, command, its_attachments, its_records)
    to = new()
    first = expected[0][0]
    run("bag", "filter", path, "--topic", first.lstrip("/"), "-o", to)
    assert read(to)[0] == [it for it in expected if it[0] == first], path
    to = new()
    run("bag", "merge", path, path, "-o", to)
    assert sorted(read(to)[0]) == sorted(expected * 2), path


def play(path, expected):
    """A recording of what SM2 plays has the same payloads."""
    to = new()
    topic, quiet = expected[0][0].lstrip("/"), subprocess.DEVNULL
    record = [sm2, "record", topic, "--reliable", topic, "-o", to]
    with subprocess.Popen(record, stdout=quiet, stderr=quiet) as recorder:
        played = run("play", path, "--topic", topic, "--rate", 0, "--wait", 1)
        recorder.send_signal(signal.SIGINT)
        assert recorder.wait(60) == 0
    payloads = [it[5] for it in expected if it[0].lstrip("/") == topic]
    assert played["topics"][0]["messages"] == len(payloads), played
    assert [it[5] for it in read(to)[0]] == payloads, path


def write_ros(path, version, mode):
    """A folder of rosbag2 whose last topic has no messages."""
    store = get_typestore(Stores.ROS2_JAZZY)
    expected = []
    writer = RosWriter(path, version=version, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        topics = [(name, writer.add_connection(name, STRING, typestore=store)) for name in ("/a", "/b", "/silent")]
        for number in range(MESSAGES):
            topic, connection = topics[number % 2]
            data = bytes(text(number))
            time = 1_000_000_000 + number
            writer.write(connection, time, data)
            expected.append((topic, STRING, "cdr", time, time, data))
    return expected


def main():
    kinds = 0
    for chunked, compression, index, overlap in product(
        (True, False),
        (CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD),
        (IndexType.ALL, IndexType.NONE, IndexType.CHUNK),
        (False, True),
    ):
        if not chunked and (compression != CompressionType.NONE or index == IndexType.CHUNK):
            # Only chunks are compressed or have an index.
            continue
        path = folder / f"other{kinds}.mcap"
        options = {
            "use_chunking": chunked,
            "compression": compression,
            "index_types": index,
            "use_statistics": index != IndexType.NONE,
        }
        expected = write_mcap(path, options, overlap)
        compare(path, expected, ["/silent"], [("map.png", b"a picture")], [("robot", {"name": "R2"})])
        if kinds % 5 == 0:
            play(path, expected)
        kinds += 1
    for version, mode in product((8, 9), CompressionMode):
        path = folder / f"ros{version}{mode.name}"
        expected = write_ros(path, version, mode)
        # A copy of messages that were compressed one by one has no record of rosbag2.
        with_record = mode != CompressionMode.MESSAGE
        report = run("bag", "info", path)
        assert counts(report) == {"/a": MESSAGES // 2, "/b": MESSAGES // 2, "/silent": 0}, report
        to = new()
        run("bag", "convert", path, "--compression", "zstd", "-o", to)
        records = read(to)[2]
        assert [name for name, _ in records] == (["rosbag2"] if with_record else []), records
        compare(path, expected, ["/silent"], [], records)
        play(path, expected)
        kinds += 1
    assert kinds >= 20
    print(f"{kinds} kinds of bags of other programs: equal contents through all commands")


began = time.monotonic()
main()
print(f"in {time.monotonic() - began:.0f} s")
