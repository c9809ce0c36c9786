"""Calls that a new user tries: those that forward, and wrong ones, whose errors name the call that is meant."""

import functools
import re

import jax
import numpy as np
import pytest

import mckibben as mk
from mckibben.errors import CallError, FileError, McKibbenError, ScenarioError, closest
from mckibben.units import bar, deg

SCENARIO = mk.Scenario.read("examples/pre-contracted-step-pid.yaml").model_copy(update={"duration": 0.2})
DATA = mk.catalog.dataset("dmsp-10-250-martens2017")
LAW = mk.catalog.law("lei-mas-10-180n")
FIT = functools.cache(lambda: mk.identify(DATA))


@pytest.mark.parametrize(
    ("call", "meant"),
    [
        (lambda: mk.simulate(SCENARIO), "scenario.simulate()"),  # type: ignore[arg-type]
        (lambda: mk.simulate(SCENARIO.plant(), SCENARIO.control()), "simulate(plant, controller, reference)"),
        (lambda: mk.identify(), "identify(data"),  # type: ignore[call-arg]
        (lambda: mk.identify("exponential", "examples/rig.csv"), "swapped"),
        (lambda: mk.identify(DATA, initial_length="280 mm"), "read_dataset"),
        (lambda: mk.identify(DATA, friction="colomb"), "coulomb"),
        (lambda: mk.joint(FIT(), "pulley", radius="30 mm"), "FitWithFriction.muscle()"),  # type: ignore[operator]
        (lambda: mk.joint(FIT().muscle(), "puley"), "'pulley'"),  # type: ignore[operator]
        (lambda: mk.joint(FIT().muscle(), "pulley", radius=30), "30 mm is 0.03 m"),  # type: ignore[operator]
        (lambda: mk.joint(FIT().muscle(), radius="30"), "'30 mm'"),  # type: ignore[operator]
        (lambda: FIT().muscle(diameter="20 bar"), "such as mm"),  # type: ignore[arg-type]
        (lambda: SCENARIO.joint.scenario(), "scenario(load"),  # type: ignore[call-arg]
        (lambda: SCENARIO.joint.torque("10 deg", (2e5, 3e5)), "0.174533 or 10 * deg"),  # type: ignore[arg-type]
        (lambda: mk.Reference("10 bar", 13.0), "such as deg"),
        (lambda: mk.simulate(SCENARIO.plant(), duration="2 m"), "such as s"),
        (lambda: mk.Specimen("mine", "3 bar"), "such as mm"),  # type: ignore[arg-type]
        (lambda: mk.identify(DATA, mk.SmoothLaw()), "mk.identify(data, SmoothLaw)"),  # type: ignore[call-arg, arg-type]
        (lambda: mk.rank(mk.ExponentialLaw, DATA), "swapped"),  # type: ignore[arg-type]
        (lambda: mk.identify(DATA, robust="no"), "True or False"),  # type: ignore[arg-type]
        (lambda: mk.read_dataset(3), "path"),  # type: ignore[arg-type]
        (lambda: mk.report.tracking(SCENARIO), "result.plot()"),  # type: ignore[arg-type]
        (lambda: LAW.force("10 %", 3 * bar), "0.1 or 10 * percent"),  # type: ignore[arg-type]
        (lambda: mk.catalog.specimen("MAS10"), "MAS-10-180N-AA-MC-O"),
        (lambda: mk.PID(1.0, 2.0, 3.0, 4.0), "filter_time="),  # type: ignore[call-arg]
        (lambda: mk.PID(Kp=1.0, ki=2.0, kd=3.0), "'kp'"),  # type: ignore[call-arg]
        (lambda: SCENARIO.tune(iteration=3), "'iterations'"),
        (lambda: SCENARIO.compare(mk.PID(1.0, 2.0, 3.0)), "by name"),  # type: ignore[arg-type]
        (lambda: mk.size("knee.yaml"), "Requirement"),  # type: ignore[arg-type]
        (lambda: mk.validate(DATA, LAW), "swapped"),  # type: ignore[arg-type]
        (lambda: mk.sweep(SCENARIO, ["load.mass2=+-5 %", 3]), "string"),  # type: ignore[list-item]
        (lambda: mk.tune(SCENARIO, {"load.mass2": (1, 2)}), "Distribution"),  # type: ignore[dict-item]
        (lambda: mk.sweep(SCENARIO, {"load.mass2": np.ones(2)}), "simulate_many"),  # type: ignore[dict-item]
        (lambda: mk.Scenario("joint.yaml"), "Scenario.read"),  # type: ignore[call-arg]
        (lambda: SCENARIO.compare({"a": SCENARIO.controller}, conditions=()), "conditions"),
        (lambda: mk.tune(3), "Scenario"),  # type: ignore[arg-type]
        (lambda: SCENARIO.envelope(3), "envelope()"),  # type: ignore[call-arg]
        (lambda: mk.Fit("fit.yaml"), "Fit.from_yaml('fit.yaml')"),  # type: ignore[arg-type, call-arg]
        (lambda: mk.catalog.specimen(["x"]), "str"),  # type: ignore[arg-type]
        (lambda: mk.rank(DATA, "all"), "ExponentialLaw"),  # type: ignore[arg-type]
        (lambda: mk.Reference(0.0, "13"), "13 N*m/rad"),
        (lambda: SCENARIO.simulate().metrics["rmse"], "'angle_rmse'"),
        (lambda: SCENARIO.joint.stiffness(10 * deg), "stiffness(angle, pressures)"),  # type: ignore[call-arg]
        (lambda: SCENARIO.simulate()["angel"], "'angle'"),
        (lambda: SCENARIO.tune(["controller.position.Kp"]), "controller.position.kp"),
    ],
)
def test_a_wrong_call_names_the_one_that_is_meant(call, meant):
    with pytest.raises(McKibbenError) as caught:
        call()
    assert meant in caught.value.remedy
    assert not {"_ModuleMeta", "dtype", "positional"} & set(str(caught.value).split())
    assert "ndarray" not in str(caught.value)


