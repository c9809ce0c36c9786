"""Topics of MCAP and rosbag2 files as columns over one clock."""

from __future__ import annotations

import io
import json
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mckibben.dataset.raw import Budget, RawColumn, RawTable, needs, readable
from mckibben.dataset.table import question, refusal
from mckibben.storage.mcap import SAMPLES

MCAP, SQLITE = b"\x89MCAP0\r\n", b"SQLite format 3\0"
"""First bytes of a file; of a rosbag2 that is a folder, of its files."""
Message = tuple[str, float, dict[str, float], Mapping[str, str]]
"""Topic, time [s], and numbers and units by field."""


def read_bag(path: Path, data: bytes, part: str, mapping: Mapping[str, str], budget: Budget) -> RawTable:
    """Columns ``topic:field`` of all topics with a number that is understood, at the times of the slowest of them.

    The numbers of faster topics are interpolated. A message is a flat object of JSON, with ``unit`` in its schema, or a
    message of ROS 2 with numbers, named arrays, and a stamp.
    """
    table, topics = RawTable(), dict[str, list[Message]]()
    with readable(path, "MCAP or rosbag2"):
        is_json = data.startswith(MCAP) and b"ros2" not in data[:64]
        for count, message in enumerate(_json_messages(data, path, table) if is_json else _ros_messages(path)):
            budget.spend(rows=count, size=8 * len(message[2]))
            if message[2] and part in ("", message[0]):
                topics.setdefault(message[0], []).append(message)
    columns = {topic: _columns(messages) for topic, messages in topics.items()}
    known = [topic for topic in topics if any(field.header(mapping).quantity for field in columns[topic])] or [*topics]
    if not known:
        raise refusal(path, "has no topic with numbers", "give another file")
    clocks = {topic: np.array([message[1] for message in topics[topic]]) for topic in known}
    first, last = max(clock[0] for clock in clocks.values()), min(clock[-1] for clock in clocks.values())
    slowest = min(clocks.values(), key=len)
    times = slowest[(slowest >= first) & (slowest <= last)]
    table.columns = [RawColumn("time", times - first, unit="s")]
    for topic in known:
        for column in columns[topic]:
            cells = np.interp(times, clocks[topic], np.asarray(column.cells, np.float64))
            table.columns.append(replace(column, cells=cells))
    table.lines = range(1, len(times) + 1)
    return table


def _columns(messages: Sequence[Message]) -> list[RawColumn]:
    """Columns of the messages of a topic, by the fields of the first."""
    topic, _, numbers, units = messages[0]
    cells = {field: np.array([message[2].get(field, np.nan) for message in messages]) for field in numbers}
    labels = {field: topic.rpartition("/")[2] if field == "data" else field for field in numbers}
    return [RawColumn(f"{topic}:{field}", cells[field], labels[field], units.get(field, "")) for field in numbers]


def _json_messages(data: bytes, path: Path, table: RawTable) -> Iterator[Message]:
    """Messages of JSON; a file that was cut, as by a kill, is a question."""
    with needs(path, "mcap", "bags"):
        from mcap.exceptions import McapError
        from mcap.records import Attachment, Channel, Schema
        from mcap.records import Message as McapMessage
        from mcap.stream_reader import CRCValidationError, StreamReader
    schemas, channels, bench = dict[int, dict[str, str]](), dict[int, Any](), dict[str, Any]()
    try:
        for record in StreamReader(io.BytesIO(data), validate_crcs=True).records:
            if isinstance(record, Schema):
                fields = json.loads(record.data or b"{}").get("properties", {})
                schemas[record.id] = {name: str(about.get("unit", "")) for name, about in fields.items()}
            elif isinstance(record, Attachment) and b'"mckibben record"' in record.data[:99]:
                header = json.loads(record.data)["header"]
                bench = header.get("bench", {})
                if not bench:
                    remedy = f"`mckibben rig data {path.parent}` reads its points, with --recording all samples"
                    if "scenario" in header:
                        remedy = f"`mckibben calibrate` reads {path.parent / 'result.nc'}"
                    raise refusal(path, "is a record of a joint, or of an earlier version", remedy)
                table.comments |= {name: str(value) for name, value in bench["origin"].items()}
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, McapMessage):
                channel, content = channels[record.channel_id], json.loads(record.data)
                numbers = {name: float(x) for name, x in content.items() if type(x) in (int, float)}
                units = schemas.get(channel.schema_id, {})
                if bench and channel.topic == SAMPLES:
                    numbers, units = _contracted(numbers, bench), units | {"contraction": "1"}
                if not bench or channel.topic == SAMPLES:
                    yield channel.topic, record.log_time / 1e9, numbers, units
    except (McapError, CRCValidationError, struct.error) as error:
        text = f"is damaged, or was cut: {error or type(error).__name__}; the rest is not read"
        table.questions.append(question(text, "corrupt"))


def _contracted(numbers: dict[str, float], bench: Mapping[str, Any]) -> dict[str, float]:
    """Sample of a rig with the contraction in place of the position of its motor and the number of the plateau."""
    kept = {name: number for name, number in numbers.items() if name not in ("time", "position", "plateau")}
    contraction = bench["mounted_at"] - numbers["position"] / bench["initial_length"]
    return kept | {"contraction": contraction}


def _ros_messages(path: Path) -> Iterator[Message]:
    """Messages of ROS 2, at their stamps where they have one."""
    with needs(path, "rosbags", "bags"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, received, raw in reader.messages():
            message: Any = reader.deserialize(raw, connection.msgtype)
            stamp = getattr(getattr(message, "header", None), "stamp", None)
            time = stamp.sec + stamp.nanosec / 1e9 if stamp and stamp.sec else received / 1e9
            yield connection.topic, time, dict(_numbers("", message)), {}


def _numbers(name: str, message: Any) -> Iterator[tuple[str, float]]:
    """Numbers of a message by their fields, and of arrays by their number from 0."""
    if isinstance(message, int | float):
        yield name, float(message)
    elif isinstance(message, np.ndarray):
        yield from ((f"{name}[{at}]", float(number)) for at, number in enumerate(message.ravel()[:64]))
    for field in getattr(message, "__dataclass_fields__", ()):
        yield from _numbers(f"{name}.{field}".lstrip("."), getattr(message, field)) if field != "header" else ()
