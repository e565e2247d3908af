"""Messages of ROS 2 in Python, alone and together with Rust (examples/ros_peer.rs)."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import SOON, Child, linked, received
from test_zero_copy import mapping_of

import sm2

PEER = os.environ.get("SM2_PYTHON_ROS_PEER")

String = sm2.ros.load("std_msgs/msg/String")
Image = sm2.ros.load("sensor_msgs/msg/Image")
PointCloud2 = sm2.ros.load("sensor_msgs/msg/PointCloud2")
PointField = sm2.ros.load("sensor_msgs/msg/PointField")

STRING_HASH = "df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"


def there_and_back(type: sm2.MessageType[Any], value: Any) -> Any:
    """A value that was encoded and decoded."""
    return type.decode(type.encode(value))


def an_image(rows: int, columns: int) -> sm2.ros.Message:
    """An image with different bytes everywhere."""
    pixels = np.arange(rows * columns, dtype="u4").view("u1")
    header = {"stamp": {"sec": -5, "nanosec": 7}, "frame_id": "vorn/ä"}
    return Image(header=header, height=rows, width=columns, encoding="32SC1", step=4 * columns, data=pixels)


def a_cloud(count: int) -> sm2.ros.Message:
    """A cloud with three fields."""
    points = np.zeros(count, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    points["x"] = np.arange(count)
    points["z"] = -1
    fields = [
        PointField(name=name, offset=4 * at, datatype=PointField.FLOAT32, count=1) for at, name in enumerate("xyz")
    ]
    return PointCloud2(
        height=1, width=count, fields=fields, point_step=12, row_step=12 * count, data=points.tobytes(), is_dense=True
    )


@pytest.fixture
def peer(domain: Child) -> Iterator[None]:
    """Runs the program in Rust in the domain of the test."""
    if PEER is None:
        pytest.skip("SM2_PYTHON_ROS_PEER names no program")
    with subprocess.Popen([PEER], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None and process.stdout.readline() == "ready\n"
        yield
        process.kill()


def test_names_and_hashes_are_those_of_ros() -> None:
    assert String.name == "std_msgs/msg/String"
    assert String.schema == f"cdr:RIHS01_{STRING_HASH}\nstring data\n"
    assert Image.fields["data"] == "uint8[]" and list(Image.fields)[0] == "header"
    assert sm2.ros.load("sensor_msgs/msg/Image") is Image
    assert PointField.FLOAT32 == 7 and PointField.constants["INT8"] == 1


@pytest.mark.parametrize("rows", [0, 1, 10, 700])
def test_an_image_is_a_view_of_the_sample(node: sm2.Node, rows: int) -> None:
    publisher, subscriber = linked(node, "image", Image, {}, {})
    sent = an_image(rows, 1000)
    publisher.publish(sent)
    sample = received(subscriber)
    assert sample.type_name == "sensor_msgs/msg/Image"
    image = sample.value
    # In any order.
    assert (image.encoding, image.width, image.step, image.height) == ("32SC1", 1000, 4000, rows)
    assert (image.header.stamp.nanosec, image.header.stamp.sec) == (7, -5)
    assert image.header.frame_id == "vorn/ä" and image.is_bigendian == 0
    pixels = image.data
    assert np.array_equal(pixels, sent.data) and not pixels.flags.writeable
    start = np.frombuffer(memoryview(sample), "u1").ctypes.data
    assert start < pixels.ctypes.data <= start + len(sample)
    if rows > 100:
        assert "/memfd:" in mapping_of(pixels.ctypes.data)
    # The view keeps the memory.
    del sample, image
    subscriber.close()
    node.close()
    assert np.array_equal(pixels, sent.data)


def test_rust_and_python_have_the_same_messages(peer: None, node: sm2.Node) -> None:
    types = {"string": String, "image": Image, "cloud": PointCloud2}
    publishers = {name: node.publisher(f"ros/{name}", type) for name, type in types.items()}
    echoes = {name: node.subscriber(f"ros/{name}/echo", type) for name, type in types.items()}
    for publisher in publishers.values():
        publisher.wait_for_subscribers(1, SOON)
    for subscriber in echoes.values():
        subscriber.wait_for_publishers(1, SOON)
    for rows in (0, 3, 500):
        publishers["string"].publish({"data": "ä" * rows})
        assert received(echoes["string"]).value.data == "ä" * rows + "!"
        sent = an_image(rows, 500)
        publishers["image"].publish(sent)
        image = received(echoes["image"]).value
        assert (image.height, image.width, image.header.frame_id) == (rows, 501, "vorn/ä")
        assert np.array_equal(image.data, sent.data)
        cloud = a_cloud(rows)
        publishers["cloud"].publish(cloud)
        echo = received(echoes["cloud"]).value
        assert [(it.name, it.offset) for it in echo.fields] == [("x", 0), ("y", 4), ("z", 8)]
        assert echo.data.tobytes() == cloud.data and echo.is_dense is False


def test_another_definition_is_a_mismatch_with_rust(peer: None, node: sm2.Node, tmp_path: Path) -> None:
    (tmp_path / "std_msgs/msg").mkdir(parents=True)
    (tmp_path / "std_msgs/msg/String.msg").write_text("string text\n")
    other = sm2.ros.load("std_msgs/msg/String", tmp_path)
    assert other.schema != String.schema
    with pytest.raises(sm2.TypeMismatchError) as caught:
        node.publisher("ros/string", other)
    assert "string text" in str(caught.value) and "string data" in str(caught.value)


ALL = """
bool flag True
byte a
char b 7
int8 c -3
uint16 d
int16 e
uint32 f
int32 g
uint64 h
int64 i
float32 j 1.5
float64 k
string l "word"
wstring m
uint8[3] n
float64[] o [1.0, 2.0]
bool[] p
string[] q
Part[] r
Part s
Empty t
string<=4 u
int32[<=2] v
uint8 LIMIT=255
int32 LOW=-0x10
string GREETING="hello"
float32 HALF=0.5
bool YES=true
"""


@pytest.fixture
def all_kinds(tmp_path: Path) -> sm2.ros.Type:
    """A type with a field of each kind."""
    folder = tmp_path / "my_msgs"
    (folder / "msg").mkdir(parents=True)
    for name, text in {"All": ALL, "Part": "float32 x 2.5\nstring[] names\n", "Empty": ""}.items():
        (folder / f"msg/{name}.msg").write_text(text)
    return sm2.ros.load("my_msgs/msg/All", folder)


VALUES: dict[str, Any] = {
    "flag": False,
    "a": 255,
    "b": 1,
    "c": -128,
    "d": 65535,
    "e": -32768,
    "f": 2**32 - 1,
    "g": -(2**31),
    "h": 2**64 - 1,
    "i": -(2**63),
    "j": -0.25,
    "k": 1e300,
    "l": "Grüße",
    "m": "ä🤖",
    "n": [1, 2, 3],
    "o": [0.5, -1.0],
    "p": [True, False, True],
    "q": ["", "x"],
    "u": "four",
    "v": [7, -7],
}


def test_each_kind_of_field(all_kinds: sm2.ros.Type) -> None:
    parts = [{"x": 1.0, "names": ["a", "b"]}, {}]
    view = there_and_back(all_kinds, {**VALUES, "r": parts, "s": {"names": ["c"]}})
    for name, value in VALUES.items():
        got = getattr(view, name)
        assert (got.tolist() if isinstance(got, np.ndarray) else got) == value, name
    assert [(it.x, it.names) for it in view.r] == [(1.0, ["a", "b"]), (2.5, [])]
    assert (view.s.x, view.s.names) == (2.5, ["c"])
    assert dir(view) == sorted(all_kinds.fields) and dir(view.t) == []
    # A received message is sent again.
    assert all_kinds.encode(view) == all_kinds.encode(all_kinds.copy(view))
    assert "l='Grüße'" in repr(view) and "<my_msgs/msg/Part x=2.5" in repr(view)


def test_fields_that_are_left_out_have_their_defaults(all_kinds: sm2.ros.Type) -> None:
    for view in (there_and_back(all_kinds, {}), there_and_back(all_kinds, all_kinds()), all_kinds()):
        assert (view.flag, view.b, view.c, view.j, view.l) == (True, 7, -3, 1.5, "word")
        assert view.o.tolist() == [1.0, 2.0] and view.n.tolist() == [0, 0, 0]
        assert (view.s.x, view.q, view.r) == (2.5, [], [])
    assert (all_kinds.LIMIT, all_kinds.LOW, all_kinds.GREETING) == (255, -16, "hello")
    assert (all_kinds.HALF, all_kinds.YES) == (0.5, True)
    message = all_kinds()
    message.s.x = 4.0
    message.n[1] = 9
    view = there_and_back(all_kinds, message)
    assert view.s.x == 4.0 and view.n.tolist() == [0, 9, 0] and all_kinds().s.x == 2.5


@pytest.mark.parametrize(
    "value, text",
    [
        ({"nothing": 1}, "All has no field nothing"),
        ({"s": {"y": 1}}, "s: my_msgs/msg/Part has no field y"),
        ({"a": 256}, "a: out of range"),
        ({"a": "x"}, "a: "),
        ({"c": 1.5}, "c: "),
        ({"l": 3}, "l: "),
        ({"l": "\ud800"}, "l: .*surrogates not allowed"),
        ({"n": [1, 2]}, "n: expected 3 elements, found 2"),
        ({"n": [1, 2, 300]}, "n: .*300"),
        ({"n": [1.0, 2.0, 3.0]}, "n: expected numbers of uint8, found float64"),
        ({"o": np.zeros(2, "f4")}, "o: expected an array of float64, found one of float32"),
        ({"o": "12"}, "o: expected a sequence of numbers, found str"),
        ({"v": [1, 2, 3]}, "v: 3 elements, where the definition allows 2"),
        ({"u": "longer"}, "u: 6 elements, where the definition allows 4"),
        ({"r": [{}, {"x": "1"}]}, r"r\[1\].x: "),
        ({"r": 3}, "r: "),
        (3, "'int' object has no attribute 'flag'"),
        (None, "has no attribute 'flag'"),
    ],
)
def test_values_that_do_not_fit_are_refused(all_kinds: sm2.ros.Type, value: Any, text: str) -> None:
    with pytest.raises(sm2.PublishError, match=f"^the value is not of type my_msgs/msg/All: .*{text}"):
        all_kinds.encode(value)


def test_names_that_nothing_defines_are_refused(tmp_path: Path) -> None:
    for name in ("Image", "sensor_msgs/Image", "sensor_msgs/msg/Nothing"):
        with pytest.raises(sm2.SchemaError, match=name):
            sm2.ros.load(name)
    with pytest.raises(OSError):
        sm2.ros.load("std_msgs/msg/String", tmp_path / "nothing")
    with pytest.raises(TypeError, match="has no field text: the fields are data"):
        String(text="hello")
    with pytest.raises(AttributeError, match="has no field text"):
        there_and_back(String, {}).text
    with pytest.raises(AttributeError, match="has no constant NOTHING"):
        PointField.NOTHING


def test_bytes_that_are_no_message_are_an_error_of_the_field(node: sm2.Node) -> None:
    liar = sm2.MessageType(Image.name, Image.schema, bytes, bytes)
    publisher = node.publisher("image", liar)
    subscriber = node.subscriber("image", Image)
    publisher.wait_for_subscribers(1, SOON)
    whole = bytes(Image.encode(an_image(2, 2)))
    for len_bytes in range(len(whole)):
        publisher.publish(whole[:len_bytes])
        image = received(subscriber).value
        with pytest.raises(sm2.RecvError, match="not of type sensor_msgs/msg/Image: .*(cut short|header|CDR)"):
            image.data
    # Text that is not Unicode, and numbers in the other byte order.
    at = whole.index("ä".encode())
    publisher.publish(whole[:at] + b"\xff" + whole[at + 1 :])
    image = received(subscriber).value
    with pytest.raises(sm2.RecvError, match="frame_id: text that is not Unicode"):
        image.header.frame_id
    assert image.width == 2


def test_the_other_byte_order_is_read() -> None:
    Scan = sm2.ros.load("std_msgs/msg/Float32MultiArray")
    data = b"\0\0\0\0" + bytes(4) + bytes(4) + (2).to_bytes(4, "big") + np.array([1.5, -2], ">f4").tobytes()
    values = Scan.decode(data).data
    assert values.tolist() == [1.5, -2.0]
    assert Scan.copy(Scan.decode(data)).data.dtype == np.dtype("<f4")


def test_services_have_types_of_ros(node: sm2.Node) -> None:
    types = [sm2.ros.load(f"std_srvs/srv/SetBool_{part}") for part in ("Request", "Response")]
    server = node.server("light", *types)
    client = node.client("light", *types)
    client.wait_for_servers(1, SOON)
    call = client.send({"data": True}, SOON)
    request = server.recv(SOON)
    assert request is not None
    request.reply({"success": request.value.data, "message": "on"})
    reply = call.wait()
    assert (reply.success, reply.message) == (True, "on")