def test_a_joint_takes_the_file_of_a_muscle():
    assert "Pulley(radius=0.03" in repr(mk.joint("examples/your-muscle/fit/muscle.yaml", radius="30 mm"))
    with pytest.raises(McKibbenError, match="'muscle\\.yaml'"):
        mk.joint("examples/your-muscle/fit/muscl.yaml")


@pytest.mark.parametrize(
    ("of", "name", "meant"),
    [
        (lambda: SCENARIO, "run", "simulate"),
        (lambda: SCENARIO, "simulat", "simulate"),
        (lambda: SCENARIO, "stiffness", "joint.stiffness(angle, pressures)"),
        (lambda: LAW, "stiffness", "slope(contraction, pressure)"),
        (lambda: SCENARIO.joint, "simulate", "scenario(load).simulate()"),
        (lambda: mk, "envelope", "scenario.envelope()"),
        (lambda: mk, "ExponentialLw", "ExponentialLaw"),
        (lambda: DATA, "identify", "mk.identify"),
        (lambda: DATA, "contractions", "contraction"),
        (lambda: LAW, "forces", "force"),
        (lambda: LAW, "decai", "decay"),
        (lambda: mk.catalog, "laws", "law"),
        (FIT, "force", "predict(contraction, pressure)"),
        (FIT, "joint", "mk.joint(fit.muscle()"),
        (lambda: SCENARIO.simulate(), "rmse", 'metrics["angle_rmse"]'),
        (lambda: SCENARIO.simulate(), "angle", 'result["angle"]'),
    ],
)
def test_an_unknown_name_has_a_suggestion(of, name, meant):
    asked = of()  # not at import: each worker imports all tests
    with pytest.raises(AttributeError, match=re.escape(meant)):
        getattr(asked, name)
    assert not hasattr(SCENARIO, "nothing_like_it") and not hasattr(mk, "nothing_like_it")


@pytest.mark.parametrize("function", [mk.identify, mk.rank])
def test_an_option_of_the_command_line_is_given_its_name_in_python(function):
    with pytest.raises(CallError) as caught:
        function(keep_outliers=True)
    assert caught.value.field == "keep_outliers" and "robust=False" in caught.value.remedy


