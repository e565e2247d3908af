"""Reads a bag of SM2 with the MCAP library for Python, in order and by its index.

check.py BAG FRAME REPORT: the messages of topic `frames` are the file FRAME, those of `range` are 1.5.
REPORT is the output of `sm2 record --json`.
"""

import json
import struct
import sys
from collections import Counter

from mcap.reader import NonSeekingReader, make_reader

bag, frame, report = sys.argv[1:]
with open(frame, "rb") as file:
    expected = {"frames": file.read(), "range": struct.pack("<d", 1.5)}
with open(report, encoding="utf-8") as file:
    counts = {topic["name"]: topic["messages"] for topic in json.load(file)["topics"]}
assert sorted(counts) == sorted(expected) and all(counts.values()), counts

for reader in (make_reader, NonSeekingReader):
    with open(bag, "rb") as file:
        found = Counter()
        last = 0
        for _, channel, message in reader(file, validate_crcs=True).iter_messages():
            assert message.data == expected[channel.topic], (channel.topic, message.sequence)
            assert message.log_time >= last
            last = message.log_time
            found[channel.topic] += 1
    assert found == counts, (found, counts)

with open(bag, "rb") as file:
    summary = make_reader(file).get_summary()
statistics = summary.statistics
assert statistics.message_count == sum(counts.values())
assert statistics.message_end_time == last
assert statistics.chunk_count == len(summary.chunk_indexes)
middle = (statistics.message_start_time + statistics.message_end_time) // 2
with open(bag, "rb") as file:
    later = Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages(starting_at=middle))
assert all(0 < later[topic] < counts[topic] for topic in counts), (later, counts)
print(f"{bag.rsplit('/', 1)[-1]}: {dict(found)}, {len(summary.chunk_indexes)} chunks")
