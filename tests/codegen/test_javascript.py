"""Emitted JavaScript in Node against the same functions in JAX."""

import json
import shutil
import subprocess

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from mckibben.codegen import SourceModule, write_js
from mckibben.errors import ExportError
from mckibben.export import export
from mckibben.export.controller import controller_functions, controller_program
from mckibben.export.hardware import Hardware
from mckibben.scenario import Scenario

NODE = shutil.which("node")
pytestmark = pytest.mark.skipif(NODE is None, reason="needs Node, which runs the emitted JavaScript")


def run(script, body, given):
    """What a function body in JavaScript returns, given an object."""
    program = f"{script}\nconst given = {json.dumps(given)};\nconsole.log(JSON.stringify((() => {{ {body} }})()));"
    done = subprocess.run([NODE, "-"], input=program, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_functions_loops_and_arrays():
    table = np.array([0.5, -1.25, 2.0])
    parameters = {"table": table, "gain": np.asarray(3.0)}

    def evaluate(parameters, state, x, count):
        def body(carry, row):
            carry = jnp.where(carry > 2.0, carry - 0.3 * row, carry * 1.1 + row)
            return carry, jnp.exp(-(carry**2)) + jnp.round(carry)

        last, rows = lax.scan(body, x, jnp.linspace(-1.0, 1.0, 200))
        polynomial = jnp.dot(parameters["table"], jnp.array([1.0, x, x * x])) * parameters["gain"]
        number = count // 3 + lax.rem(count, 3)
        passes, halved = lax.while_loop(
            lambda carry: (carry[1] > x * x * 1e-3) & (carry[0] < 40),
            lambda carry: (carry[0] + 1, carry[1] * (0.5 + 0.01 * x)),
            (0, jnp.asarray(3.0)),
        )
        state = {"sum": state["sum"] + polynomial, "number": state["number"] + 1, "even": ~state["even"]}
        rest = jnp.stack([jnp.arctan2(last, x), jnp.sign(x), jnp.clip(x, -0.2, 0.2), jnp.sinh(x), jnp.fmod(x, 0.3)])
        results = {"last": last, "rows": rows[::50], "rest": rest, "number": number, "passes": passes, "halved": halved}
        return {"state": state, "results": results}

    state = {"sum": np.asarray(0.0), "number": np.asarray(0), "even": np.asarray(False)}
    arguments = {"state": state, "x": np.asarray(0.0), "count": np.asarray(0)}
    module = SourceModule("example", parameters)
    module.add("evaluate", "an example", lambda p, **given: evaluate(p, **given), arguments)
    numbers = [-0.7, 0.0, 0.41, 1.5]
    body = """const self = example.defaults(); self.parameters.gain = 2.5; example.prepare(self);
              return given.map(x => ({...example.evaluate(self, x, -7).results, ...self.state}));"""
    found = run(write_js(module, "an example"), body, numbers)
    parameters["gain"] = np.asarray(2.5)
    for x, one in zip(numbers, found, strict=True):
        made = jax.jit(evaluate)(parameters, state, x, -7)
        state = made["state"]
        for name, value in (made["results"] | state).items():
            assert np.allclose(one[name], np.asarray(value), rtol=1e-12, atol=1e-13), name


@pytest.mark.parametrize("kind", ["pid", "backprop"])
@pytest.mark.slow
def test_controller(tmp_path, kind):
    scenario = Scenario.read(f"examples/pre-contracted-step-{kind}.yaml")
    made = export(scenario, "js", tmp_path)
    assert set(made.contents) == {"controller.js", "scenario.yaml"} and made.left_out == ()
    source = controller_functions(scenario)
    random = np.random.default_rng(1)
    rows = np.column_stack([random.normal(0, 0.1, 50), random.uniform(12, 18, 50), random.normal(0, 0.1, 50),
                            *random.uniform(2e5, 5e5, (2, 50))])  # fmt: skip
    rows = np.clip(rows, [-0.3, 12, -0.3, 0, 0], [0.3, 18, 0.3, 6e5, 6e5]).repeat(4, 0)
    rows[40:45, 2], rows[80:200, 4] = 9.0, -9e9  # held; vented, and held again

    def episode(rows):
        def step(state, row):
            setpoint = source.setpoint._replace(angle=row[0], stiffness=row[1])
            measurement = source.measurement._replace(angle=row[2], pressures=(row[3], row[4]))
            done = source.contained(source.parameters, state, setpoint, measurement)
            told = done["telemetry"]
            return done["state"], (
                *done["commands"].values(),
                told["stiffness_estimate"],
                told["status"],
                told["fault"],
            )

        return lax.scan(step, source.start(source.parameters, source.measurement), rows)[1]

    expected = np.column_stack(jax.jit(episode)(rows))
    body = """const self = controller.defaults(), names = ["angle", "pressures_0", "pressures_1"];
              if (controller.init(self, 2 * given.period, given.first)) return [];
              if (!controller.init(self, given.period, given.first)) return [];
              return given.rows.map(([angle, stiffness, theta, p1, p2]) => {
                  const now = {angle: theta, pressures_0: p1, pressures_1: p2};
                  const {commands, telemetry} = controller.step(self, {angle, stiffness}, now);
                  const {stiffness_estimate, status, fault} = telemetry;
                  return [commands.pressure1, commands.pressure2, stiffness_estimate, status, fault];
              });"""
    angle, pressures = source.measurement
    first = {"angle": float(angle), "pressures_0": float(pressures[0]), "pressures_1": float(pressures[1])}
    found = run(
        (tmp_path / "controller.js").read_text(), body, {"first": first, "rows": rows.tolist(), "period": source.period}
    )
    assert np.ptp(expected, 0).min() > 1
    assert np.allclose(found, expected, rtol=1e-12)
    module, _ = controller_program(source, "controller")
    contraction = {"contraction": 0.1, "pressure": 3e5}
    force = run(write_js(module), "return controller.muscle1_force(controller.defaults(), 0.1, 3e5);", contraction)
    assert force == pytest.approx(float(source.of(source.parameters).model.muscle1.force(0.1, 3e5)), rel=1e-12)


def test_nothing_is_written_for_numbers_of_32_bits(tmp_path):
    with pytest.raises(ExportError) as caught:
        scenario = Scenario.read("examples/pre-contracted-step-pid.yaml")
        export(scenario, "js", tmp_path / "out", hardware=Hardware(single=True))
    assert caught.value.field == "single"
    assert not (tmp_path / "out").exists()


def test_operations_on_bits_are_refused():
    module = SourceModule("example", {})
    module.add("mix", "bits", lambda _, count: {"mixed": count ^ (count << 3)}, {"count": np.asarray(0)})
    with pytest.raises(ExportError) as caught:
        write_js(module)
    assert caught.value.field == "xor"


def test_noise_is_drawn_as_in_jax():
    def noise(parameters, seed, index):
        key = jax.random.fold_in(jax.random.key(parameters["seed"]), index.astype(jnp.uint32))
        return {
            "drawn": {"normal": jax.random.normal(key, (3,), jnp.float32), "bits": jax.random.bits(key, (2,), "uint32")}
        }

    module, number = SourceModule("noise", {"seed": np.asarray(7)}), np.asarray(0)
    module.add("draw", "random numbers", noise, {"seed": number, "index": number})
    indices = [0, 1, 1000, 2**31, 2**32 - 1]
    body = "const self = noise.defaults(); return given.map(index => noise.draw(self, 0, index).drawn);"
    for index, drawn in zip(indices, run(write_js(module), body, indices), strict=True):
        expected = jax.jit(noise)({"seed": 7}, 0, jnp.asarray(index))["drawn"]
        np.testing.assert_array_equal(drawn["bits"], expected["bits"])
        np.testing.assert_allclose(drawn["normal"], expected["normal"], rtol=3e-7)


def test_products_of_words_need_64_bits():
    module = SourceModule("mixed", {})
    function = lambda p, x: {"y": (x.astype(jnp.uint32) * jnp.uint32(2654435761)).astype(int)}  # noqa: E731
    module.add("mix", "a product of words", function, {"x": np.asarray(0)})
    with pytest.raises(ExportError) as error:
        write_js(module)
    assert error.value.field == "and"
