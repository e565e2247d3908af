"""Compares the RIHS01 hashes of sm2-ros-idl with those of rosbags.

check.py FILE: FILE has the output of the example `hashes`. Types that rosbags has in its store for
ROS 2 Jazzy are compared with the store's own definition. The text that SM2 wrote for each type is
parsed by rosbags as well, and its hash is compared.
"""

import json
import re
import sys

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


def main():
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    jazzy.fielddefs = with_uint8(jazzy.fielddefs)
    stored = wrong = count = 0
    for line in open(sys.argv[1], encoding="utf-8"):
        entry = json.loads(line)
        name, ours = entry["name"], entry["hash"]
        hashes = {"the parsed text": parsed(name, entry["text"]).hash_rihs01(name)}
        if name in jazzy.fielddefs:
            stored += 1
            hashes["its store"] = jazzy.hash_rihs01(name)
        count += 1
        for source, theirs in hashes.items():
            if ours != theirs:
                wrong += 1
                print(f"{name}: SM2 has {ours}, rosbags {theirs} from {source}")
    print(f"compared {count} types, {stored} of them with the store of rosbags; {wrong} differ")
    if wrong or stored < 131:
        sys.exit(1)


main()