@pytest.mark.parametrize(
    ("options", "meant"), [({"inital_length": 0.3}, "'initial_length'"), ({"columns": ["Druck"]}, "pressure_bar")]
)
def test_a_wrong_option_of_a_reader_has_a_suggestion(options, meant):
    with pytest.raises(ScenarioError) as caught:
        mk.read_dataset("rig.csv", **options)
    assert meant in caught.value.problems[0].remedy


def test_a_property_that_fails_raises_its_own_error():
    class Load(mk.PendulumLoad):
        @property
        def doubled(self):
            return 2 * self.lenght  # type: ignore[attr-defined]

    with pytest.raises(AttributeError, match=r"'lenght'; did you mean length\?"):
        _ = Load(1.0, 0.3).doubled


def test_a_scenario_of_a_path_names_the_reader():
    with pytest.raises(TypeError, match=re.escape("Scenario.read('joint.yaml')")):
        mk.Scenario("joint.yaml")  # type: ignore[call-arg]
    with pytest.raises(ScenarioError) as caught:
        mk.Scenario.parse(SCENARIO.dumps() + "\nsupply: 5 bar\n")
    assert caught.value.problems[0].remedy == "it is a key of valve"
    with pytest.raises(ScenarioError) as caught:
        mk.Scenario.read("examples/rig.csv")
    assert "keys and values" in caught.value.problems[0].message
    with pytest.raises(McKibbenError, match="'gains'"):
        SCENARIO.tune("gains")


def test_a_wrong_part_has_a_remedy():
    with pytest.raises(FileError) as caught:
        SCENARIO.simulate(mk.PID(1e5, 2.0, 3.0))  # type: ignore[arg-type]
    assert "a Controller" in caught.value.problems[0].remedy


@pytest.mark.parametrize(("name", "known"), [("mas10", "MAS-10"), ("arm", "arm_slope"), ("kp", ""), ("xyz", "")])
def test_the_beginning_of_a_name_suggests_it(name, known):
    assert closest(name, ["MAS-10", "DMSP-10", "arm_slope"]) == known


def test_lists_stand_for_arrays_in_direct_calls():
    expected = LAW.force(np.array([0.1, 0.2]), np.array([1e5, 2e5]))
    np.testing.assert_array_equal(LAW.force([0.1, 0.2], [1e5, 2e5]), expected)
    np.testing.assert_array_equal(LAW.force((0.1, 0.2), [1e5, 2e5]), expected)
    nested, fit = [[0.1, 0.15], [0.1, 0.15]], FIT()
    assert LAW.force(nested, 2e5).shape == fit.predict(nested, 2e5).shape == (2, 2)
    traced = jax.jit(lambda eps: LAW.force([eps, 0.2], [1e5, 2e5]))(0.1)
    np.testing.assert_allclose(traced, expected, rtol=1e-12)
    for wrong in ([0.1, None], [[0.1], [0.1, 0.2]]):  # a shorter array would be wrong
        with pytest.raises((TypeError, ValueError)):
            LAW.force(wrong, 2e5)


def test_an_error_inside_a_right_call_is_not_blamed_on_its_arguments():
    class Broken(mk.ExponentialLaw):
        def force(self, contraction, pressure):
            raise TypeError("inside")

    with pytest.raises(TypeError, match="inside") as caught:
        mk.validate(Broken(1.0, 1e-7, 1.0, 1e-7, 1.0, 1e-7, 1.0, LAW.domain), DATA)
    assert not isinstance(caught.value, McKibbenError)


def test_texts_with_units_are_numbers_in_si_wherever_a_thing_is_constructed():
    step, gains = mk.Step("10 deg", 0.2, "2 s"), mk.PID("2 bar/rad", "1 bar/(rad*s)", "0 bar*s/rad")
    assert (step.before, step.after, step.at) == pytest.approx((10 * deg, 0.2, 2.0))
    assert (gains.kp, gains.ki, gains.kd) == pytest.approx((2e5, 1e5, 0.0))
    reference = mk.Reference("10 deg", "13 N*m/rad")(0.0)
    assert (reference.angle, reference.stiffness) == pytest.approx((10 * deg, 13.0))
    assert mk.return_spring("4 N/mm", "120 mm").law.rate == pytest.approx(4000.0)
