"""Recordings in MCAP and rosbag2 files."""

import io
import json
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as BagWriter
from rosbags.typesys import Stores, get_typestore

from mckibben.dataset import read_recording
from mckibben.errors import DatasetError
from mckibben.rig.record import Recorder
from mckibben.storage.mcap import Column

from .conftest import problems_of

START, TIME = 1_700_000_000_000_000_000, np.arange(0, 2, 0.01)  # ns, s
PRESSURE, FORCE, LENGTH = 3e5 + 1e4 * TIME, 200 - 30 * TIME, 0.2 - 0.01 * TIME
UNITS = {"pressure": "Pa", "force": "N", "length": "m"}


def mcap(topics: dict[str, tuple[np.ndarray, dict[str, np.ndarray]]]) -> bytes:
    """File of topics with times and flat messages of JSON."""
    stream = io.BytesIO()
    writer = Writer(stream, chunk_size=2000)
    writer.start(profile="", library="rig")
    for topic, (times, columns) in topics.items():
        numbers = {name: {"type": "number", "unit": UNITS[name]} for name in columns}
        schema = writer.register_schema(topic, "jsonschema", json.dumps({"properties": numbers}).encode())
        channel = writer.register_channel(topic, "json", schema)
        for at, time in enumerate(times):
            stamp = START + round(1e9 * time)
            content = {name: float(values[at]) for name, values in columns.items()} | {"mark": "ok"}
            writer.add_message(channel, stamp, json.dumps(content).encode(), stamp)
    writer.finish()
    return stream.getvalue()


WHOLE = mcap({"/bench": (TIME, {"pressure": PRESSURE, "force": FORCE, "length": LENGTH})})


def test_channels_of_a_flat_message_are_columns_with_their_units(put):
    recording = read_recording(put(WHOLE, "rig.mcap"), initial_length=0.2)
    assert recording.time == pytest.approx(TIME, abs=1e-6)
    assert recording.pressure == pytest.approx(PRESSURE)
    assert recording.contraction == pytest.approx(0.05 * TIME)


def test_topics_of_several_rates_are_read_at_the_times_of_the_slowest(put):
    slow = TIME[3:-3:10]
    topics = {
        "/press": (TIME, {"pressure": PRESSURE}),
        "/arm": (slow, {"force": FORCE[3:-3:10], "length": LENGTH[3:-3:10]}),
    }
    recording = read_recording(put(mcap(topics), "rig.mcap"), initial_length=0.2)
    assert recording.time == pytest.approx(slow - slow[0], abs=1e-6)
    assert recording.pressure == pytest.approx(np.interp(slow, TIME, PRESSURE))


def test_a_file_that_was_cut_is_read_up_to_there_on_demand(put):
    path = put(WHOLE[: len(WHOLE) // 2], "rig.mcap")
    assert any("was cut" in problem for problem in problems_of(path, read_recording, initial_length=0.2))
    recording = read_recording(path, initial_length=0.2, accept=["corrupt"])
    assert 0 < len(recording) < len(TIME)
    assert recording.pressure == pytest.approx(PRESSURE[: len(recording)])


@pytest.mark.parametrize("plugin", [StoragePlugin.MCAP, StoragePlugin.SQLITE3])
def test_a_bag_of_ros_2_is_read_by_topics_and_stamps(plugin, tmp_path):
    store = get_typestore(Stores.ROS2_JAZZY)
    number, state = store.types["std_msgs/msg/Float64"], store.types["sensor_msgs/msg/JointState"]
    header, stamp = store.types["std_msgs/msg/Header"], store.types["builtin_interfaces/msg/Time"]
    with BagWriter(tmp_path / "bag", version=9, storage_plugin=plugin) as writer:
        press = writer.add_connection("/pressure_bar", number.__msgtype__, typestore=store)
        arm = writer.add_connection("/arm", state.__msgtype__, typestore=store)
        for time, p, f, x in zip(TIME, PRESSURE, FORCE, LENGTH, strict=True):
            at = START + round(1e9 * time)
            writer.write(press, at, store.serialize_cdr(number(p / 1e5), number.__msgtype__))
            front = header(stamp(at // 10**9, at % 10**9), "")
            message = state(front, ["a"], np.array([x]), np.array([]), np.array([f]))
            writer.write(arm, at + 5_000_000, store.serialize_cdr(message, state.__msgtype__))  # received later
    names = {"/arm:position[0]": "length_m", "/arm:effort[0]": "force_N"}
    recording = read_recording(tmp_path / "bag", columns=names, initial_length=0.2)
    assert recording.time == pytest.approx(TIME, abs=1e-6)
    assert recording.pressure == pytest.approx(PRESSURE)
    assert recording.force == pytest.approx(FORCE)
    file = next(path for path in Path(tmp_path, "bag").iterdir() if path.suffix in (".mcap", ".db3"))
    assert len(read_recording(file, columns=names, initial_length=0.2)) == len(TIME)


def test_a_record_of_the_rig_is_named_with_its_command(tmp_path):
    with Recorder(tmp_path, {"specimen": "ours"}, [Column("time", "s"), Column("position", "m")]) as recorder:
        recorder.append([[0.0, 0.0], [0.1, 0.0]])
    with pytest.raises(DatasetError) as caught:
        read_recording(recorder.path)
    assert f"mckibben rig data {tmp_path}" in caught.value.problems[0].remedy
