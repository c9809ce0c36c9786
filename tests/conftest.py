"""What the tests share: the paper's knee in both geometries, and the paper's equations in plain NumPy."""

from __future__ import annotations

import ctypes
import gc
import importlib.util
import itertools
import os
import shutil
import signal
import sys
from pathlib import Path

import equinox as eqx
import hypothesis
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray as xr

from mckibben import catalog
from mckibben.actuator import FirstOrderValve, IdealValve
from mckibben.codegen import cuda
from mckibben.component import extensions
from mckibben.control import Controller
from mckibben.errors import DeviceError, SimulationError
from mckibben.joint import AntagonisticJoint
from mckibben.numerics.compiled import numeric
from mckibben.paper.claims import evaluate_claims
from mckibben.paper.identification import run_identification, run_joint
from mckibben.paper.reproduction import Reproduction, run_leg
from mckibben.paper.tracking import run_tracking
from mckibben.plant import JointPlant
from mckibben.simulation import Batch, Metrics, Outcome, batch
from mckibben.simulation.engine import run_alone
from mckibben.simulation.outcome import OUTCOMES
from mckibben.study.compare.changes import Changed

FILES = itertools.count(1)  # with tests, of this process
gc.set_threshold(100_000, 10, 10)  # as the command does: looking for garbage took a fifth of the time of tracing

if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # run in the background: what the tests start would ignore Ctrl-C
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Half of the time of the tests is compilation, of programs that run for a moment: here, and in subprocesses, they are
# compiled with hardly any optimization, with the same numbers but for rounding. Files with `optimized`, and all with
# MCKIBBEN_FULL_COMPILATION set, compile as users do. Older versions of JAX abort at flags unknown to them.
QUICK = "MCKIBBEN_FULL_COMPILATION" not in os.environ
if QUICK and jax.__version_info__ >= (0, 10):
    passes = "while-loop-invariant-code-motion,tuple-simplifier"  # they take a third of the time to compile
    flags = f"--xla_disable_hlo_passes={passes}"
    if jax.__version_info__ < (0, 11):  # an older code generator, and no scheduler, which newer versions may not know
        flags += " --xla_cpu_use_fusion_emitters=false --xla_cpu_enable_concurrency_optimized_scheduler=false"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"


def optimize(programs: bool) -> None:
    os.environ["MCKIBBEN_CFLAGS"] = "" if programs else "-O0"
    os.environ["JAX_DISABLE_MOST_OPTIMIZATIONS"] = "0" if programs else "1"
    jax.config.update("jax_disable_most_optimizations", not programs)


optimize(not QUICK)

# Workers, subprocesses and later runs share compiled programs, ours and those of XLA; `make clean` removes them.
for option, value in (
    ("jax_compilation_cache_dir", str(Path(__file__).parents[1] / "build" / "jax-cache")),
    ("jax_persistent_cache_min_compile_time_secs", 0.1),  # to store one takes as long as to compile a smaller one
):
    if option.upper() not in os.environ:
        os.environ[option.upper()] = str(value)
        jax.config.update(option, value)
os.environ["MCKIBBEN_PROGRAMS_DIR"] = str(Path(os.environ["JAX_COMPILATION_CACHE_DIR"], "native").absolute())

hypothesis.settings.register_profile("quick", max_examples=40, deadline=None)
hypothesis.settings.load_profile("quick")


def pytest_unconfigure() -> None:
    gc.freeze()  # nor is there anything to look for at the exit


@pytest.fixture(autouse=True, scope="module")
def without_old_objects_in_collections():
    """What collects garbage, as a run on a rig does, does not go through the programs of earlier files.

    The caches of JAX would keep them all: 9 GB for each worker at half of the tests. Without them, a file traces anew.
    """
    if next(FILES) % 25 == 0:
        gc.unfreeze()
        jax.clear_caches()
        gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def own_extensions(monkeypatch):
    """Workers load the extensions of a test, not those of earlier ones."""
    monkeypatch.setattr(extensions, "_loaded", {})


