"""Runs and batches through emitted C against XLA's, over plants, controllers, sensors and disturbances."""

import subprocess

import numpy as np
import pytest

import mckibben as mk
from mckibben.codegen.native import compiler
from mckibben.errors import ParameterError
from mckibben.scenario import Scenario
from mckibben.simulation.engine import NATIVE, VECTOR, chunk_size
from mckibben.simulation.software import software

pytestmark = pytest.mark.skipif(compiler() is None, reason="there is no C compiler")
MUSCLE = "{specimen: MAS-10-180N-AA-MC-O, law: lei-mas-10-180n%s}"
FRICTION = ", friction: {half_width: 7.5 N, presliding_length: 0.5 mm}"
MODEL = f"{{geometry: {{from: knee-table-2, connector_length: 208 mm}}, muscle: {MUSCLE % ''}}}"
BASE = """
name: engines
joint: {geometry: {from: knee-table-2, connector_length: 208 mm}, muscle: %s}
load: knee-table-2
valve: %s
controller: %s
reference:
  angle: {class: sine, amplitude: 5 deg, frequency: 2 Hz}
  stiffness: {class: step, before: 14 N*m/rad, after: 15 N*m/rad, at: 100 ms}
duration: 300 ms
control_period: 1 ms
substeps: 2
"""
PID = f"""
  model: {MODEL}
  position: {{kp: 1.165 bar/rad, ki: 120 bar/(rad*s), kd: 1.567 bar*s/rad, derivative_on_error: true}}
  stiffness: {{kp: 0.3 bar/(N*m/rad), ki: 11 bar/(N*m*s/rad), kd: 0 bar*s/(N*m/rad)}}
"""
OBSERVERS = "observer: {bandwidth: 200 rad/s}"
DECOUPLING = f"{{model: {MODEL}, class: decoupling, feedback: {{bandwidth: 60 rad/s}}, {OBSERVERS}}}"
REAL = """
sensors: {encoder: 0.022 deg, pressure_noise: 4 kPa, delay: 1}
disturbance: {height: 0.5 N*m, width: 20 ms, interval: 50 ms, start: 40 ms}
"""
WARM = "{class: regulator, conductance: 0.1 L/(s*bar), supply: 7 bar, time_constant: 20 ms, wall_conductance: 0.5 W/K}"
PAIR = f"""
  class: unequal
  muscle1: {{class: tube, volume: 5 cm^3, conductance: 0.1 L/(s*bar), valve: {WARM}}}
  muscle2: {WARM}
  reservoir_volume: 0.5 L
  line_conductance: 1 L/(s*bar)"""
SCENARIOS = {
    "as in the paper": BASE % (MUSCLE % "", "ideal", PID),
    "friction, noise and pulses": BASE % (MUSCLE % FRICTION, "{time_constant: 20 ms}", DECOUPLING) + REAL,
    "air with a temperature": (BASE % (MUSCLE % "", PAIR, PID)).replace("substeps: 2", "substeps: 8"),
}


@pytest.fixture(params=SCENARIOS, scope="module")
def scenario(request):
    """The scenarios one by one, that of the paper compiled as users do."""
    with pytest.MonkeyPatch.context() as patch:
        if request.param == "as in the paper":
            patch.setenv("MCKIBBEN_CFLAGS", "")
        yield Scenario.parse(SCENARIOS[request.param])


def timing(scenario):
    return {"duration": scenario.duration, "control_period": scenario.control_period, "substeps": scenario.substeps}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["as in the paper"], indirect=True)  # others in batches
def test_both_engines_have_the_same_runs(scenario):
    plant = scenario.plant()
    parts = plant, scenario.control(), scenario.reference()
    runs = {
        e: mk.simulate(*parts, initial=scenario.initial(plant), engine=e, **timing(scenario)) for e in ("native", "xla")
    }
    assert [run.engine for run in runs.values()] == ["native", "xla"]
    noisy = scenario.sensors is not None
    for name in ("angle", "pressure1", "stiffness", "stiffness_estimate", "command2"):
        expected = runs["xla"][name]
        tolerance = (1e-6 if noisy else 1e-10) * np.abs(expected).max()  # noise is of 32 bits
        np.testing.assert_allclose(runs["native"][name], expected, rtol=0, atol=tolerance)


OVER = {
    "load.mass2": np.linspace(0.4, 0.6, 11),
    "reference.angle.amplitude": np.linspace(0.02, 0.1, 11),
    "controller.model.muscle1.law.a1": np.linspace(-250.0, -240.0, 11),
}


