"""A test in a folder: begun, gone on with, kept to itself, and in the end a dataset."""

import dataclasses
import errno
import fcntl
import re
import signal
import struct
from pathlib import Path

import numpy as np
import pytest

from mckibben.dataset import read_dataset, read_recording
from mckibben.errors import (
    DatasetError,
    FileError,
    McKibbenWarning,
    RigError,
    ScenarioError,
    SignalledError,
    StoppedError,
)
from mckibben.identification import identify_pressure_creep
from mckibben.rig import running
from mckibben.rig.document import RigTest, read_test
from mckibben.rig.record import Recorder, header_of, read_record, segments
from mckibben.rig.running import check, gather, gather_recording, run_test
from mckibben.storage.mcap import Column

TEXT = """name: a short test
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {simulated: {seed: 1, friction: {half_width: 12 N, presliding_length: 0.5 mm}}}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm}
protocol:
  isobaric: {pressures: [3 bar, 4 bar], contraction_min: 2 %, contraction_max: 6 %, repeats: 1, speed: 4 mm/s,
    dwell: 200 ms, acquisition: 100 ms, samples: 100}
"""


def checked(text=TEXT, session=0):
    return check(RigTest.parse(text), session=session)


def stopping(after, number=signal.SIGINT):
    """A callback that raises a signal in this thread when so many points were taken."""
    sent = []

    def report(progress):
        if progress.points >= after and not sent:
            sent.append(signal.raise_signal(number))

    return report


def test_a_folder_has_the_protocol_the_record_and_the_dataset(tmp_path):
    data = run_test(checked(), tmp_path / "out")
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert names == {"protocol.yaml", "record-0001.mcap", "isobaric.nc"}
    kept = read_dataset(tmp_path / "out" / "isobaric.nc")
    assert kept.table.identical(data.table)
    assert len(data) == 2 * 2 * 8
    assert RigTest.read(tmp_path / "out" / "protocol.yaml") == RigTest.parse(TEXT)
    header, _ = header_of(tmp_path / "out")
    assert RigTest.parse(header["protocol"]) == RigTest.parse(TEXT)
    assert {"rig", "versions", "date", "steps", "clock"} <= {*header}


def test_the_record_itself_is_read_as_a_recording(tmp_path):
    run_test(checked(), tmp_path)
    read, known = read_recording(tmp_path / "record-0001.mcap"), gather_recording(tmp_path)
    for name in ("specimen", "initial_length", "slack_force"):
        assert read.table.attrs[name] == known.table.attrs[name]
    for name in ("time", "pressure", "force", "contraction"):
        np.testing.assert_allclose(getattr(read, name), getattr(known, name), rtol=1e-6, atol=1e-6)
    with Recorder(tmp_path / "joint", {"scenario": "knee"}, [Column("time", "s"), Column("angle", "rad")]) as recorder:
        recorder.append([[0.0, 0.1]])
    with pytest.raises(DatasetError) as refused:
        read_recording(tmp_path / "joint" / "record-0001.mcap")
    assert "result.nc" in refused.value.problems[0].remedy


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.slow
def test_a_signal_stops_it_vented_and_it_goes_on(tmp_path, number):
    handlers = signal.getsignal(number)
    if number != signal.SIGINT:
        signal.signal(number, lambda *_: None)
    with pytest.raises(SignalledError, match="the muscle is vented") as stopped:
        run_test(checked(), tmp_path, report=stopping(20, number))
    assert stopped.value.signal == number
    signal.signal(number, handlers)
    assert not (tmp_path / "isobaric.nc").exists()
    assert read_record(tmp_path).events[-1].kind == "vented"
    begun = gather(tmp_path)
    assert len(begun) == 20
    (tmp_path / "isobaric.nc").unlink()
    data = run_test(checked(session=1), tmp_path, resume=True)
    assert len(data) == 32 and len(segments(tmp_path)) == 2
    np.testing.assert_array_equal(data.force[:16], begun.force[:16])  # the block of the other pressure begins anew
    assert (data.force[16:20] != begun.force[16:]).any()
    again = run_test(checked(session=2), tmp_path, resume=True)  # all is done: the dataset is made anew
    assert again.table.identical(data.table) and len(segments(tmp_path)) == 2


def test_it_overwrites_nothing_and_goes_on_with_nothing_else(tmp_path):
    with pytest.raises(FileError, match="no test to resume"):
        run_test(checked(), tmp_path, resume=True)
    run_test(checked(), tmp_path)
    with pytest.raises(FileError, match=r"contains a record; resume it \(--resume\)"):
        run_test(checked(), tmp_path)
    with pytest.raises(ScenarioError, match="another test; resume it with its own"):
        run_test(checked(TEXT.replace("repeats: 1", "repeats: 2")), tmp_path, resume=True)


