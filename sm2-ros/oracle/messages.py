"""Random messages for rosbags, always the same ones."""

import math
import random

import numpy
from rosbags.interfaces import Nodetype

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
