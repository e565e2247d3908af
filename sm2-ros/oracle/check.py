"""Compares sm2-ros and sm2-ros-idl with rosbags: RIHS01 hashes, and messages in CDR.

check.py HASHES TRANSCODE FOLDER: the paths of the examples `hashes` and `transcode`, and of the folder
of packages. `run` beside this file calls it.

Hashes: types that rosbags has in its store for ROS 2 Jazzy are compared with the store's own
definition. The text that SM2 wrote for each type is parsed by rosbags as well, and its hash is compared.

CDR: rosbags encodes random messages of each type. SM2 decodes them to JSON, which must have the same
values, and encodes the JSON, which must give the same bytes. SM2's Rust type must decode the message and
encode it to the same bytes as well. rosbags must read SM2's bytes.
"""

import json
import math
import re
import subprocess
import sys

import numpy
from messages import random_message
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
    typed_count = 0
    for (name, message, data), answer in zip(messages, answers):
        digits, typed, text = answer.split(" ", 2)
        ours = bytes.fromhex(digits)
        # A service or action itself has no Rust type.
        typed_count += typed != "-"
        is_typed = typed in ("-", digits)
        read = store.deserialize_cdr(ours, mangle(name)) if ours == data else None
        if ours != data or not is_typed or json.loads(text) != plain(message) or plain(read) != plain(message):
            wrong += 1
            print(f"{name}: rosbags wrote {data.hex()}, SM2 {digits} and {typed} from {text}; meant {plain(message)}")
    print(
        f"CDR: compared {len(messages)} messages of {len(entries)} types, "
        f"{typed_count} of them with Rust types; {wrong} differ"
    )
    return wrong + (typed_count < 3600)


def main():
    hashes, transcode, folder = sys.argv[1:]
    done = subprocess.run([hashes, folder], stdout=subprocess.PIPE, text=True, check=True)
    entries = [json.loads(line) for line in done.stdout.splitlines()]
    if check_hashes(entries) + check_cdr(entries, transcode, folder):
        sys.exit(1)


main()
