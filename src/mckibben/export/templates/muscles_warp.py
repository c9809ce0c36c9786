"""Muscles of $title for NVIDIA Warp, written by mckibben $version.

Needs warp-lang and NumPy. $name.xml is the joint, with actuators whose dynamics and forces are those of this module:

    import mujoco, mujoco_warp, numpy
    from ${name}_warp import Muscles

    mjm = mujoco.MjModel.from_xml_path("$name.xml")
    mjd = mujoco.MjData(mjm)
    mujoco.mj_resetDataKeyframe(mjm, mjd, 0)  # the start of the scenario
    m, d = mujoco_warp.put_model(mjm), mujoco_warp.put_data(mjm, mjd, nworld=1024)
    muscles = Muscles(mjm, worlds=1024)
    muscles.set("command_delay", numpy.linspace(0, 8e-3, 1024))  # or any of PARAMETERS: one number per world
    muscles.install(m)
    mujoco_warp.step(m, d)

Numbers have 32 bits. Not in this model:

$left_out"""

import numpy as np
import warp as wp

TIMESTEP = $timestep  # s, to which delays are rounded up
DELAY = $delay  # s: of the commands


@wp.struct
class Model:
    parameters: wp.array2d(dtype=float)
    real: wp.array2d(dtype=float)
    integer: wp.array2d(dtype=int)
    boolean: wp.array2d(dtype=bool)


$functions
@wp.func
def sent(world: int, muscle: int, command: float, now: bool, step: int, delay: int, sent: wp.array3d(dtype=float)):
    # the command that arrives in this step
    size = sent.shape[2]
    if now:
        sent[world, muscle, step % size] = command
        if step == 0:
            for place in range(size):
                sent[world, muscle, place] = command
    return sent[world, muscle, (step + size - delay) % size]


@wp.kernel
def mark(time: wp.array(dtype=float), last: wp.array(dtype=float), steps: wp.array(dtype=int)):
    world = wp.tid()
    if not time[world] >= last[world]:
        steps[world] = 1
    elif time[world] != last[world]:
        steps[world] += 1
    last[world] = time[world]


$kernels
class Muscles:
    """Muscles of all worlds, with the parameters of each."""

    def __init__(self, mjm, worlds, device=None):
        self.actuators = [mjm.actuator(name).id for name in ACTUATORS]
        self.ranges = [tuple(map(float, mjm.actuator_ctrlrange[one])) for one in self.actuators]
        self.first = [max(int(mjm.actuator_actadr[one]), 0) for one in self.actuators]
        names = {mjm.actuator(one).name for one in range(mjm.nu)}
        further = [f"{name}_state1" for name in ACTUATORS]
        self.rest = [int(mjm.actuator(one).actadr[0]) if one in names else 0 for one in further]
        self.worlds, self.device = worlds, device
        self.values = np.tile(np.concatenate([values for _, values in PARAMETERS.values()]), (worlds, 1))
        with wp.ScopedDevice(device):
            self.model = Model()
            self.model.real, self.model.integer, self.model.boolean = (
                wp.zeros((worlds, max(size, 1)), dtype=kind)
                for size, kind in zip(PREPARED, (float, int, bool), strict=True)
            )
            self.last = wp.full(worlds, float("nan"), dtype=float)
            self.steps = wp.zeros(worlds, dtype=int)
            self.command = wp.zeros((worlds, len(ACTUATORS)), dtype=float)
            self.anchors = wp.zeros((worlds, max(sum(ANCHORS), 1)), dtype=float)
        self._store()
        self.set("command_delay", DELAY)

    def get(self, name):
        """Values of a parameter at present, one row per world."""
        if name not in PARAMETERS:
            raise KeyError(f"{name} is not a parameter; these are: command_delay, {', '.join(PARAMETERS)}")
        first, values = PARAMETERS[name]
        return self.values[:, first] if len(values) == 1 else self.values[:, first : first + len(values)]

    def set(self, name, values):
        """Set a parameter in SI units: one number for all worlds, or one per world."""
        if name == "command_delay":
            steps = np.broadcast_to(np.ceil(np.asarray(values, float) / TIMESTEP - 1e-6), self.worlds)
            if not np.all(steps >= 0):
                raise ValueError(f"command_delay is {values!r}, not 0 or above")
            with wp.ScopedDevice(self.device):
                self.delay = wp.array(steps, dtype=int)
                self.sent = wp.zeros((self.worlds, len(ACTUATORS), int(steps.max()) + 1), dtype=float)
            self.last.fill_(float("nan"))  # the commands on their way are lost
            return
        self.get(name)[...] = values
        self._store()

    def _store(self):
        with wp.ScopedDevice(self.device):
            self.model.parameters = wp.array(self.values, dtype=float)
            wp.launch(prepare, dim=self.worlds, inputs=[self.model])

    def install(self, m):
        """Let a model of MuJoCo Warp call these muscles."""
        m.callback.act_dyn, m.callback.act_bias = self.act_dyn, self.act_bias

    def act_dyn(self, m, d):
        """Set the rates of the activations; at a new time, first let friction and creep slip."""
        for muscle, (actuator, first, rest) in enumerate(zip(self.actuators, self.first, self.rest, strict=True)):
            inputs = [self.model, actuator, first, rest, *self.ranges[muscle], d.time, self.last, self.steps, self.delay, self.sent]
            inputs += [d.ctrl, d.actuator_length, d.actuator_velocity, d.act, self.anchors, self.command, d.act_dot]
            wp.launch(DYNAMICS[muscle], dim=self.worlds, inputs=inputs, device=self.device)
        wp.launch(mark, dim=self.worlds, inputs=[d.time, self.last, self.steps], device=self.device)

    def act_bias(self, m, d):
        """Set the forces."""
        for muscle, (actuator, first, rest) in enumerate(zip(self.actuators, self.first, self.rest, strict=True)):
            inputs = [self.model, actuator, first, rest, d.actuator_length, d.actuator_velocity, d.act, self.anchors]
            inputs += [self.command, d.actuator_force]
            wp.launch(FORCES[muscle], dim=self.worlds, inputs=inputs, device=self.device)


ACTUATORS = $actuators
ANCHORS = $anchors
DYNAMICS = $dynamics
FORCES = $forces
