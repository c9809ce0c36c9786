@wp.kernel
def dynamics$k(
    model: Model,
    actuator: int,
    first: int,
    rest: int,
    low: float,
    high: float,
    time: wp.array(dtype=float),
    last: wp.array(dtype=float),
    steps: wp.array(dtype=int),
    delay: wp.array(dtype=int),
    commands: wp.array3d(dtype=float),
    ctrl: wp.array2d(dtype=float),
    length: wp.array2d(dtype=float),
    velocity: wp.array2d(dtype=float),
    act: wp.array2d(dtype=float),
    anchors: wp.array2d(dtype=float),
    command: wp.array2d(dtype=float),
    act_dot: wp.array2d(dtype=float),
):
    world = wp.tid()
    begun = not time[world] >= last[world]  # the first call, and after a reset
    later = time[world] > last[world]
$settled
    step = wp.where(begun, 0, wp.where(later, steps[world], steps[world] - 1))
    given = wp.clamp(ctrl[world, actuator], low, high)
    now = begun or later or delay[world] == 0
    command[world, $index] = sent(world, $index, given, now, step, delay[world], commands)
$unset
$rates


@wp.kernel
def forces$k(
    model: Model,
    actuator: int,
    first: int,
    rest: int,
    length: wp.array2d(dtype=float),
    velocity: wp.array2d(dtype=float),
    act: wp.array2d(dtype=float),
    anchors: wp.array2d(dtype=float),
    command: wp.array2d(dtype=float),
    force: wp.array2d(dtype=float),
):
    world = wp.tid()
$force