def test_a_damaged_test_that_is_not_finished_goes_on_at_its_first_lost_point(tmp_path, monkeypatch):
    monkeypatch.setattr("mckibben.rig.record.PERIOD", 5e-3)  # s: many chunks
    with pytest.raises(SignalledError):
        run_test(checked(), tmp_path, report=stopping(11))
    (path,) = segments(tmp_path)
    content = path.read_bytes()
    chunks = [match.start() for match in re.finditer(rb"\x04\0\0\0zstd", content)]
    place = chunks[len(chunks) // 4] + 40  # of the first half of the test; indexes follow the chunks
    path.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
    with pytest.warns(McKibbenWarning, match="is damaged"):
        data = run_test(checked(session=1), tmp_path, resume=True)
    assert len(data) == 32


def test_a_rig_that_is_not_there_leaves_nothing_behind(tmp_path, monkeypatch):
    def missing(_):
        raise RigError("no device Dev1", remedy="connect it")

    monkeypatch.setattr("mckibben.rig.simulated.SimulatedRig.open", missing)
    with pytest.raises(RigError, match="no device Dev1; connect it") as refused:
        run_test(checked(), tmp_path)
    assert not isinstance(refused.value, StoppedError)
    assert not list(tmp_path.iterdir())


def test_a_dataset_for_which_there_is_no_room_is_told_with_what_to_do(tmp_path, monkeypatch):
    def full(_, path):
        raise OSError(errno.ENOSPC, "nc_close: a long story")

    monkeypatch.setattr("mckibben.dataset.IsobaricDataset.to_netcdf", full)
    with pytest.raises(
        FileError, match=r"No space left on device; the record is complete: free some space, then mckibben rig data"
    ):
        run_test(checked(), tmp_path)
    monkeypatch.undo()
    assert len(gather(tmp_path)) == 32


def test_where_a_real_motor_stands_is_asked_after_a_kill(tmp_path, monkeypatch):
    with pytest.raises(SignalledError):
        run_test(checked(), tmp_path, report=stopping(5))
    past = running._past(tmp_path)
    assert past.certain and not past.done  # it begins anew at its only vent
    assert past.position == read_record(tmp_path).columns["position"][-1] < 0
    (path,) = segments(tmp_path)
    content = path.read_bytes()
    last = content.rindex(struct.pack("<BQI", 0x0F, 4, 0))  # the end of the data
    path.write_bytes(content[: last - 20])
    killed = running._past(tmp_path)
    assert not killed.certain
    simulated = checked()
    assert running._origin(simulated, tmp_path, killed, None) == 0
    card = checked()
    monkeypatch.setattr(card.backend, "homed", False)
    assert running._origin(card, tmp_path, past, None) == past.position
    assert running._origin(card, tmp_path, killed, 0.05) == pytest.approx(-0.05 * 0.18)
    with pytest.raises(FileError, match=r"the position of the motor is not known .*--standing-at '5 %'"):
        running._origin(card, tmp_path, killed, None)


@pytest.mark.slow
def test_creep_after_steps_of_the_pressure_is_identified_from_the_record(tmp_path):
    """The example's test, with friction, creep after moves and a stretcher that yields."""
    example = Path(__file__).parents[2] / "examples" / "rig" / "isometric-creep.yaml"
    run_test(check(*read_test(example)), tmp_path)
    recording = gather_recording(tmp_path)
    record = read_record(tmp_path)
    np.testing.assert_array_equal(recording.time, record.columns["time"])
    found = identify_pressure_creep(recording)
    assert found.is_significant and not found.notes
    assert found.share_interval[0] < 0.06 < found.share_interval[1]
    assert found.time_constant_interval[0] < 3.0 < found.time_constant_interval[1]


def test_another_law_than_the_recorded_steps_came_from_is_refused(tmp_path, monkeypatch):
    with pytest.raises(SignalledError):
        run_test(checked(), tmp_path, report=stopping(3))
    other = dataclasses.replace(checked(), steps=checked().steps[1:])
    with pytest.raises(ScenarioError) as refused:
        run_test(other, tmp_path, resume=True)
    assert refused.value.problems[0].field == "steps"


def test_a_folder_in_use_is_left_alone(tmp_path):
    with (tmp_path / "lock").open("w") as held:
        fcntl.flock(held, fcntl.LOCK_EX)
        with pytest.raises(FileError, match="is running a test here"):
            run_test(checked(), tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"lock"}


def test_the_folder_of_a_joint_is_named_with_what_reads_it(tmp_path):
    with Recorder(tmp_path, {"what": "joint rig"}, running.columns_of(())):
        pass
    for read in (gather, gather_recording, lambda folder: run_test(checked(), folder, resume=True)):
        with pytest.raises(FileError) as refused:
            read(tmp_path)
        assert "result.nc" in refused.value.problems[0].remedy