@pytest.fixture(scope="module")
def optimized():
    """For files whose programs run for long, or are compared bit for bit."""
    optimize(True)
    yield
    optimize(not QUICK)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file for a worker, but all of the paper and of its report, whose files share a reproduction, for one."""
    from xdist.scheduler import LoadFileScheduling

    shared = "tests/paper/", "tests/report/test_figures.py", "tests/report/test_html.py"

    class Scheduling(LoadFileScheduling):
        def _split_scope(self, nodeid: str) -> str:
            return "tests/paper" if nodeid.startswith(shared) else super()._split_scope(nodeid)

    return Scheduling(config, log)


class PaperKnee:
    """Eqs. 3 to 8 and Table 2 as printed, written anew: bar, percent, plain NumPy; nothing of mckibben in it."""

    H, r, l0 = 0.37, 0.03, 0.18
    inertia = 0.02 + 0.5 * 0.1**2 + 0.5 * 0.2**2
    G = (0.5 * 0.1 + 0.5 * 0.2) * 9.81
    damping = 0.015

    def __init__(self, connectors: float) -> None:
        self.connectors = connectors

    @staticmethod
    def eq3(contraction, pressure, xp=np):
        """Force [N] from contraction [-] and pressure [Pa]."""
        p, eps = pressure / 1e5, contraction * 100
        return (-245.8 + 109 * p) + (3.216 - 3.442 * p) * eps + (255.6 - 13.18 * p) * xp.exp(-0.3 * eps)

    @staticmethod
    def eq3_slope(contraction, pressure):
        """Force per contraction [N], by hand."""
        p, eps = pressure / 1e5, contraction * 100
        return 100 * ((3.216 - 3.442 * p) - 0.3 * (255.6 - 13.18 * p) * np.exp(-0.3 * eps))

    def spans(self, angle, xp=np):
        """From anchor to anchor [m]: the square roots of Eq. 4."""
        across = (self.r - self.r * xp.cos(angle)) ** 2
        return (
            xp.sqrt((self.H + self.r * xp.sin(angle)) ** 2 + across),
            xp.sqrt((self.H - self.r * xp.sin(angle)) ** 2 + across),
        )

    def contractions(self, angle, xp=np):
        """Eq. 4, of both muscles."""
        return tuple((self.l0 - (span - self.connectors)) / self.l0 for span in self.spans(angle, xp))

    def eq5(self, angle, xp=np):
        """Moment arms [m]."""
        span1, span2 = self.spans(angle, xp)
        return (
            self.r * (self.H * xp.cos(angle) + self.r * xp.sin(angle)) / span1,
            self.r * (self.H * xp.cos(angle) - self.r * xp.sin(angle)) / span2,
        )

    def torque(self, angle, pressures, xp=np):
        """Eq. 7 without gravity, slack muscles at zero."""
        eps1, eps2 = self.contractions(angle, xp)
        d1, d2 = self.eq5(angle, xp)
        force1 = xp.maximum(self.eq3(eps1, pressures[0], xp), 0.0)
        force2 = xp.maximum(self.eq3(eps2, pressures[1], xp), 0.0)
        return force2 * d2 - force1 * d1

    def stiffness(self, angle, pressures):
        """Minus Eq. 8, by the product rule, for taut muscles."""
        eps1, eps2 = self.contractions(angle)
        (d1, d2), (span1, span2) = self.eq5(angle), self.spans(angle)
        turn1 = self.r * (-self.H * np.sin(angle) + self.r * np.cos(angle)) / span1 - d1**2 / span1
        turn2 = self.r * (-self.H * np.sin(angle) - self.r * np.cos(angle)) / span2 + d2**2 / span2
        slope1 = self.eq3_slope(eps1, pressures[0]) * (-d1 / self.l0)
        slope2 = self.eq3_slope(eps2, pressures[1]) * (d2 / self.l0)
        force1, force2 = self.eq3(eps1, pressures[0]), self.eq3(eps2, pressures[1])
        return -(slope2 * d2 + force2 * turn2 - slope1 * d1 - force1 * turn1)

    def attainable(self, angle):
        """Range of the stiffness at an angle, by trying very many pressures, 0..6 bar, both taut, -3..25 %."""
        eps = self.contractions(angle)
        if not all(-0.03 <= e <= 0.25 for e in eps):
            return np.nan, np.nan
        arm1, arm2 = self.eq5(angle)
        p1 = np.linspace(0, 6e5, 60_001)
        force1 = self.eq3(eps[0], p1)
        force2 = (-self.G * np.sin(np.pi / 6 - angle) + force1 * arm1) / arm2
        at0, at1 = self.eq3(eps[1], 0.0), self.eq3(eps[1], 1e5)
        p2 = (force2 - at0) / (at1 - at0) * 1e5
        held = (force1 >= 0) & (force2 >= 0) & (p2 >= 0) & (p2 <= 6e5)
        stiffness = self.stiffness(angle, (p1[held], p2[held]))
        return (float(stiffness.min()), float(stiffness.max())) if held.any() else (np.nan, np.nan)

    def acceleration(self, angle, velocity, pressures, xp=np):
        """Eq. 6, pi/6 being the stable hanging position."""
        torque = self.torque(angle, pressures, xp) + self.G * xp.sin(np.pi / 6 - angle)
        return (torque - self.damping * velocity) / self.inertia


class Playback(Controller):
    """Takes the two halves of the setpoint for its commands [Pa]: an open loop."""

    def init(self, measurement):
        return jnp.asarray(0)

    def step(self, state, setpoint, measurement, period):
        return state, (setpoint[0], setpoint[1])

    def telemetry(self, state):
        return {"stiffness_estimate": jnp.asarray(0.0)}


def with_connectors(joint: AntagonisticJoint, length: float) -> AntagonisticJoint:
    return eqx.tree_at(lambda j: j.geometry.connector_length, joint, length)


@pytest.fixture(scope="session")
def law():
    """Eq. 3."""
    return catalog.law("lei-mas-10-180n")


@pytest.fixture(scope="session")
def specimen():
    return catalog.specimen("MAS-10-180N-AA-MC-O")


@pytest.fixture(scope="session")
def as_printed():
    """The knee of Table 2 taken literally: no contraction at 0 deg."""
    return catalog.joint("knee-table-2")


@pytest.fixture(scope="session")
def knee(as_printed):
    """The knee with 0.208 m of connectors: 10 % contraction at 0 deg."""
    return with_connectors(as_printed, 0.208)


@pytest.fixture(scope="session")
def load():
    return catalog.load("knee-table-2")


@pytest.fixture(scope="session")
def plant(knee, load):
    """Pre-contracted knee, 20 ms valves, all numbers as arrays."""
    return numeric(JointPlant(knee, load, FirstOrderValve(time_constant=0.02)))


@pytest.fixture(scope="session")
def ideal_plant(knee, load):
    return numeric(JointPlant(knee, load, IdealValve()))


@pytest.fixture(scope="session")
def paper():
    """The knee as printed, in plain NumPy."""
    return PaperKnee(0.19)


@pytest.fixture(scope="session")
def paper_precontracted():
    return PaperKnee(0.208)


@pytest.fixture(scope="session")
def playback():
    return Playback()


@pytest.fixture(scope="session")
def short_episode():
    """`episode` by the engine of `simulate`, in C compiled in a fraction of XLA's time; give it `numeric` arguments."""

    def short_episode(*parts):
        return run_alone("auto", parts)[0]

    return short_episode