def batch(scenario, **options):
    plant = scenario.plant()
    return mk.simulate_many(
        plant, scenario.control(), scenario.reference(), over=OVER, keep=["angle", "command1"], chunk=8,
        initial=scenario.initial(plant), **timing(scenario), **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def in_64_bits(scenario):
    return batch(scenario, engine="native")


@pytest.mark.slow
def test_both_engines_have_the_same_batches(scenario, in_64_bits):
    batches = {"native": in_64_bits, "xla": batch(scenario, engine="xla")}
    assert [batch.table.attrs["engine"] for batch in batches.values()] == ["native", "xla"]
    np.testing.assert_allclose(batches["native"]["angle"], batches["xla"]["angle"], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(batches["native"]["outcome"], batches["xla"]["outcome"])
    noisy = scenario.sensors is not None
    for name, expected in batches["xla"].metrics.items():
        scale = np.nanmax(np.abs(expected), initial=1e-9)
        tolerance = (1e-5 if noisy else 1e-9) * scale
        np.testing.assert_allclose(batches["native"][name], expected, rtol=0, atol=tolerance, err_msg=name)


@pytest.mark.slow
def test_batches_in_32_bits_are_near_those_in_64(scenario, in_64_bits):
    near, right = batch(scenario, engine="native", precision=32), in_64_bits
    assert [batch.table.attrs["engine"] for batch in (near, right)] == ["native", "native"]
    assert near["angle"].dtype == np.float32
    for name, tolerance in (("angle", 5e-6), ("command1", 4e-4 * 8e5)):
        errors = np.abs(near[name] - right[name]).max(axis=1)
        assert np.median(errors) < tolerance
        assert (
            errors.max() < (100 if scenario.sensors else 1) * tolerance
        )  # where a step of the encoder falls differently
    np.testing.assert_array_equal(near["outcome"], right["outcome"])


@pytest.mark.slow
def test_cuda_has_the_same_batches(scenario, in_64_bits, cuda_device, nvrtc):
    found, near = batch(scenario, engine="cuda"), batch(scenario, engine="cuda", precision=32)
    assert [one.table.attrs["engine"] for one in (found, near)] == ["cuda", "cuda"]
    noisy = scenario.sensors is not None  # noise is of 32 bits
    np.testing.assert_allclose(found["angle"], in_64_bits["angle"], rtol=0, atol=1e-6 if noisy else 1e-9)
    np.testing.assert_array_equal(found["outcome"], in_64_bits["outcome"])
    for name, expected in in_64_bits.metrics.items():
        scale = np.nanmax(np.abs(expected), initial=1e-9)
        tolerance = (1e-5 if noisy else 1e-9) * scale
        np.testing.assert_allclose(found[name], expected, rtol=0, atol=tolerance, err_msg=name)
    assert near["angle"].dtype == np.float32
    assert np.median(np.abs(near["angle"] - in_64_bits["angle"]).max(axis=1)) < 5e-6
    if cuda_device is not None:
        assert len(cuda_device.sources) == 2
        source = cuda_device.sources[scenario.sensors is None]  # of 64 bits, or of 32
        assert nvrtc.compile(source, 90).startswith(b"\x7fELF")


@pytest.mark.slow
def test_the_software_of_batches_is_the_compiler_of_their_engine():
    """Programs of other compilers or with other options may round differently."""
    emitted, by_xla = software("native"), software("xla")
    assert (emitted["engine"], by_xla["engine"]) == ("native", "xla")
    path = compiler()
    assert path is not None
    first = subprocess.run([path, "--version"], capture_output=True, text=True, check=True).stdout.splitlines()[0]
    assert emitted.pop("compiler").startswith(first)
    assert emitted | {"engine": "xla"} == by_xla


@pytest.mark.parametrize("engine", ["", "c", None, "cuda"])
def test_one_run_has_two_engines(engine):
    scenario = Scenario.parse(SCENARIOS["as in the paper"])
    with pytest.raises(ParameterError) as caught:
        mk.simulate(scenario.plant(), scenario.control(), scenario.reference(), engine=engine, **timing(scenario))
    assert (caught.value.field, caught.value.value) == ("engine", engine)


@pytest.mark.parametrize(
    ("count", "workers", "chunk", "size"),
    [
        (100, 1, None, 112),  # whole vectors
        (100, 2, None, 64),
        (96, 2, None, 48),
        (3, 2, None, VECTOR),
        (100_000, 2, None, NATIVE),
        (100, 2, 10, 10),
        (100, 2, 100, 64),  # no core is idle
    ],
)
def test_a_chunk_has_whole_vectors_and_leaves_no_core_idle(count, workers, chunk, size):
    assert chunk_size(chunk, count, workers, "native") == size
