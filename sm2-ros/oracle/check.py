"""Compares sm2-ros and sm2-ros-idl with rosbags: RIHS01 hashes, and messages in CDR.

check.py HASHES TRANSCODE FOLDER: the paths of the examples `hashes` and `transcode`, and of the folder
of packages. `run` beside this file calls it.

Hashes: types that rosbags has in its store for ROS 2 Jazzy are compared with the store's own
definition. The text that SM2 wrote for each type is parsed by rosbags as well, and its hash is compared.

CDR: rosbags encodes random messages of each type. SM2 decodes them to JSON, which must have the same
values, and encodes the JSON, which must give the same bytes. rosbags must read SM2's bytes as well.
"""

import json
import math
import random
import re
import subprocess
import sys

import numpy
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore


def mangle(text):
    """rosbags knows no `srv` types: their names become names of messages for its parser."""
    return re.sub(r"\b(\w+)/(srv|action)/(\w+)", r"\1/msg/XX\2XX\3", text)


def restore(value):
    """Undoes `mangle` in a tree of definitions."""
    if isinstance(value, str):
        return re.sub(r"/msg/XX(srv|action)XX", r"/\1/", value)
    if isinstance(value, (list, tuple)):
        return type(value)(restore(item) for item in value)
    return value


def parsed(name, text):
    """A store with the definitions of SM2's text."""
    store = Typestore()
    types = get_types_from_msg(mangle(text), mangle(name))
    store.fielddefs = with_uint8({restore(key): restore(value) for key, value in types.items()})
    return store


def with_uint8(types):
    """Replaces `char` by `uint8`, as ROS 2 does before it hashes a type. rosbags 0.11.9 does not."""

    def replaced(value):
        if isinstance(value, (list, tuple)):
            if len(value) == 2 and value[0] == "char":
                return ("uint8", value[1])
            return type(value)(replaced(item) for item in value)
        return value

    return {key: (value[0], replaced(value[1])) for key, value in types.items()}


def check_hashes(entries):
    """Returns the number of types whose hashes differ."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    jazzy.fielddefs = with_uint8(jazzy.fielddefs)
    stored = wrong = 0
    for entry in entries:
        name, ours = entry["name"], entry["hash"]
        hashes = {"the parsed text": parsed(name, entry["text"]).hash_rihs01(name)}
        if name in jazzy.fielddefs:
            stored += 1
            hashes["its store"] = jazzy.hash_rihs01(name)
        for source, theirs in hashes.items():
            if ours != theirs:
                wrong += 1
                print(f"{name}: SM2 has {ours}, rosbags {theirs} from {source}")
    print(f"hashes: compared {len(entries)} types, {stored} with the store of rosbags; {wrong} differ")
    return wrong + (stored < 131)


RANDOM = random.Random(1)
SPECIAL = {
    "float32": [0.0, -0.0, 1.5, math.inf, -math.inf, float(numpy.float32(0.1))],
    "float64": [0.0, -0.0, 0.1, math.inf, -math.inf, 1e300],
}


def scalar(kind):
    """A random number, boolean or text."""
    base, limit = kind
    if base == "string":
        text = "".join(RANDOM.choice("abc Z\u00e4\u20ac\U0001f916\"\\\n") for _ in range(RANDOM.randrange(9)))
        return text[: limit // 4] if limit else text
    if base == "bool":
        return RANDOM.random() < 0.5
    if base in SPECIAL:
        return RANDOM.choice(SPECIAL[base])
    if base in ("byte", "char"):
        # rosbags packs them with a sign, so the upper half has no common form.
        return RANDOM.randrange(128)
    info = numpy.iinfo(base)
    return RANDOM.choice([int(info.min), int(info.max), RANDOM.randint(int(info.min), int(info.max))])


def random_value(store, desc):
    """A random value of a field, in the form that rosbags takes."""
    node, rest = desc
    if node == Nodetype.BASE:
        return scalar(rest)
    if node == Nodetype.NAME:
        return random_message(store, rest)
    element, count = rest
    if node == Nodetype.SEQUENCE:
        count = RANDOM.randrange(min(count or 5, 5) + 1)
    values = [random_value(store, element) for _ in range(count)]
    if element[0] == Nodetype.BASE and element[1][0] != "string":
        dtype = {"byte": "uint8", "char": "uint8"}.get(element[1][0], element[1][0])
        return numpy.array(values, dtype=dtype)
    return values


def random_message(store, name):
    """A random message of a type."""
    values = {field: random_value(store, desc) for field, desc in store.fielddefs[name][1]}
    # The byte of a structure without fields has no meaning.
    unnamed = "structure_needs_at_least_one_member"
    return store.types[name](**{field: 0 if field == unnamed else value for field, value in values.items()})


def plain(value):
    """A message of rosbags in the form of JSON."""
    if isinstance(value, numpy.ndarray):
        return [plain(item) for item in value.tolist()]
    if isinstance(value, list):
        return [plain(item) for item in value]
    if isinstance(value, float) and math.isinf(value):
        return "inf" if value > 0 else "-inf"
    if hasattr(value, "__msgtype__"):
        # Names in capitals are those of constants.
        unnamed = ("__msgtype__", "structure_needs_at_least_one_member")
        fields = [it for it in vars(value).items() if it[0] not in unnamed and not it[0].isupper()]
        return {key: plain(item) for key, item in fields}
    return value


def check_cdr(entries, transcode, folder):
    """Returns the number of messages that differ."""
    store = Typestore()
    for entry in entries:
        store.register(get_types_from_msg(mangle(entry["text"]), mangle(entry["name"])))
    messages = []
    for entry in entries:
        for _ in range(20):
            message = random_message(store, mangle(entry["name"]))
            messages.append((entry["name"], message, bytes(store.serialize_cdr(message, mangle(entry["name"])))))
    lines = "".join(f"{name} {data.hex()}\n" for name, _, data in messages)
    done = subprocess.run([transcode, folder], input=lines, capture_output=True, text=True, check=False)
    answers = done.stdout.splitlines()
    print(done.stderr, end="")
    wrong = len(messages) - len(answers)
    for (name, message, data), answer in zip(messages, answers):
        digits, text = answer.split(" ", 1)
        ours = bytes.fromhex(digits)
        read = store.deserialize_cdr(ours, mangle(name)) if ours == data else None
        if ours != data or json.loads(text) != plain(message) or plain(read) != plain(message):
            wrong += 1
            print(f"{name}: rosbags wrote {data.hex()}, SM2 {digits} from {text}; meant {plain(message)}")
    print(f"CDR: compared {len(messages)} messages of {len(entries)} types; {wrong} differ")
    return wrong


def main():
    hashes, transcode, folder = sys.argv[1:]
    done = subprocess.run([hashes, folder], stdout=subprocess.PIPE, text=True, check=True)
    entries = [json.loads(line) for line in done.stdout.splitlines()]
    if check_hashes(entries) + check_cdr(entries, transcode, folder):
        sys.exit(1)


main()