class CudaOnProcessor:
    """A CUDA device that is this processor; numbers of its driver are attributes."""

    def __init__(self, folder: Path) -> None:
        spec = importlib.util.spec_from_file_location("processor", Path(__file__).parent / "cuda" / "processor.py")
        assert spec is not None and spec.loader is not None
        self.module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(self.module)
        self.driver, self.compiler = self.module.driver(folder), self.module.Compiler(folder)

    def get(self, name: str) -> int:
        return ctypes.c_int64.in_dll(self.driver, name).value

    def set(self, **values: int | str) -> None:
        """Change how the driver answers, such as the `status` of the function that is `failing`."""
        for name, value in values.items():
            if isinstance(value, str):
                (ctypes.c_char * 64).in_dll(self.driver, name).value = value.encode()
            else:
                ctypes.c_int.in_dll(self.driver, name).value = value


@pytest.fixture(scope="session")
def nvrtc():
    """The compiler of CUDA, which needs no GPU."""
    try:
        return cuda.nvrtc()
    except DeviceError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def cuda_driver(tmp_path_factory):
    if not (shutil.which("c++") and sys.platform == "linux"):
        pytest.skip("there is no C++ compiler")
    return CudaOnProcessor(tmp_path_factory.mktemp("cuda"))


@pytest.fixture
def cuda_here(cuda_driver, monkeypatch):
    """The engine "cuda" on this processor."""
    monkeypatch.setattr(cuda, "nvrtc", lambda: cuda_driver.compiler)
    monkeypatch.setattr(cuda, "driver_library", lambda: cuda_driver.driver)
    cuda.device.cache_clear()
    cuda_driver.compiler.sources.clear()
    cuda_driver.set(version=12080, devices=1, capability=90, failing="", status=0)
    yield cuda_driver
    cuda.device.cache_clear()


