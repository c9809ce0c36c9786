"""A protocol file on a card, from the check to the dataset: stopped, and gone on with from where the motor stood."""

import importlib
import signal

import numpy as np
import pytest

from mckibben import catalog
from mckibben.errors import FileError, SignalledError, StoppedError
from mckibben.muscle import Muscle, forces
from mckibben.rig.document import read_test
from mckibben.rig.record import read_record, segments
from mckibben.rig.running import check, readings, run_test
from mckibben.rig.simulated import SamplesStopped, SimulatedRig
from mckibben.units import bar

pytest.importorskip("nidaqmx", reason="needs the extra daq")
pytest.importorskip("grpc", reason="needs the extra daq")

device = importlib.import_module("device_server")

MUSCLE = Muscle(catalog.specimen("MAS-10-180N-AA-MC-O"), catalog.law("lei-mas-10-180n"))
TEXT = """name: a short test on a card
muscle: {specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n}
rig: {nidaqmx: {card: card.yaml}}
limits: {pressure: 6.5 bar, stretch: 8 mm, shorten: 50 mm, deviation: 20 N}
protocol:
  isobaric: {pressures: [3 bar, 4 bar], contraction_min: 2 %, contraction_max: 4 %, repeats: 1, speed: 4 mm/s,
    dwell: 200 ms, acquisition: 100 ms, samples: 100}
"""


@pytest.fixture
def on_card(tmp_path):
    """A protocol whose card has a muscle of this contraction in its clamps; the twin, and the test read and checked."""
    servers = []

    def make(mounted_at=0.0, **settings):
        twin = SimulatedRig(MUSCLE, seed=len(servers), mounted_at=mounted_at, **settings)
        server, address = device.serve(device.Card(twin))
        servers.append(server)
        (tmp_path / "card.yaml").write_text(device.wired(address, patience=60.0).dumps())
        (tmp_path / "p.yaml").write_text(TEXT)
        return twin, check(*read_test(tmp_path / "p.yaml"))

    yield make
    for server in servers:
        server.stop(None)


def stopping(after, twin):
    """Ctrl-C in the midst of a move, when so many points were taken."""

    def report(progress):
        if progress.points >= after and twin.moving and not sent:
            sent.append(signal.raise_signal(signal.SIGINT))

    sent = []
    return report


@pytest.mark.slow
def test_a_protocol_on_a_card_is_stopped_and_goes_on_from_where_the_motor_stands(on_card, tmp_path):
    twin, checked = on_card()
    shown = list(readings(tmp_path / "p.yaml"))
    assert all(well for _, well in shown), shown
    with pytest.raises(SignalledError, match="the muscle is vented"):
        run_test(checked, tmp_path / "out", report=stopping(5, twin))
    twin.pass_time(1.0)
    assert twin.truth.pressure < 0.2 * bar and not twin.is_open
    left = read_record(tmp_path / "out").events[-1].data["pulses"]
    assert left == pytest.approx(twin.drive.nearest(twin.truth.stretch), abs=9)  # the play of the nut
    assert left % 400 != 0  # in the midst of a step of 1 mm

    again, checked = on_card(mounted_at=twin.truth.contraction)
    data = run_test(checked, tmp_path / "out", resume=True)
    again.pass_time(1.0)
    assert again.truth.pressure < 0.2 * bar
    assert len(data) == 2 * 2 * 4 and len(segments(tmp_path / "out")) == 2
    np.testing.assert_allclose(data.force, forces(MUSCLE, data.contraction, data.pressure), atol=1.5)


def test_where_the_motor_of_a_card_that_fell_silent_stands_is_asked(on_card, tmp_path):
    twin, checked = on_card(faults=[SamplesStopped(5.0)])
    with pytest.raises(StoppedError, match=r"samples did not come in time.*no sensor confirms"):
        run_test(checked, tmp_path / "out")
    twin.pass_time(1.0)
    assert twin.truth.pressure < 0.2 * bar
    _, checked = on_card()
    with pytest.raises(FileError, match="the position of the motor is not known"):
        run_test(checked, tmp_path / "out", resume=True)