@pytest.fixture(params=["processor", "GPU"])
def cuda_device(request, monkeypatch):
    """The engine "cuda" on this processor, which compiles anew, and on a GPU where there is one; its compiler."""
    monkeypatch.setenv("MCKIBBEN_PROGRAMS_DIR", "")
    for one in (batch._run, batch._positions):
        monkeypatch.setattr(one._cuda, "_programs", {})
    if request.param == "processor":
        return request.getfixturevalue("cuda_here").compiler
    try:
        cuda.device()
    except DeviceError as error:
        pytest.skip(str(error))
    return None


def invented(suite, runs, controller, sets=1, metrics=Metrics._fields, engine="native"):
    """What stands for the simulation of a comparison: metrics that are simple functions of gains and conditions.

    The angle's error [rad] is (1 + decades of kp from 3 bar/rad) (mass2 / 0.5 kg) deg, of a controller without kp half
    of it. Runs with a valve slower than 48 ms cannot begin; those with pulses are lost where kp is above 8 bar/rad.
    """
    count, plant = runs.count * sets, runs.parts.plant
    position = getattr(controller, "position", None)
    kp = np.broadcast_to(3e5 if position is None else position.kp, count)
    mass, lag, pulse = (
        np.tile(np.broadcast_to(leaf, runs.count), sets)
        for leaf in (plant.load.mass2, plant.valve.time_constant, plant.disturbance.height)
    )
    error = (1.0 if position is not None else 0.5) * (1 + abs(np.log10(kp / 3e5))) * mass / 0.5
    known = {
        "angle_rmse": np.deg2rad(error),
        "stiffness_rmse": lag / 0.02,
        "coupling": np.deg2rad(error) / 10,
        "stiffness_settling": np.where(mass < 0.6, 0.05, np.nan),
        "air": kp / 3e5 * 1e-4,
    }
    lost, begins = (pulse > 0) & (kp > 8e5), lag <= 0.048
    codes = np.where(begins, np.where(lost, OUTCOMES.index(Outcome.SWUNG_OVER), 0), OUTCOMES.index(Outcome.NO_START))
    flags = {"flag_values": np.arange(len(OUTCOMES)), "flag_meanings": " ".join(each.name for each in OUTCOMES)}
    table = {name: ("run", np.where(begins, known.get(name, error), np.nan)) for name in metrics}
    return Batch(xr.Dataset({**table, "outcome": ("run", codes, flags)}, attrs={"engine": engine}))


def without_margins(_):
    raise SimulationError("nothing is simulated")


@pytest.fixture(scope="class")
def simulating_nothing():
    """Comparisons go through `invented` in place of a simulation."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mckibben.study.compare.runs.simulate_group", invented)
        patch.setattr("mckibben.scenario.Scenario.margins", without_margins)
        comparison = importlib.import_module("mckibben.study.compare.compare")
        patch.setattr(comparison, "on_changed_plants", lambda *_: Changed((), None, None))
        patch.setattr(
            "mckibben.study.compare.tuning.ControllerTuning._least_margins", lambda _, table, count: np.ones(count)
        )
        yield


# One reduced reproduction of the paper for all tests of a worker ------------------------------------------------------


@pytest.fixture(scope="session")
def identification():
    return run_identification(repeats=2)


@pytest.fixture(scope="session")
def joint_maps():
    return run_joint(resolution=121)


@pytest.fixture(scope="session")
def reported():
    """Progress reported by `tracking`."""
    return []


@pytest.fixture(scope="session")
def tracking(reported):
    return run_tracking(seeds=2, generations=2, population=8, progress=reported.append)


@pytest.fixture(scope="session")
def reproduction(identification, joint_maps, tracking):
    claims = evaluate_claims(identification, joint_maps, tracking)
    return Reproduction(identification, joint_maps, tracking, run_leg(), claims, quick=True, seconds=1.0)
